"""A promise is tried up to the edge of its set, and can fail there."""

import dataclasses

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.analysis.safety.depth import a_cell_inside, outer_states
from holdfast.analysis.safety.validation import FEWEST, MOST, default_promise, default_trial

X, V, U = (hf.symbol(n) for n in "xvu")
STATES = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))


def cart(second=1.0):
    """A cart with brakes of 1 m/s^2; `second`: how many units of time a second has."""
    return hf.System(
        "cart", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V / second, "v": U / second},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip


BOX = hf.Region("box", STATES, (
    hf.Inequality("left", -1 - X), hf.Inequality("right", X - 1), hf.Inequality("slow", abs(V) - 1.5),
))  # fmt: skip


def kernel(second=1.0):
    system = cart(second)
    grid = hf.grid(system, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, 61)
    return system, hf.viability_kernel(system, BOX, grid, 10 * second)


def claims_everything(value):
    """The value that a march gives where it takes the region itself for a kernel, V thin there."""
    x, v = np.meshgrid(*(a.nodes for a in value.grid.axes), indexing="ij")
    margin = np.minimum(1 - np.abs(x), 1.5 - np.abs(v))
    thin = (margin > 0) & (value.values() <= 0)
    numbers = np.where(thin, 1e-6 * margin, value.values())
    return dataclasses.replace(value, dataset=value.dataset.assign(value=(("x", "v"), numbers)))


def test_layers_are_disjoint_and_their_shares_are_those_of_the_volume():
    _, value = kernel()
    outer = outer_states(value, np.random.default_rng(0), 300, None, 0.1)
    assert outer.share + outer.between_share + outer.edge_share == pytest.approx(1.0)
    assert len(outer.between) == len(outer.edge) == 300
    assert a_cell_inside(value, outer.between).all()
    assert not a_cell_inside(value, outer.between, above=0.1).any()
    assert (value.at(outer.edge) > 0).all()
    assert not a_cell_inside(value, outer.edge).any()
    drawn = np.random.default_rng(1).uniform([-1.3, -1.8], [1.3, 1.8], (40000, 2))
    drawn = drawn[value.at(drawn) > 0]
    share = np.mean(a_cell_inside(value, drawn, above=0.1))
    assert outer.share == pytest.approx(share, abs=0.02)


def test_starts_are_as_near_to_the_edge_as_between_two_nodes():
    _, value = kernel()
    edge = outer_states(value, np.random.default_rng(0), 2000, None, 0.0).edge
    steps = np.array([a.step for a in value.grid.axes])
    nearest = np.round((edge - [-1.3, -1.8]) / steps) * steps + [-1.3, -1.8]
    assert (value.at(nearest) <= 0).any(), "the node of the cell is outside, the start is not"


@pytest.mark.heavy
def test_true_kernel_is_confirmed_on_the_share_that_the_promise_states():
    system, value = kernel()
    promise = hf.check_promise(system, value, BOX, runs=200, horizon=10, sample_time=0.005)
    assert promise.held
    assert promise.tried_share == pytest.approx(1.0)
    assert [layer.where for layer in promise.layers] == [
        "at least a cell inside", "within a cell of the edge",
    ]  # fmt: skip
    lost = promise.layers[1].lost
    assert promise.confirmed == (lost == 0)
    assert promise.kept_share == pytest.approx(1.0 if not lost else 1 - promise.layers[1].share)
    assert f"{100 * promise.kept_share:.3g} % of the set" in promise.conclusion


def test_false_kernel_that_keeps_its_deep_states_falls_short():
    """All starts as deep as before are kept, since the value under test chooses them."""
    system, value = kernel()
    false = claims_everything(value)
    promise = hf.check_promise(system, false, BOX, runs=200, horizon=10)
    total = promise.inside[0].kept
    assert total.count == total.total == 200
    assert not promise.held
    assert promise.outcome == "fell short"
    assert promise.kept_share == 0.0
    between = promise.layers[0]
    assert between.missed > promise.held_loss, "it leaves by more than a hold can lose"
    assert f"{between.lost} of 100 starts at least a cell inside are lost" in promise.verdict
    assert promise.summary()["outcome"] == "fell short"
    assert promise.summary()["layers"][0]["missed_by"] > promise.held_loss


def test_margin_leaves_the_outer_layers_out_of_the_claim_and_says_so():
    system, value = kernel()
    promise = hf.check_promise(
        system, claims_everything(value), BOX, runs=100, horizon=10, margin=0.1
    )
    assert promise.held
    assert promise.outcome == "confirmed from inside"
    assert promise.share < 0.9
    assert promise.conclusion.startswith("confirmed from 0.1 inside on, ")
    assert "starts nearer to the edge" in promise.conclusion


@pytest.mark.heavy
@pytest.mark.parametrize("second", [1.0, 1e3, 1e-3])
def test_trial_by_default_is_the_same_in_every_unit_of_time(second):
    system, value = kernel(second)
    trial = default_trial(system, value)
    assert FEWEST <= trial.runs <= MOST
    assert trial.horizon == pytest.approx(10 * second)
    one = default_promise(*kernel())
    other = default_promise(system, value)
    assert other.horizon == pytest.approx(second * one.horizon)
    assert other.sample_time == pytest.approx(second * one.sample_time, rel=1e-6)
    assert other.outcome == one.outcome
    assert other.kept_share == pytest.approx(one.kept_share, abs=1e-3)


def test_trial_by_default_of_a_long_horizon_is_fewer_starts_and_then_shorter():
    system, value = kernel()
    longer = default_trial(system, value.reported(horizon_s=1e5))
    assert longer.runs == FEWEST
    assert longer.horizon < 1e4
    assert longer.sample_time == default_trial(system, value).sample_time


@pytest.mark.parametrize("steps", [187, 374, 1266])
def test_trial_by_default_is_no_longer_than_the_march_whatever_is_rounded(steps):
    system, value = kernel()
    trial = default_trial(system, value.reported(horizon_s=3.0, reached_s=3.0, steps=steps))
    assert 3 - 3 / steps < trial.horizon <= 3


@pytest.mark.heavy
def test_two_modes_that_leave_nothing_for_ever_fail_their_promise():
    """Mode rates (1, -.3) and (-.3, .05): .23 x + y falls whatever the inputs do, for 65 s."""
    x, y, m = (hf.symbol(n) for n in "xym")
    states = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
    system = hf.System(
        "two", states, (hf.Quantity("m"),), {"x": 1 - 1.3 * m, "y": -0.3 + 0.35 * m},
        input_bounds=hf.Box((0,), (1,)),
    )  # fmt: skip
    square = hf.Region("square", states, tuple(
        hf.Inequality(n, e, "m") for n, e in (("a", -x), ("b", x - 1), ("c", -y), ("d", y - 1))
    ))  # fmt: skip
    grid = hf.grid(system, {"x": (-0.1, 1.1), "y": (-0.1, 1.1)}, 61)
    value = set_on_grid(square, grid)
    said = {"kind": "viability-kernel", "system": "two", "horizon_s": 100.0, "reached_s": 0.7}
    claimed = value.reported(converged=True, steps=60, cell=0.02, **said)
    promise = hf.check_promise(system, claimed, square, runs=40, horizon=100)
    assert promise.outcome == "fell short"
    assert promise.inside[0].kept.count == 0
