"""Sets of a point that goes at any mix of two velocities, from or into boxes: they are polygons.

A straight line leads wherever the point can get, so that with the velocities F, a goal G and a
convex region K the tube is the hull of G and G - T F, the basin that of G and G - s F for all s
within K, the forward set that of G and G + T F; a kernel is the part of K whose states a mix of F
takes to K in the whole horizon. The velocities nearly balance: along a the two fall by .005 to .2.
"""

import itertools

import numpy as np
import pytest
import sympy as sp
from exact import nearly_balanced
from scipy.spatial import ConvexHull

import holdfast as hf
from holdfast.analysis.reachability import one_march

NODES = 61
UNIT = np.array(list(itertools.product((0.0, 1.0), repeat=2)))


def drawn(seed):
    """Two velocities that nearly balance, a goal, and a grid."""
    rng = np.random.default_rng(seed)
    velocities = nearly_balanced(rng)
    low = rng.uniform(0.35, 0.6, 2)
    goal = low + UNIT * rng.uniform(0.12, 0.3, 2)
    box = {n: (-rng.uniform(0.03, 0.15), 1 + rng.uniform(0.03, 0.15)) for n in "xy"}
    return velocities, goal, box


def outwards(*points):
    """Rows n and sides b of n . q <= b, of the hull of points."""
    rows = ConvexHull(np.vstack(points)).equations
    return rows[:, :2], -rows[:, 2]


def box_of(name, system, corners):
    low, high = corners.min(axis=0), corners.max(axis=0)
    rows = [
        hf.Inequality(f"{side}_{q.name}", e)
        for k, q in enumerate(system.states)
        for side, e in (("low", float(low[k]) - q.symbol), ("high", q.symbol - float(high[k])))
    ]
    return hf.Region(name, system.states, tuple(rows))


def two_velocities(kind, seed, nodes, wider=None):
    """The system, the corners of the goal, the grid, and the goal and the square as regions.

    wider: how far the grid of a kernel goes beyond the square, if that is not drawn."""
    (f, g), goal, box = drawn(seed)
    if wider is not None:
        box = dict.fromkeys("xy", (-wider, 1 + wider))
    m = hf.symbol("m")
    system = hf.System(
        "two velocities", tuple(hf.Quantity(n) for n in "xy"), (hf.Quantity("m"),),
        {n: float(f[k]) + float(g[k] - f[k]) * m for k, n in enumerate("xy")},
        input_bounds=hf.Box((0,), (1,)),
    )  # fmt: skip
    if kind not in ("kernel", "basin"):
        box = dict.fromkeys("xy", (-0.4, 1.6))  # nothing comes to its ends
    ends = {} if kind == "kernel" else dict.fromkeys("xy", "extrapolated")
    grid = hf.grid(system, box, nodes=nodes, ends=ends)
    return system, goal, grid, box_of("goal", system, goal), box_of("square", system, UNIT)


def apart(kind, seed, scheme, horizon=0.35, nodes=NODES, wider=None, **further):
    """Cells by which the set goes beyond the exact one, and by which it falls short of it."""
    (f, g), *_ = drawn(seed)
    system, goal, grid, to, within = two_velocities(kind, seed, nodes, wider)
    options = {"scheme": scheme} | further
    back = [goal - horizon * f, goal - horizon * g]
    if kind == "tube":
        value = hf.backward_reachable_tube(system, to, grid, horizon, **options)
        sides = [outwards(goal, *back)]
    elif kind == "at":
        value = hf.backward_reachable_at(system, to, grid, horizon, **options)
        sides = [outwards(*back)]
    elif kind == "forward":
        value = hf.forward_reachable_set(system, to, grid, horizon, **options)
        sides = [outwards(goal, goal + horizon * f, goal + horizon * g)]
    elif kind == "basin":
        value = hf.capture_basin(system, to, within, grid, 20.0, arrival_steps=0, **options)
        sides = [outwards(UNIT), outwards(goal, goal - 30 * f, goal - 30 * g)]
    else:
        value = hf.viability_kernel(system, within, grid, horizon, **options)
        sides = [outwards(UNIT), outwards(UNIT - horizon * f, UNIT - horizon * g)]
    axes = [a.nodes for a in value.grid.axes]
    at = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = np.mean([a.step for a in grid.axes])
    depth = np.min([(b - at @ n.T).min(axis=1) for n, b in sides], axis=0) / cell
    inside = value.values().ravel() > 0
    return -depth[inside].min(initial=0.0), depth[~inside].max(initial=0.0)


