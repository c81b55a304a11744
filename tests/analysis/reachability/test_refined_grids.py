"""Grids that are finer near the boundary: the values of the finer grid there, from a part of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from exact import braking, doubled, population, quantities, region, turning, unstable, zermelo

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.execution.level_set.refined_march import Blocks
from holdfast.scenario.load import load_scenario
from tests import carts

X, Y, V, D = (hf.symbol(n) for n in ("x", "y", "v", "d"))


def pair(problem, cells, refine=2, **options):
    """The sets on the finer grid everywhere, and on one that is refined to it."""
    if problem.find is hf.capture_basin:
        options.setdefault("arrival_steps", 0)
    found = []
    for divided, more in ((refine, {}), (1, {"refine": refine})):
        whole = [abs(b - a) > 6.28 for a, b in problem.box.values()]
        nodes = {
            name: divided * n + (not (around and name == "theta"))
            for name, n, around in zip(problem.box, cells, whole, strict=True)
        }
        grid = hf.grid(problem.system, problem.box, nodes, problem.ends)
        found.append(
            problem.find(problem.system, *problem.regions, grid, problem.horizon, **options, **more)
        )
    return found


def apart(fine, refined, near):
    """The largest and the mean difference where the value is that near zero; nodes of which it
    differs whether they are in the set."""
    assert refined.grid == fine.grid
    gap = np.abs(fine.values() - refined.values())[np.abs(fine.values()) <= near]
    sides = (fine.values() > 0) != (refined.values() > 0)
    return gap.max(), gap.mean(), int(sides.sum())


@pytest.mark.few("weno5-float64")
@pytest.mark.parametrize(
    ("scheme", "precision"), [("upwind", "float32"), ("eno2", "float64"), ("weno5", "float64")]
)
def test_blocks_all_over_the_grid_give_its_values_to_the_bit(scheme, precision, monkeypatch):
    """Nodes along an axis are no whole number of blocks, steps no whole number of intervals."""
    everywhere = lambda self, *_: np.ones(self.counts, dtype=bool)  # noqa: E731
    monkeypatch.setattr(Blocks, "near", everywhere)
    for problem, cells in ((braking(), (18, 21)), (unstable(3, 6, 1), (6, 7, 8))):
        short = replace(problem, horizon=0.7)
        fine, refined = pair(short, cells, scheme=scheme, precision=precision)
        assert (fine.values() == refined.values()).all()
        assert refined.report.marched_share > 1.0  # with the nodes of the coarser grid


@pytest.mark.few("braking-cells0-upwind-2-0.3-0.1-8", "zermelo-cells3-weno5-2-0.01-0.001-1")
@pytest.mark.parametrize(
    ("make", "cells", "scheme", "refine", "largest", "mean", "sides"),
    [
        (braking, (40, 40), "upwind", 2, 0.30, 0.10, 8),
        (braking, (26, 26), "eno2", 4, 0.03, 0.003, 0),
        (turning, (30, 32), "weno5", 2, 0.02, 0.002, 0),  # around the whole turn, and limited
        (zermelo, (48, 40), "weno5", 2, 0.01, 0.001, 1),  # a basin, which grows
        (lambda: unstable(1, 40, 1), (40,), "weno5", 4, 0.02, 0.005, 0),
        (lambda: unstable(3, 16, 1), (16, 16, 16), "eno2", 2, 0.01, 0.001, 0),
    ],
)
def test_refined_value_is_that_of_the_finer_grid_near_the_boundary(
    make, cells, scheme, refine, largest, mean, sides
):
    """Within these shares of a cell, up to two cells from the boundary."""
    problem = make()
    fine, refined = pair(problem, cells, refine, scheme=scheme)
    cell = max(a.step for a in fine.grid.axes)
    gaps = apart(fine, refined, 2 * cell)
    assert gaps[0] <= largest * cell
    assert gaps[1] <= mean * cell
    assert gaps[2] <= sides
    assert refined.report.refine == refine


def test_error_of_a_refined_set_falls_as_that_of_the_finer_grid():
    """Braking before two walls, area (16/3) sqrt(w): half the cells near the boundary."""
    problem = braking()
    errors = []
    for cells in (16, 32):
        fine, refined = pair(problem, (cells, cells), scheme="weno5")
        errors.append([abs(v.volume() / problem.volume - 1) for v in (fine, refined)])
        assert errors[-1][1] == pytest.approx(errors[-1][0], rel=0.02)
    assert math.log2(errors[0][1] / errors[1][1]) > 1.2


def test_finer_grids_have_a_smaller_share_of_their_nodes_near_the_boundary():
    shares = []
    for cells in doubled(30, 30):
        problem = zermelo()
        _, refined = pair(problem, cells, scheme="upwind")
        shares.append(refined.report.marched_share)
    assert shares[0] > 1.5 * shares[1] > 2.2 * shares[2]
    assert shares[2] < 0.3


def invariant(expression, horizon, cells, **options):
    """What is left of { expression > 0 } where y is pushed at up to 1/s, x stands still."""
    still = hf.System(
        "pushed", quantities("x", "y"), (), {"x": sp.Integer(0), "y": D},
        disturbances=quantities("d"), disturbance_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    box = {"x": (-1.5, 1.5), "y": (-1.5, 1.5)}
    about = region(-expression, sp.Abs(X) - 1.2, reads=("x", "y"))
    grid = hf.grid(still, box, cells + 1)
    return hf.invariance_kernel(still, about, grid, horizon, scheme="eno2", **options)


def test_front_that_comes_from_an_end_of_the_grid_is_no_further_back_than_on_the_finer_grid():
    """Of the population what goes beyond x = 3 is lost; behind that front the value goes on to fall
    with the nodes at the end of the grid, and of the states called safe no more are lost."""
    problem = replace(population(), horizon=2.0)
    fine, refined = pair(problem, (40, 40), scheme="upwind")
    states = np.random.default_rng(0).uniform((0.1, -2.1), (3.1, 2.1), (20_000, 2))
    lost = problem.value(*states.T) <= 0
    false = [float((v.contains(states) & lost).mean()) for v in (fine, refined)]
    assert false[1] <= 1.1 * false[0]
    outside = [v.at([[2.5, 1.8], [1.5, 2.1]]) for v in (fine, refined)]
    assert outside[1] == pytest.approx(outside[0], rel=0.05)
    assert outside[1].max() < -1.39  # and no less than -1.4, where a kept set's value is cut off


@pytest.mark.parametrize("refine", [2, 4])
def test_set_that_falls_apart_is_followed_on_both_sides(refine):
    """A waist of 0.3 + x^2/2 - t is gone after 0.3 s: |x| > sqrt(2t - 0.6) is left."""
    waist = sp.Rational(3, 10) + X**2 / 2 - sp.Abs(Y)
    found = invariant(waist, 0.4, 48, refine=refine)
    edge = math.sqrt(0.2)
    cell = found.grid.axes[0].step
    assert not found.contains(
        [[0.0, 0.0], [edge - 1.5 * cell, 0.0], [-edge + 1.5 * cell, 0.0]]
    ).any()
    assert found.contains([[edge + 1.5 * cell, 0.0], [-edge - 1.5 * cell, 0.0]]).all()
    whole = invariant(waist, 0.4, 48 * refine)
    assert apart(whole, found, 2 * cell)[0] < 0.5 * cell
    other = (whole.values() > 0) != (found.values() > 0)
    assert (np.abs(found.values()[other]) < 0.15 * cell).all()


def test_set_of_which_nothing_is_left_is_empty_on_both_grids():
    waist = sp.Rational(3, 10) + X**2 / 8 - sp.Abs(Y)
    found = invariant(waist, 0.8, 48, refine=2)
    assert found.report.empty
    assert found.report.converged
    assert not (found.values() > 0).any()
    assert found.report.reached_s == pytest.approx(
        invariant(waist, 0.8, 96).report.reached_s, abs=0.1
    )


def test_refined_march_comes_to_rest_at_the_kernel_of_the_finer_grid():
    fine, refined = pair(turning(), (30, 32), scheme="eno2")
    assert refined.report.converged == fine.report.converged
    assert refined.report.residual_cells < 0.01


def test_values_at_several_times_are_those_of_the_finer_grid():
    fine, refined = pair(zermelo(), (36, 30), scheme="eno2", times=[0.4, 0.8])
    for time in (0.4, 0.8, 1.2):
        gap = np.abs(fine.values(time) - refined.values(time))[np.abs(fine.values(time)) < 0.1]
        assert gap.max() < 0.005


@pytest.mark.parametrize(
    "find",
    [hf.forward_reachable_set, hf.backward_reachable_tube, hf.backward_reachable_at],
)
def test_reachable_sets_are_those_of_the_finer_grid(find):
    """A cart that begins, or is to arrive, within a disk; against a disturbance it is filtered, with
    a leeway that is larger on the coarser grid."""
    inside = hf.Inequality("disk", X**2 + V**2 - 0.1)
    disk = hf.Region("disk", carts.STATES, (inside,), empirical="a disk of numbers")
    problem = replace(braking(), find=find, system=carts.cart(), regions=(disk,), horizon=0.5)
    problem = replace(problem, box={"x": (-1.6, 1.6), "v": (-1.6, 1.6)}, ends=None)
    fine, refined = pair(problem, (32, 32), scheme="eno2")
    cell = fine.grid.axes[0].step
    gaps = apart(fine, refined, 2 * cell)
    assert gaps[0] < (0.02 if find is hf.forward_reachable_set else 0.025) * cell
    assert gaps[2] <= 1
    assert refined.report.marched_share < 0.9


def test_four_states_are_refined_as_two():
    """Of an unstable vehicle, all axes of which are cut into blocks."""
    problem = replace(unstable(4, 9, 1), horizon=0.3)
    fine, refined = pair(problem, (9, 9, 9, 9), scheme="eno2")
    gaps = apart(fine, refined, 2 * max(a.step for a in fine.grid.axes))
    assert gaps[0] < 0.05 * max(a.step for a in fine.grid.axes)
    assert gaps[2] == 0


def test_least_times_come_from_the_finer_grid():
    fine, refined = pair(zermelo(), (36, 30), scheme="eno2", arrival_steps=20)
    known = np.isfinite(fine.dataset["arrival"].values)
    gap = np.abs(fine.dataset["arrival"].values - refined.dataset["arrival"].values)[known]
    assert np.nanmax(gap) < 0.01
    assert np.isnan(gap).sum() == 0


@pytest.mark.heavy
def test_refined_value_is_looked_up_saved_and_eroded_as_any_other(tmp_path):
    system = carts.cart()
    grid = hf.grid(system, carts.BOX, 33)
    found = hf.discriminating_kernel(
        system, carts.WALLS, grid, 5, scheme="eno2", refine=2, estimate_error=True
    )
    assert found.grid.shape == (65, 65)
    assert found.report.error_cells is not None
    again = hf.load(found.save(tmp_path / "kernel.nc"))
    state = [[0.5, 0.3]]
    assert again.at(state) == found.at(state)
    assert again.report.refine == 2
    assert found.gradient(state)[0] == pytest.approx([-1.0, -0.6], abs=0.02)
    inner = found.inner()
    assert 0 < inner.volume() < found.volume() < 16 / 3 * math.sqrt(0.5)
    run = hf.simulate(
        system, hf.safety_law(system, found, sample_time=0.01), starts=[[0.5, 0.6]],
        region=carts.WALLS, horizon=3.0, sample_time=0.01, disturbance={"d": 0.5},
    )  # fmt: skip
    assert run.arrays["outcome"].values[0] != hf.Outcome.LEFT


def test_scenario_is_refined_by_its_table_march():
    coarse = ["grid.nodes=9", "march.times=2", "march.scheme=eno2", "march.refine=2"]
    scenario = load_scenario("ch7-discriminating", coarse)
    value = scenario.solve()
    assert value.grid.shape == scenario.begun.grid.shape == (17, 17, 17)
    assert value.summary()["refine"] == 2
    fine = load_scenario(
        "ch7-discriminating", ["grid.nodes=17", "march.times=2", "march.scheme=eno2"]
    ).solve()
    assert value.volume() == pytest.approx(fine.volume(), rel=0.01)


def test_rate_that_is_not_finite_between_nodes_of_the_coarser_grid_is_named():
    """x' = 1/(x - 1/8) at a node of the finer grid only."""
    system = hf.System(
        "pole", quantities("x"), quantities("u"), {"x": 1 / (X - sp.Rational(1, 8)) + hf.symbol("u")},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-2, 2)}, 17)
    walls = region(X - 1, -1 - X)
    with pytest.raises(SimulationError, match=r"not finite at x = 0\.125"):
        hf.viability_kernel(system, walls, grid, 1.0, refine=2)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"refine": 3}, "refine: 3"),
        ({"refine": True}, "refine: True"),
        ({"refine": 2.0}, r"refine: 2\.0"),
        ({"refine": 0}, "refine: 0"),
        ({"refine": 2, "symmetry": {"x": -1, "v": -1}}, "refine with symmetry"),
        ({"refine": 2, "checkpoint": "k.checkpoint"}, "refine with checkpoint"),
        ({"refine": 2, "check_outside": True}, "refine with check_outside"),
        ({"refine": 2, "until": lambda value: False}, "begin or until with refine"),
        ({"refine": 2, "disturbance": {"d": 0.2 * sp.sin(hf.TIME)}}, "depends on time"),
    ],
)
def test_refinement_that_cannot_be_is_refused_with_the_reason(options, what):
    system = carts.cart()
    grid = hf.grid(system, carts.BOX, 21)
    find = hf.viability_kernel if "disturbance" in options else hf.discriminating_kernel
    with pytest.raises(SimulationError, match=what):
        find(system, carts.WALLS, grid, 1.0, **options)


