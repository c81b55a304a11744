"""Decompositions read off the rates: factor systems, unions of regions, lags that are predicted."""
