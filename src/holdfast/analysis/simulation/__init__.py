"""Runs of a closed loop with names and units: results, statistics, comparisons, tables."""