@pytest.mark.parametrize("kind", ["tube", "at", "forward", "basin"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.heavy) for s in (1, 2))])
def test_sets_without_an_opponent_are_exact_to_a_cell(kind, seed):
    assert max(apart(kind, seed, "weno5")) < 1.0


OFF = {"weno5": 0.7, "eno3": 1.8, "eno2": 1.8}
WORST = {"weno5": "forward", "eno3": "at", "eno2": "basin"}


@pytest.mark.heavy
@pytest.mark.parametrize("scheme", OFF)
@pytest.mark.parametrize("kind", ["tube", "at", "forward", "basin"])
def test_sets_without_an_opponent_are_exact_to_two_cells_by_every_scheme(kind, scheme):
    """Of 14 sets the largest distance, in cells."""
    off = max(max(apart(kind, seed, scheme)) for seed in range(14))
    assert off <= OFF[scheme]
    assert kind != WORST[scheme] or off == pytest.approx(OFF[scheme], abs=0.1)


def opposed(kind, seed, scheme, horizon):
    """Cells beyond and short, as `apart`, where the foe has the mix: at the horizon in a box, which
    is a cut of polygons, or away from it, where the rest is a hull."""
    (f, g), *_ = drawn(seed)
    m = hf.symbol("m")
    system = hf.System(
        "two velocities", tuple(hf.Quantity(n) for n in "xy"), (),
        {n: float(f[k]) + float(g[k] - f[k]) * m for k, n in enumerate("xy")},
        disturbances=(hf.Quantity("m"),), disturbance_bounds=hf.Box((0,), (1,)),
    )  # fmt: skip
    corners = 1.2 * UNIT - 0.1
    target = box_of("box", system, corners)
    back = [corners - horizon * f, corners - horizon * g]
    sides, sign = [outwards(b) for b in back], 1
    if kind == "away":  # by no more than counts here: beyond the grid there is more
        out = sp.Max(-0.2, sp.Min(*(-i.expression for i in target.inequalities)))
        target = hf.Region("away", system.states, (hf.Inequality("away", out),))
        sides, sign = [outwards(*back)], -1
    wide = 0.6 + horizon * max(abs(f).max(), abs(g).max())
    box, ends = (0.5 - wide, 0.5 + wide), dict.fromkeys("xy", "extrapolated")
    grid = hf.grid(system, dict.fromkeys("xy", box), nodes=NODES, ends=ends)
    value = hf.backward_reachable_at(system, target, grid, horizon, scheme=scheme)
    at = np.stack(np.meshgrid(*[a.nodes for a in grid.axes], indexing="ij"), axis=-1)
    rows = [(b - at.reshape(-1, 2) @ n.T).min(axis=1) for n, b in sides]
    depth = sign * np.min(rows, axis=0) / grid.axes[0].step
    inside = value.values().ravel() > 0
    assert inside.any()
    return -depth[inside].min(), depth[~inside].max()


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.heavy) for s in range(1, 14))]
)
@pytest.mark.parametrize(("kind", "horizon"), [("at", 0.35), ("away", 0.35), ("away", 1.0)])
def test_sets_of_an_instant_are_exact_to_about_a_cell_against_a_foe(kind, horizon, seed):
    for scheme in ("weno5", "eno3", "eno2"):
        assert max(opposed(kind, seed, scheme, horizon)) < 1.2


BEYOND = {"weno5": (17.6, 1.9), "eno3": (17.6, 1.8), "eno2": (17.6, 3.4)}


@pytest.mark.heavy
@pytest.mark.parametrize("scheme", BEYOND)
def test_a_kernel_of_a_finite_horizon_is_too_large_by_few_cells(scheme, monkeypatch):
    """Of 14 sets after 4 s the largest distance, without the filter and with it."""

    def unheld(values, *_):
        return ((planes, values[planes]) for planes in one_march._some_planes(values))

    cut = max(apart("kernel", seed, scheme, 4.0)[0] for seed in range(14))
    monkeypatch.setattr(one_march, "_held", unheld)
    bare = max(apart("kernel", seed, scheme, 4.0)[0] for seed in range(14))
    assert (bare, cut) == pytest.approx(BEYOND[scheme], abs=0.2)


