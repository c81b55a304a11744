"""Does this law keep this set: each of the three answers, and the trajectory that refutes."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.certificates.law_keeps import judge_law

X, V, W = (hf.symbol(n) for n in ("x", "v", "w"))


def slider(limit=1.0):
    """x' = v + w on a line from -1 to 1, v at most `limit`, w up to 0.3 m/s."""
    system = hf.System(
        "slider", (hf.Quantity("x", "m"),), (hf.Quantity("v", "m/s"),), {"x": V + W},
        disturbances=(hf.Quantity("w", "m/s"),), disturbance_bounds=hf.Box((-0.3,), (0.3,)),
        input_bounds=hf.Box((-limit,), (limit,)),
    )  # fmt: skip
    ends = (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m"))
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
