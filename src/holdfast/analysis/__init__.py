"""Analysis: simulation results and statistics, reachability, safety filters, viability checks."""