def test_memory_of_a_refined_march_is_at_most_that_of_both_grids():
    grid = hf.grid(carts.cart(), carts.BOX, 21)
    most = hf.march_memory(grid, refine=2, scheme="weno5")
    assert most == 5 * 8 * (41**2 + 21**2)


def test_several_times_of_a_march_of_first_order_on_refined_grids_are_those_of_the_finer_grid():
    """Its arrays change places with every step, and some intervals have an odd number of steps."""
    times, box = [0.1, 0.2, 0.35, 0.5], dict.fromkeys("xy", (-0.4, 1.6))
    states = tuple(hf.Quantity(n) for n in "xy")
    x, y, u = (hf.symbol(n) for n in "xyu")
    system = hf.System(
        "unstable", states, (hf.Quantity("u"),), {"x": 2 * x + u, "y": -x + y},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    region = hf.Region("disc", states, (hf.Inequality("edge", x**2 + y**2 - 0.12),))
    options = {"scheme": "upwind", "order": 1, "times": times}
    coarse, fine = (hf.grid(system, box, n) for n in (11, 41))
    refined = hf.viability_kernel(system, region, coarse, 0.7, refine=4, **options)
    whole = hf.viability_kernel(system, region, fine, 0.7, **options)
    for time in (*times, 0.7):
        assert ((refined.values(time) > 0) == (whole.values(time) > 0)).all()
