"""A promise confirms a set only if every run stays, on the grid, against all that was tried."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.safety.depth import a_cell_inside
from holdfast.errors import SimulationError

X, Y = hf.symbol("x"), hf.symbol("y")
PLANE = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))


def chauffeur():
    """A pursuer who turns by phi at speed 1, seen from him an evader who walks at 0.5."""
    phi, e1, e2 = (hf.symbol(n) for n in ("phi", "e1", "e2"))
    return hf.System(
        "chauffeur", PLANE, (hf.Quantity("e1", "m/s"), hf.Quantity("e2", "m/s")),
        {"x": -phi * Y + e1, "y": phi * X - 1 + e2},
        disturbances=(hf.Quantity("phi", "rad/s"),),
        input_bounds=hf.Ball(0.5, 2), disturbance_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip


AWAY = hf.Region("away", PLANE, (hf.Inequality("near", 0.5 - sp.sqrt(X**2 + Y**2), "m"),))


@pytest.fixture(scope="module")
def pursuit():
    """The set on a box that is too small: it counts on what is taken to be beyond."""
    system = chauffeur()
    box = {"x": (-2.5, 2.5), "y": (-2.5, 2.5)}
    ends = dict.fromkeys("xy", "extrapolated")
    grid = hf.grid(system, box, 41, ends)
    value = hf.discriminating_kernel(system, AWAY, grid, 10, scheme="upwind")
    return value, hf.check_promise(system, value, AWAY, runs=60)


def test_evader_who_runs_off_the_grid_is_not_kept(pursuit):
    value, promise = pursuit
    assert value.fraction() > 0.5
    total = promise.inside[0]
    assert total.off_grid > 50
    assert total.kept.count + total.off_grid <= 60
    assert not promise.held
    assert promise.outcome == "not confirmed"  # what leaves the grid may have got away
    assert f"{total.off_grid} of 60 starts a cell" in promise.verdict
    assert "leave the grid before the region" in promise.verdict


def test_tally_says_which_pursuer_beat_which_start(pursuit):
    value, promise = pursuit
    total = promise.inside[0]
    assert len(promise.beaten) == total.kept.total - total.kept.count
    tried = {t.what for t in promise.inside[1:]}
    assert {b.by for b in promise.beaten} <= tried
    assert len({b.by for b in promise.beaten}) > 2
    for b in promise.beaten:
        assert value.contains([b.start])[0]
        assert b.outcome in ("left grid", "left region")
        assert 0 <= b.time <= 10
    assert promise.summary()["beaten"][0]["by"] in tried


POINT = (hf.Quantity("x", "m"),)


@pytest.mark.heavy
def test_set_that_touches_an_open_end_is_not_confirmed_though_every_run_stays():
    """Slow, and a wall on the right alone: nobody leaves, and yet the set goes on beyond the box."""
    system = hf.System(
        "slow", POINT, (hf.Quantity("u", "m/s"),), {"x": hf.symbol("u")},
        input_bounds=hf.Box((-0.001,), (0.001,)),
    )  # fmt: skip
    wall = hf.Region("wall", POINT, (hf.Inequality("right", X, "m"),))
    value = hf.viability_kernel(
        system, wall, hf.grid(system, {"x": (-1, 1)}, 41, {"x": "extrapolated"}), 1.0
    )
    promise = hf.check_promise(system, value, wall, runs=40, horizon=1.0)
    assert promise.held
    assert not promise.confirmed
    assert promise.verdict == (
        "the promise is not confirmed: the set touches the open ends of the grid (x = -1) and depends "
        "on extrapolation beyond them; widen the grid until it does not touch them"
    )


def test_push_that_switches_in_time_beats_a_set_that_no_gradient_doubts():
    """A mass on a spring claims the whole interval: V knows no velocity, resonance does."""
    states = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
    v, u, d = (hf.symbol(n) for n in ("v", "u", "d"))
    system = hf.System(
        "spring", states, (hf.Quantity("u", "m/s^2"),), {"x": v, "v": -X + u + d},
        disturbances=(hf.Quantity("d", "m/s^2"),),
        input_bounds=hf.Box((-0.01,), (0.01,)), disturbance_bounds=hf.Box((-0.2,), (0.2,)),
        empirical="its stiffness is a number",
    )  # fmt: skip
    calm = hf.Region("calm", states, (hf.Inequality("reach", sp.sqrt(X**2) - 1, "m"),
                                      hf.Inequality("speed", sp.sqrt(v**2) - 0.2, "m/s")))  # fmt: skip
    grid = hf.grid(system, {"x": (-1.2, 1.2), "v": (-0.3, 0.3)}, 25)
    value = hf.discriminating_kernel(system, calm, grid, 1e-4)
    wide = hf.Region("wide", states, calm.inequalities[:1])
    numbers = np.broadcast_to(1 - np.abs(grid.axes[0].nodes)[:, None], grid.shape) - 0.7
    said = {"converged": 1, "ends_reached": ""}
    claimed = replace(
        value, dataset=value.dataset.assign(value=(("x", "v"), numbers)).assign_attrs(said)
    )
    big = hf.grid(system, {"x": (-1.2, 1.2), "v": (-3, 3)}, 25)
    claimed = replace(claimed, grid=big)
    promise = hf.check_promise(system, claimed, wide, runs=40, horizon=60, margin=0.1)
    kept = {t.what: t.kept.value for t in promise.inside}
    assert kept["the gradient of the value"] > kept["switching extremes"]
    assert kept["every disturbance tried"] < 0.5


@pytest.mark.heavy
def test_cell_is_measured_where_the_state_is():
    """Steep on the left, flat on the right: the largest change of all is more than V has there."""
    system = hf.System(
        "line", POINT, (hf.Quantity("u", "m/s"),), {"x": hf.symbol("u")},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    slope = hf.Region("slope", POINT, (hf.Inequality("left", -100 * X, "m"),
                                       hf.Inequality("right", X - 1, "m")))  # fmt: skip
    value = hf.viability_kernel(system, slope, hf.grid(system, {"x": (-0.5, 1.5)}, 41), 1.0)
    assert value.dataset.attrs["cell"] > value.values().max(), "no state is so far inside"
    states = np.array([[0.02], [0.5], [0.9], [0.97]])
    assert list(a_cell_inside(value, states)) == [False, True, True, False]
    promise = hf.check_promise(system, value, slope, runs=40, sample_time=0.001)
    assert promise.held
    assert 0.5 < promise.share < 1.0


def pendulum_in(region):
    """A cart by its place in metres and its heading in radians."""
    states = (hf.Quantity("x", "m"), hf.Quantity("a", "rad"))
    u, w = hf.symbol("u"), hf.symbol("w")
    system = hf.System(
        "turner", states, (hf.Quantity("u", "m/s"), hf.Quantity("w", "rad/s")),
        {"x": u, "a": w}, input_bounds=hf.Box((-1, -1), (1, 1)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-0.03, 0.03), "a": (-1.3, 1.3)}, 31, {"a": "contained"})
    return system, hf.viability_kernel(system, region, grid, 1.0)


MIXED = hf.Region("mixed", (hf.Quantity("x", "m"), hf.Quantity("a", "rad")), (
    hf.Inequality("place", sp.sqrt(X**2) - 0.02, "m"),
    hf.Inequality("turn", sp.sqrt(hf.symbol("a") ** 2) - 1, "rad"),
))  # fmt: skip


def test_depth_in_metres_and_radians_is_measured_by_the_scales_of_the_constraints():
    plain, scaled = MIXED, MIXED.with_scales({"place": 0.02, "turn": 1.0})
    assert plain.margin_unit == scaled.margin_unit == "1"
    at = {X: 0.01, hf.symbol("a"): 0.5}
    assert float(plain.margin.subs(at)) == pytest.approx(0.01), "1 m counts as much as 1 rad"
    assert float(scaled.margin.subs(at)) == pytest.approx(0.5), "half of every scale"
    system, value = pendulum_in(scaled)
    assert value.dataset.attrs["value_unit"] == "1"
    assert value.values().max() == pytest.approx(1.0, abs=0.1)
    promise = hf.check_promise(system, value, scaled, runs=30, sample_time=0.001, margin=0.25)
    assert promise.held
    assert promise.inside[0].excursion < 0
    assert promise.depth == "0.25"


def test_promise_in_mixed_units_has_a_depth_by_default():
    system, value = pendulum_in(MIXED)
    assert value.dataset.attrs["cell"] > value.values().max()
    promise = hf.check_promise(system, value, MIXED, runs=30, sample_time=0.001)
    assert promise.held
    assert promise.share > 0.5


@pytest.mark.parametrize("scale", [0.0, -1.0, float("inf")])
def test_scale_is_a_number_above_zero(scale):
    with pytest.raises(hf.errors.DefinitionError, match="has the scale"):
        MIXED.with_scales({"turn": scale})


@pytest.fixture(scope="module")
def nothing():
    """What is pushed harder than it can push."""
    u, d = hf.symbol("u"), hf.symbol("d")
    system = hf.System(
        "weak", POINT, (hf.Quantity("u", "m/s"),), {"x": u + d},
        disturbances=(hf.Quantity("d", "m/s"),),
        input_bounds=hf.Box((-0.5,), (0.5,)), disturbance_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    gap = hf.Region("gap", POINT, (hf.Inequality("left", -1 - X, "m"),
                                   hf.Inequality("right", X - 1, "m")))  # fmt: skip
    return (
        system,
        gap,
        hf.discriminating_kernel(system, gap, hf.grid(system, {"x": (-1.2, 1.2)}, 41), 5),
    )


def test_law_and_promise_of_an_empty_kernel_say_that_it_is_empty(nothing):
    system, gap, value = nothing
    for call in (
        lambda: hf.safety_law(system, value),
        lambda: hf.check_promise(system, value, gap),
    ):
        with pytest.raises(SimulationError, match=r"of 'gap' is empty after .* s: no law keeps"):
            call()


def test_law_asked_outside_its_grid_says_so_in_the_outcome():
    system = hf.System(
        "drift", POINT, (hf.Quantity("u", "m/s"),), {"x": 1 + hf.symbol("u")},
        input_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    left = hf.Region("left", POINT, (hf.Inequality("left", -X, "m"),))
    value = hf.viability_kernel(
        system, left, hf.grid(system, {"x": (-1, 2)}, 31, {"x": "extrapolated"}), 3.0
    )
    law = hf.safety_law(system, value)
    result = hf.simulate(system, law, starts=[[0.5], [5.0], [1.9]], region=left, horizon=1.0)
    assert result.outcomes["left grid"] == 2
    assert result.outcomes["stayed"] == 1
    assert result.dataset["off_grid_time"].values[1] == 0.0
    assert 0.05 < result.dataset["off_grid_time"].values[2] < 0.2
    assert np.isnan(result.dataset["off_grid_time"].values[0])


@pytest.mark.parametrize("state", [float("nan"), float("inf")])
def test_value_at_a_state_that_is_not_finite_is_refused(nothing, state):
    value = nothing[2]
    for asked in (value.at, value.gradient, value.contains):
        with pytest.raises(SimulationError, match="state 1 is not finite"):
            asked([[0.0], [state]])


def test_disturbance_whose_worst_lies_between_its_samples_confirms_nothing():
    """x' = 0.9 u + sin(7 d): d = 0.22 pushes with 1, which no point of five does."""
    x, u, d = (hf.symbol(n) for n in ("x", "u", "d"))
    system = hf.System(
        "pushed", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": 0.9 * u + sp.sin(7 * d)},
        disturbances=(hf.Quantity("d"),), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-1,), (1,)), samples=5,
    )  # fmt: skip
    walls = hf.Region("walls", system.states, (hf.Inequality("far", sp.Abs(x) - 1),))
    value = hf.discriminating_kernel(system, walls, hf.grid(system, {"x": (-1.2, 1.2)}, 41), 100.0)
    promise = hf.check_promise(system, value, walls, runs=40, horizon=40.0)
    assert not promise.confirmed
    assert "between them may be worse" in promise.doubt
    beaten = next(t for t in promise.inside if t.what == "constants within the bounds")
    assert beaten.kept.count < beaten.kept.total


@pytest.mark.heavy
def test_disturbance_that_can_do_nothing_is_no_reason_to_refuse_a_promise():
    x, u, d = (hf.symbol(n) for n in ("x", "u", "d"))
    for rate, most in ((2 * x + u / 2 + d, 0.0), (2 * x + u / 2, 1.0)):
        system = hf.System(
            "idle", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": rate},
            disturbances=(hf.Quantity("d"),), input_bounds=hf.Box((-1,), (1,)),
            disturbance_bounds=hf.Box((-most,), (most,)),
        )  # fmt: skip
        walls = hf.Region("walls", system.states, (hf.Inequality("far", sp.Abs(x) - 1),))
        grid = hf.grid(system, {"x": (-1.2, 1.2)}, 65)
        value = hf.discriminating_kernel(system, walls, grid, 5.0)
        promise = hf.check_promise(system, value, walls, runs=20, sample_time=0.002, horizon=1.0)
        assert promise.held
