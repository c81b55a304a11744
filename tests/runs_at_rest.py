"""Runs of the scenarios in a current: which stay in view, and which come to rest."""

import math

import numpy as np

import holdfast as hf

LIMIT = math.radians(83)


def settled(speed, *changes, scenario="inspection-current", limit=LIMIT):
    """(viable, at rest, with a place at rest, of those at rest) of 600 starts."""
    overrides = [f"varied.draws.speed.range=[{speed}, {speed}]", *changes]
    data = hf.load_scenario(scenario, overrides).run().dataset
    directions = data["varied"].sel(varied_name="direction").values
    can = np.abs(np.arctan(np.tan(directions))) < limit
    at_rest = data["outcome"].values == hf.Outcome.REACHED
    viable = data["outcome"].values != hf.Outcome.LEFT
    return viable.sum(), at_rest.sum(), can.sum(), (at_rest & can).sum()