@pytest.mark.heavy
def test_a_kernel_of_a_finite_horizon_is_too_large_by_few_cells_on_finer_grids():
    beyond = max(apart("kernel", seed, "weno5", 4.0, nodes=121)[0] for seed in range(14))
    assert beyond == pytest.approx(1.3, abs=0.1)


@pytest.mark.heavy
def test_a_kernel_of_a_finite_horizon_is_larger_on_a_grid_three_cells_wider():
    beyond = max(
        apart("kernel", seed, "weno5", 4.0, nodes=55, wider=3 / 48)[0] for seed in range(14)
    )
    assert beyond == pytest.approx(5.4, abs=0.1)


@pytest.mark.heavy
@pytest.mark.parametrize("nodes", [NODES, pytest.param(121, marks=pytest.mark.heavy)])
def test_upwind_leaves_no_kernel_too_large(nodes):
    """Where constraints meet at a corner of the grid, what is beyond it falls too."""
    assert max(apart("kernel", seed, "upwind", 4.0, nodes=nodes)[0] for seed in range(14)) == 0.0


@pytest.mark.few("upwind-0.0-2.5-0", "upwind-0.0-2.5-1")
@pytest.mark.parametrize(
    "seed", [*range(2), *(pytest.param(s, marks=pytest.mark.heavy) for s in range(2, 6))]
)
@pytest.mark.parametrize(
    ("scheme", "beyond", "short"), [("upwind", 0.0, 2.5), ("weno5", 1.5, 1e-9)]
)
def test_grid_that_ends_where_constraints_meet_is_as_good_as_a_wider_one(
    seed, scheme, beyond, short
):
    """By so many cells the kernel after 4 s is too large or falls short, on 0 and 1 cells more."""
    for more in (0, 1):
        off = apart("kernel", seed, scheme, 4.0, nodes=49 + 2 * more, wider=more / 48)
        assert off[0] <= beyond
        assert off[1] <= short


@pytest.mark.few("eno2-41-seeds1")
@pytest.mark.parametrize(
    ("scheme", "nodes", "seeds"),
    [("weno5", 41, range(3)), ("eno2", 41, range(3))]
    + [
        pytest.param(s, n, range(40), marks=pytest.mark.heavy)
        for s in ("weno5", "eno3", "eno2")
        for n in (41, 61)
    ],
)
def test_no_state_is_kept_for_ever_where_none_can_be(scheme, nodes, seeds):
    for seed in seeds:
        system, _, grid, _, square = two_velocities("kernel", seed, nodes)
        assert hf.viability_kernel(system, square, grid, 600.0, scheme=scheme).report.empty


FURTHEST = 9
"""The seed of the set that the scheme without the filter leaves furthest beyond the exact one."""


@pytest.mark.few("{'on_disk': True}", "{'times': [2.0]}")
@pytest.mark.parametrize(
    "options",
    [{}, {"refine": 2}, {"precision": "float32"}, {"on_disk": True}, {"times": [2.0]}],
    ids=str,
)
def test_a_kernel_that_has_not_come_to_rest_is_filtered_too(options, tmp_path):
    if "on_disk" in options:
        options = {"on_disk": tmp_path}
    beyond, short = apart("kernel", FURTHEST, "weno5", 4.0, **options)
    assert beyond < 2.0
    assert short < 1.0


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("scheme", "share"), [("weno5", 0.993), pytest.param("eno3", 0.966, marks=pytest.mark.heavy)]
)
def test_what_goes_round_is_not_worn_off(scheme, share):
    """x'' = -9 x keeps the disc in a square, here for 14 turns on 61 nodes."""
    x, y, u = (hf.symbol(n) for n in "xyu")
    states = (hf.Quantity("x"), hf.Quantity("y"))
    system = hf.System(
        "rotation", states, (hf.Quantity("u"),), {"x": 3 * y, "y": -3 * x + u},
        input_bounds=hf.Box((-1e-9,), (1e-9,)),
    )  # fmt: skip
    square = box_of("square", system, 2 * UNIT - 1)
    grid = hf.grid(system, dict.fromkeys("xy", (-1.2, 1.2)), nodes=NODES)
    value = hf.viability_kernel(system, square, grid, 30.0, scheme=scheme)
    assert value.volume() / np.pi == pytest.approx(share, abs=0.003)
    assert value.report.filtered_share == 0.0
