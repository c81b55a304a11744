"""Gains that meet every condition of a law, best for a cost: `holdfast tune`."""
