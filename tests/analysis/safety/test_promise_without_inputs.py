"""What a set of a system without inputs promises is tried like any other, against its disturbances."""

import math

import pytest

import holdfast as hf

X, D = hf.symbol("x"), hf.symbol("d")
STATES = (hf.Quantity("x"),)
WALLS = hf.Region("walls", STATES, (hf.Inequality("right", X - 1), hf.Inequality("left", -1 - X)))


def drifting(rate, push=0.0):
    pushed = {"disturbances": (hf.Quantity("d"),)} if push else {}
    bounds = {"disturbance_bounds": hf.Box((-push,), (push,))} if push else {}
    return hf.System("drifting", STATES, (), {"x": rate + D * int(bool(push))}, **pushed, **bounds)


def test_a_set_that_nobody_steers_keeps_its_promise():
    system = drifting(-X)
    kernel = hf.viability_kernel(system, WALLS, hf.grid(system, {"x": (-2, 2)}, 81), 2.0)
    said = hf.check_promise(system, kernel, WALLS, runs=200).summary()
    assert (said["law"], said["outcome"], said["share_kept"]) == ("no inputs", "confirmed", 1.0)


def test_disturbances_attack_it():
    """x' = x + d is kept for 1 s from |x| <= (1 + push) / e - push, which a push of twice leaves."""
    system = drifting(X, 0.1)
    grid = hf.grid(system, {"x": (-2, 2)}, 161)
    kernel = hf.discriminating_kernel(system, WALLS, grid, 1.0)
    edge = kernel.dataset["x"].values[kernel.values() > 0].max()
    assert edge == pytest.approx(1.1 / math.e - 0.1, abs=0.03)
    promise = hf.check_promise(system, kernel, WALLS, runs=200)
    assert promise.summary()["outcome"] == "confirmed"
    assert promise.outside is not None
    assert len(promise.inside) > 3
    unpushed = hf.viability_kernel(
        system, WALLS, grid, 1.0, disturbance={"d": 0.0}
    )  # whose set is larger
    assert unpushed.dataset["x"].values[unpushed.values() > 0].max() == pytest.approx(
        1 / math.e, abs=0.03
    )
