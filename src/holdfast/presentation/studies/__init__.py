"""Figures of many runs: sweeps, comparisons, margins."""
