"""Many computations from scenarios: sweeps, margins, comparisons, the thesis."""
