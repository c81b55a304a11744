"""Parameter sweeps (campaigns): a scenario in many cells with different parameter values."""
