"""What a value function says about itself: its error, and what rests on what is outside the grid."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import SimulationError

X, Y, U, W = (hf.symbol(n) for n in ("x", "y", "u", "w"))
BOAT = hf.System(
    "boat", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
    (hf.Quantity("u", "m/s"), hf.Quantity("w", "m/s")), {"x": U, "y": W},
    input_bounds=hf.Ball(sp.S.One, 2),
)  # fmt: skip
DRIFT = hf.System("drift", BOAT.states[:1], (), {"x": sp.S.One})
LINE = hf.grid(DRIFT, {"x": (-1, 1)}, 81, {"x": "extrapolated"})
CELL = 2 / 80


def region(expression, reads=BOAT.states[:1]):
    return hf.Region("region", reads, (hf.Inequality("c", expression, "m"),))


def disc_after(seconds, nodes, **options):
    """What a boat of 1 m/s reaches from a disc of 0.5 m: the exact value is a distance."""
    disc = region(sp.sqrt(X**2 + Y**2 + 1e-12) - 0.5, BOAT.states)
    grid = hf.grid(BOAT, {"x": (-2, 2), "y": (-2, 2)}, nodes)
    found = hf.backward_reachable_tube(BOAT, disc, grid, seconds, **options)
    x, y = np.meshgrid(*(a.nodes for a in grid.axes), indexing="ij")
    off = found.values() - (0.5 + seconds - np.hypot(x, y))
    near = np.abs(found.values()) < 2 * grid.axes[0].step
    return found.dataset.attrs, np.abs(off[near]), grid.axes[0].step


@pytest.mark.parametrize("scheme", ["upwind", "weno5"])
def test_estimate_of_two_grids_is_the_error_or_more(scheme):
    said, error, step = disc_after(0.7, 41, scheme=scheme, estimate_error=True)
    assert said["error_order"] == 1.0
    assert said["error_largest"] > 0.85 * error.max()  # the common nodes are a quarter of all
    assert said["error_rms"] > math.sqrt(np.mean(error**2))
    assert said["error_cells"] > np.quantile(error, 0.95) / step
    if scheme == "upwind":  # which is of first order
        assert said["error_largest"] < 2 * error.max()


def test_order_is_observed_on_a_third_grid():
    said, error, _ = disc_after(0.7, 81, scheme="eno2", estimate_error="order")
    assert said["error_order"] == pytest.approx(2.0, abs=0.15)
    assert said["error_largest"] == pytest.approx(error.max(), rel=0.25)
    upwind = {"scheme": "upwind", "dissipation": "local"}
    assert disc_after(0.7, 81, **upwind, estimate_error="order")[0]["error_order"] == pytest.approx(
        1.0, abs=0.15
    )
    without = disc_after(0.7, 41)[0]
    assert not any(name.startswith("error") for name in without)


@pytest.mark.parametrize(
    ("nodes", "asked", "complaint"),
    [
        (40, True, "39 cells along 'x'; expected a multiple of 2, .*; take 39 or 41 nodes"),
        (43, "order", "42 cells along 'x'; expected a multiple of 4, .*; take 41 or 45 nodes"),
        (11, True, "a grid of 1/2 of the cells has 6 nodes along 'x'; expected at least 7"),
        (41, "twice", "estimate_error: 'twice'; expected True, False or \"order\""),
    ],
)
def test_estimates_that_cannot_be_made_are_refused(nodes, asked, complaint):
    with pytest.raises(SimulationError, match=complaint):
        disc_after(0.1, nodes, estimate_error=asked)


def test_safety_that_rests_on_what_is_outside_is_told():
    """Carried to the right at 1 m/s: who leaves the grid within the horizon is safe by a guess."""
    safe = region(-0.5 - X)  # x >= -0.5
    found = hf.viability_kernel(DRIFT, safe, LINE, 0.6, check_outside=True)
    x, outside = LINE.axes[0].nodes, found.dataset["outside"].values
    assert (found.values()[x > -0.49] > 0).all()
    sure = np.abs(x - 0.4) > 1.5 * CELL
    assert np.array_equal((outside == 1)[sure], (x > 0.4)[sure])
    said = found.dataset.attrs
    assert said["nodes_from_outside"] == np.sum(outside == 1)
    assert said["share_from_outside"] == pytest.approx(0.4, abs=0.03)


def test_reach_that_is_denied_by_what_is_outside_is_told():
    """A target in the middle: who is right of it leaves the grid, and might come back."""
    target = region(abs(X) - 0.3)
    for problem in (
        lambda **o: hf.backward_reachable_tube(DRIFT, target, LINE, 0.5, **o),
        lambda **o: hf.capture_basin(DRIFT, target, None, LINE, 0.5, **o),
    ):
        found = problem(check_outside=True)
        x, outside = LINE.axes[0].nodes, found.dataset["outside"].values
        sure = (np.abs(x - 0.5) > 1.5 * CELL) & (np.abs(x) < 1)
        assert np.array_equal((outside == -1)[sure], (x > 0.5)[sure])
        assert found.dataset.attrs["nodes_from_outside"] == 0


def test_set_that_is_kept_without_what_is_outside_is_sure():
    """A boat that holds against the ends of its grid needs nothing from there; a closed one even less."""
    lane = region(abs(Y) - 0.5, BOAT.states[1:])
    grid = hf.grid(BOAT, {"x": (-1, 1), "y": (-1, 1)}, 21)
    found = hf.viability_kernel(BOAT, lane, grid, 1.0, check_outside=True)
    assert found.dataset.attrs["ends_reached"] == "x = -1, x = 1"
    outside = found.dataset["outside"].values
    assert (outside[1:-1] == 0).all()  # all but the ends themselves
    closed = hf.grid(BOAT, {"x": (-1, 1), "y": (-1, 1)}, 21, {"x": "limited"})
    found = hf.viability_kernel(BOAT, lane, closed, 1.0, check_outside=True)
    assert (found.dataset["outside"].values == 0).all()


def test_growth_from_outside_ends_a_march_at_once():
    """A target that reaches the end of the grid, and comes in: more than there ever was."""
    target = region(0.5 - X)
    seen = []
    said = r"by (0\.\d+) s the value has grown to .*; let what is to be reached end within the grid"
    with pytest.raises(SimulationError, match=said):
        hf.backward_reachable_tube(DRIFT, target, LINE, 20.0, progress=seen.append)
    assert seen[-1] < 0.05


def test_marches_beside_have_checkpoints_beside(tmp_path):
    lane = region(abs(Y) - 0.5, BOAT.states[1:])
    grid = hf.grid(BOAT, {"x": (-1, 1), "y": (-1, 1)}, 21)
    options = {"check_outside": True, "estimate_error": True, "checkpoint": tmp_path / "a"}
    first = hf.viability_kernel(BOAT, lane, grid, 0.2, **options)
    filtered = {f"a.{name}rest" for name in ("", "lost.", "won.")}
    assert {f.name for f in tmp_path.iterdir()} == {"a", "a.coarse1", "a.lost", "a.won", *filtered}
    again = hf.viability_kernel(BOAT, lane, grid, 0.2, **options)
    assert again.dataset.identical(first.dataset)
