"""A filter by proof whose inputs come late: what it lets pass is still under way a sample later."""

from functools import cache

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import SimulationError

X, Y, U, V, W = (hf.symbol(n) for n in ("x", "y", "u", "v", "w"))
HOLD, DELAY, PUSH = 0.2, 0.05, 0.05
RHOMBUS = hf.LinearImage(sp.ImmutableMatrix([[1, 1], [1, -1]]), hf.Box((-0.5, -0.5), (0.5, 0.5)))


def slide(bounds):
    """x' = u + w, y' = v."""
    return hf.System(
        "slide", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("u", "m/s"), hf.Quantity("v", "m/s")), {"x": U + W, "y": V},
        disturbances=(hf.Quantity("w", "m/s"),), input_bounds=bounds,
        disturbance_bounds=hf.Box((-PUSH,), (PUSH,)),
    )  # fmt: skip


def box(most):
    return hf.Box((-most, -most), (most, most))


@cache
def certificate(bounds, inputs):
    system = slide(bounds)
    square = hf.Region(
        "square", system.states, (hf.Inequality("x", abs(X) - 1), hf.Inequality("y", abs(Y) - 1))
    )
    return hf.certify(
        system, square, box={"x": (-1, 1), "y": (-1, 1)}, cells=41, sample_time=HOLD, delay=DELAY,
        inputs=inputs,
    )  # fmt: skip


def lost(found, system, most, runs, seed=0, samples=60):
    """How many runs leave the square under commands of up to `most` along an axis; exact motion."""
    keep, rng = hf.CertifiedFilter(found, system), np.random.default_rng(seed)
    low, high = found.cells.corners(found.kept.members)
    cell = rng.integers(0, len(low), runs)
    at = low[cell] + rng.random((runs, 2)) * (high[cell] - low[cell])
    before, out, largest = np.zeros((runs, 2)), np.zeros(runs, dtype=bool), 0.0
    for _ in range(samples):
        way = rng.integers(0, 4, runs) * np.pi / 2
        size = rng.choice([1, 0.5, 0.2], (runs, 1))
        told = keep.step_many(at, most * size * np.stack([np.cos(way), np.sin(way)], axis=1))
        assert hf.Status.OUTSIDE_GRID not in told.status
        push = np.stack([PUSH * np.sign(at[:, 0]), np.zeros(runs)], axis=1)
        middle = at + DELAY * (before + push)
        at = middle + (HOLD - DELAY) * (told.input + push)
        before, largest = told.input, max(largest, float(np.abs(told.input).max()))
        out |= np.abs(np.hstack([middle, at])).max(axis=1) > 1 + 1e-9
    return int(out.sum()), largest


CASES = [
    (box(0.5), 5, box(0.5), 0.5, 0.5),
    (box(0.5), 5, box(3.0), 3.0, 0.5),  # a stronger vehicle
    (RHOMBUS, 5, RHOMBUS, 1.0, 1.0),
    (RHOMBUS, 4, RHOMBUS, 1.0, 1 / 3),  # the inputs that are tried end before the bounds
    (RHOMBUS, 6, RHOMBUS, 1.0, 0.6),
]


@pytest.mark.few("bounds1-5-stronger1-3.0-0.5")
@pytest.mark.parametrize(("bounds", "inputs", "stronger", "most", "counted"), CASES)
def test_none_of_10000_runs_leaves_whatever_is_commanded(bounds, inputs, stronger, most, counted):
    """2,000 of each case. Without the limit to what was counted 286, 99 and 7 of 400 left."""
    assert len(CASES) * 2000 == 10_000
    left, largest = lost(certificate(bounds, inputs), slide(stronger), most, 2000)
    assert left == 0
    assert largest == pytest.approx(counted)


def test_command_beyond_what_was_counted_is_limited_and_said_to_be():
    keep = hf.CertifiedFilter(certificate(box(0.5), 5), slide(box(3.0)), fallback=(3.0, 0.0))
    assert keep.fallback.tolist() == [0.5, 0.0]
    told = keep.step([0.0, 0.0], [2.0, 0.0])
    assert told.input.tolist() == [0.5, 0.0]
    assert "beyond the bounds of the inputs or the range of those that were tried" in told.why


def test_inputs_of_which_none_is_within_the_bounds_are_refused():
    with pytest.raises(SimulationError, match="none of the 4 inputs that are tried is within"):
        certificate(RHOMBUS, 2)
