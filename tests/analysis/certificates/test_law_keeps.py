"""Does this law keep this set: each of the three answers, and the trajectory that refutes."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.certificates.law_keeps import judge_law
from holdfast.errors import DefinitionError, SimulationError

X, V, W = (hf.symbol(n) for n in ("x", "v", "w"))


def slider(limit=1.0):
    """x' = v + w on a line from -1 to 1, v at most `limit`, w up to 0.3 m/s."""
    system = hf.System(
        "slider", (hf.Quantity("x"),), (hf.Quantity("v"),), {"x": V + W},
        disturbances=(hf.Quantity("w"),), disturbance_bounds=hf.Box((-0.3,), (0.3,)),
        input_bounds=hf.Box((-limit,), (limit,)),
    )  # fmt: skip
    ends = (hf.Inequality("left", -1 - X), hf.Inequality("right", X - 1))
    return system, hf.Region("line", system.states, ends)


def back(gain):
    return hf.Law("back", slider()[0].states, {"v": -gain * X})


def judged(gain, limit=1.0, **more):
    system, line = slider(limit)
    return judge_law(system, line, back(gain), box={"x": (-1, 1)}, cells=64, **more)


def test_law_that_pushes_harder_than_the_current_is_proved_on_the_whole_line():
    found = judged(1.0)
    assert found.verdict == "proved"
    assert found.leaving is None
    assert len(found.undecided) == 0


def test_law_that_is_too_weak_is_refuted_by_a_trajectory_that_is_true():
    """x' = -x/10 + 0.3 ends at 3: solved exactly, by holds."""
    found = judged(0.1)
    assert found.verdict == "refuted"
    path = found.leaving
    assert abs(path.held["w"]) == 0.3
    assert path.constraint == ("right" if path.held["w"] > 0 else "left")
    x = path.start["x"]
    assert abs(x) < 1
    for low, high in zip(path.low[:, 0], path.high[:, 0], strict=True):
        assert low - 1e-12 <= x <= high + 1e-12
        x += 0.1 * (-0.1 * x + path.held["w"])
    assert path.by > 0
    assert np.abs(path.low[-1, 0]) > 1
    assert path.time[-1] == pytest.approx(0.1 * (len(path.time) - 1))


def test_law_that_holds_just_so_is_undecided_and_says_where():
    """It stops at 1 - 1e-3 in the worst current: cells are wider than that."""
    found = judged(0.3 / 0.999)
    assert found.verdict == "undecided"
    assert found.certificate.kept.share < 1
    assert np.abs(found.undecided).max() > 0.9


def test_horizon_bounds_both_the_proof_and_the_trajectory():
    assert judged(0.1, horizon=0.1).verdict == "refuted"
    assert judged(0.3 / 0.999, horizon=0.2).leaving is None
    path = judged(0.1, horizon=0.24).leaving  # three holds, of proof and trajectory
    assert len(path.time) <= judged(0.1, horizon=0.24).certificate.kept.holds + 1 == 4


def test_limit_of_the_inputs_that_is_uncertain_is_refused():
    """With the nominal limit the line is kept, with the least one it is not."""
    limit = hf.Parameter("p", "m/s", value=1.0)
    system, line = slider()
    system = replace(
        system, parameters=(limit,), input_bounds=hf.Box((-limit.symbol,), (limit.symbol,))
    )
    given = {"box": {"x": (-1, 1)}, "cells": 32}
    assert judge_law(system, line, back(1.0), **given).verdict == "proved"
    with pytest.raises(SimulationError, match="use 'p', which is uncertain"):
        judge_law(system, line, back(1.0), uncertain={"p": (0.1, 1.0)}, **given)


def test_number_that_the_law_and_the_system_have_otherwise_is_refused():
    k = hf.symbol("k")
    system, line = slider()
    system = replace(system, parameters=(hf.Parameter("k", "1/s", value=2.0),))
    law = hf.Law("back", system.states, {"v": -k * X}, (hf.Parameter("k", "1/s", value=0.1),))
    with pytest.raises(DefinitionError, match="'k' is declared twice: 2 1/s"):
        judge_law(system, line, law, box={"x": (-1, 1)}, cells=32)


def test_trajectory_of_which_no_box_is_found_refutes_nothing():
    """x' = 8 x, z' = 1 - (x/850)^8: z stays below 0.83, and no box contains a way of one second."""
    z, v = hf.symbol("z"), V
    system = hf.System(
        "fast", (hf.Quantity("x"), hf.Quantity("z")), (hf.Quantity("v"),),
        {"x": 8 * X, "z": 1 - (X / 850) ** 8 + v}, input_bounds=hf.Box((-1.0,), (1.0,)),
    )  # fmt: skip
    low = hf.Region("low", system.states, (hf.Inequality("c", z - 0.86),))
    still = hf.Law("still", system.states, {"v": 0 * X})
    found = judge_law(
        system, low, still, box={"x": (0.99, 1.01), "z": (-0.01, 0.01)}, cells=1, sample_time=1.0
    )
    assert found.verdict == "undecided"
