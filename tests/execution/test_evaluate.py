"""Expressions at many points in one call."""

import numpy as np

import holdfast as hf
from holdfast.execution.leaf import Evaluator


def test_parameter_that_two_parts_declare_is_one_number():
    """A region of a file declares the parameters of its system too."""
    x, room, speed = (hf.symbol(n) for n in ("x", "room", "speed"))
    shared = hf.Parameter("speed", "m/s", value=5.0)
    own = hf.Parameter("room", "m", value=2.0)
    found = Evaluator([x - room, speed], [x], (shared, shared, own))
    assert found.values(np.array([[3.0]])).tolist() == [[1.0, 5.0]]
    assert found.values(np.array([[3.0]]), {"room": 1.0}).tolist() == [[2.0, 5.0]]
