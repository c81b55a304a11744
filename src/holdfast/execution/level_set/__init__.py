"""Marches over a grid: finite differences, schemes, sweeps, workers."""
