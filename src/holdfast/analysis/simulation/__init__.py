"""Closed-loop simulation: results with names and units, statistics, comparisons, tables."""
