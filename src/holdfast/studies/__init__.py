"""Studies of scenarios: parameter sweeps, margins, comparisons, the claims of the thesis."""
