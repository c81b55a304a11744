"""Campaigns: a scenario in many cells, each with values of its own for some numbers."""
