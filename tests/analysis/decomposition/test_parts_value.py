"""Sets put together from those of parts, beside the set on the grid of all states."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from holdfast.maths.expressions.functions import least
from tests.parted_systems import Q, box, late_cart, plane, symbols, towed, walls

PLANE = box("x", "vx", "y", "vy")


def states(intervals, count=4000, seed=0):
    low, high = np.array(list(intervals.values())).T
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


def test_two_parts_have_the_values_of_the_four_states():
    found = hf.solve_parts(hf.decompose(plane(), walls("x", "y")), PLANE, 15, 2.0)
    whole = hf.discriminating_kernel(plane(), walls("x", "y"), hf.grid(plane(), PLANE, 15), 2.0)
    points = states(PLANE)
    apart, together = found.contains(points), whole.contains(points)
    assert together.mean() > 0.1
    assert (apart != together).mean() < 0.02
    # within a cell of the boundary on the grid of four states
    assert np.abs(whole.at(points[apart != together])).max() < whole.report.cell


def test_a_set_put_together_with_a_state_cut_off_is_inside_the_set():
    system, region = towed(), walls("x")
    over = {**box("x", "v"), "w": (-0.9, 0.9)}
    found = hf.solve_parts(hf.decompose(system, region, cut={"w": None}), box("x", "v"), 41, 3.0)
    whole = hf.viability_kernel(
        system, region, hf.grid(system, over, {"x": 41, "v": 41, "w": 11}, {"w": "limited"}), 3.0
    )
    points = states(over)
    inside = found.contains(points)
    assert whole.at(points[inside]).min() > -whole.report.cell / 2
    assert inside.sum() > 0.75 * whole.contains(points).sum()


@pytest.mark.few("1.0")
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_predicted_cart_keeps_most_of_the_kernel_of_its_three_states(share):
    system, region = late_cart(0.2), walls("x")
    over = {**box("x", "v"), "actual_u": (-1.0, 1.0)}
    parted = hf.decompose(system, region, lag_share=share, box=box("x", "v", at=1.5))
    found = hf.solve_parts(parted, None, 61, 4.0)
    nodes = {"x": 41, "v": 41, "actual_u": 11}
    whole = hf.viability_kernel(
        system, region, hf.grid(system, over, nodes, {"actual_u": "limited"}), 4.0
    )
    points = states(over, 20_000)
    inside = found.contains(points)
    assert whole.at(points[inside]).min() > -whole.report.cell / 2
    within = np.abs(points[:, 2]) <= share
    kept = inside[within].sum() / whole.contains(points[within]).sum()
    assert kept > {0.5: 0.7, 1.0: 0.88}[share]
    assert not inside[~within].any()


def test_either_target_may_be_reached():
    x, y = symbols("x y")
    either = hf.Region(
        "either", (Q("x"), Q("y")), (hf.Inequality("near", least(x**2 - 0.1, y**2 - 0.1)),)
    )
    system = plane(push=0.0)
    found = hf.solve_parts(
        hf.decompose(system, either, kind="backward-reachable-tube"), PLANE, 15, 0.6
    )
    whole = hf.backward_reachable_tube(system, either, hf.grid(system, PLANE, 15), 0.6)
    points = states(PLANE)
    assert (found.contains(points) != whole.contains(points)).mean() < 0.03


@pytest.mark.few("1")
@pytest.mark.parametrize("seed", range(4))
def test_random_chains_are_inside_their_kernel(seed):
    """x' = a x + b y + u, y' = c y + e w + p, w' = g - f w, with w cut off."""
    draw = np.random.default_rng(seed)
    a, b, c, e = draw.uniform(-0.6, 0.6, 4)
    f, push = draw.uniform(0.5, 2), draw.uniform(0, 0.2)
    x, y, w, u, p, g, d = symbols("x y w u p g d")
    system = hf.System(
        "chain", (Q("x"), Q("y"), Q("w")), (Q("u"), Q("p"), Q("g")),
        {"x": a * x + b * y + u, "y": c * y + e * w + p + d, "w": g - f * w},
        disturbances=(Q("d"),),
        input_bounds=hf.Box((-0.5, -0.5, -0.4), (0.5, 0.5, 0.4)),
        disturbance_bounds=hf.Box((-push,), (push,)),
    )  # fmt: skip
    region = walls("x", "y")
    parted = hf.decompose(system, region, kind="discriminating-kernel", cut={"w": None})
    over = {"x": (-1.2, 1.2), "y": (-1.2, 1.2)}
    found = hf.solve_parts(parted, over, 21, 2.0)
    end = 0.4 / f
    grid = hf.grid(system, {**over, "w": (-end, end)}, {"x": 21, "y": 21, "w": 9}, {"w": "limited"})
    whole = hf.discriminating_kernel(system, region, grid, 2.0)
    points = states({**over, "w": (-end, end)})
    inside = found.contains(points)
    assert inside.any()
    assert whole.at(points[inside]).min() > -whole.report.cell / 2


def test_two_states_that_are_cut_off_from_each_other_are_inside_their_kernel():
    """x' = x + .6 y + u, y' = y - .6 x cos(y) + p: both leave by themselves, each is kept."""
    x, y, u, p = symbols("x y u p")
    system = hf.System(
        "pair", (Q("x"), Q("y")), (Q("u"), Q("p")),
        {"x": x + 0.6 * y + u, "y": y - 0.6 * x * sp.cos(y) + p},
        input_bounds=hf.Box((-1.5, -1.5), (1.5, 1.5)),
    )  # fmt: skip
    over = box("x", "y")
    parted = hf.decompose(system, walls("x", "y"), cut={"x": None, "y": None})
    assert [p.system.state_names for p in parted.parts] == [("x",), ("y",)]
    found = hf.solve_parts(parted, over, 61, 3.0)
    whole = hf.viability_kernel(system, walls("x", "y"), hf.grid(system, over, 61), 3.0)
    points = states(over)
    inside = found.contains(points)
    assert inside.sum() > 0.5 * whole.contains(points).sum()
    assert whole.at(points[inside]).min() > -whole.report.cell / 2


def test_the_gradient_is_that_of_the_part_that_decides():
    found = hf.solve_parts(hf.decompose(plane(), walls("x", "y")), PLANE, 15, 0.5)
    slopes = found.gradient([[0.8, 0.1, 0.0, 0.0], [0.0, 0.0, -0.8, 0.1]])
    assert (slopes[[0, 1], [0, 2]] * [1, -1] < 0).all()
    assert not slopes[0, 2:].any()
    assert not slopes[1, :2].any()


def test_no_state_outside_the_region_is_in_its_kernel_on_the_coarsest_grid():
    square = hf.symbol("x") ** 2
    ring = hf.Region("ring", (Q("x"),), (hf.Inequality("ring", square - 0.3),))
    found = hf.solve_parts(hf.decompose(plane(), ring), box("x", "vx"), 7, 0.1)
    points = np.zeros((200, 4))
    points[:, 0] = np.linspace(-1.2, 1.2, 200)
    assert (found.at(points) <= 0.3 - points[:, 0] ** 2 + 1e-12).all()


def test_a_wall_that_moves_is_kept_by_its_part_at_every_time():
    x, y = symbols("x y")
    rows = {"right": x - 1 + 0.3 * hf.TIME, "left": -1 - x, "top": y - 1, "bottom": -1 - y}
    region = hf.Region(
        "closing", (Q("x"), Q("y")), tuple(hf.Inequality(n, e) for n, e in rows.items())
    )
    found = hf.solve_parts(hf.decompose(plane(), region), PLANE, 15, 1.0, start_time=0.5)
    grid = hf.grid(plane(), PLANE, 15)
    whole = hf.discriminating_kernel(plane(), region, grid, 1.0, start_time=0.5)
    points = states(PLANE)
    assert whole.contains(points).mean() > 0.1
    assert (found.contains(points) != whole.contains(points)).mean() < 0.03


def test_a_value_at_an_earlier_time_is_that_of_a_shorter_problem():
    parted = hf.decompose(plane(), walls("x", "y"))
    found = hf.solve_parts(parted, PLANE, 15, 1.0, times=[0.0, 0.5, 1.0])
    shares = [found.contains(states(PLANE), time=t).mean() for t in (0.0, 0.5, 1.0)]
    assert shares == sorted(shares, reverse=True)
    short = hf.solve_parts(parted, PLANE, 15, 0.5)
    assert (short.contains(states(PLANE)) == found.contains(states(PLANE), time=0.5)).mean() > 0.99


def test_every_part_gives_its_own_inputs():
    found = hf.solve_parts(hf.decompose(plane(), walls("x", "y")), PLANE, 15, 0.5)
    inputs = found.inputs([[0.8, 0.3, -0.8, -0.3]])
    assert inputs.tolist() == [[-1.0, 1.0]]


def test_states_outside_the_domain_are_not_contained():
    found = hf.solve_parts(
        hf.decompose(towed(), walls("x"), cut={"w": None}), box("x", "v"), 15, 0.5
    )
    assert found.contains([[0, 0, 0.5], [0, 0, 0.95]]).tolist() == [True, False]


def test_a_grid_without_room_around_the_box_is_refused():
    parted = hf.decompose(
        late_cart(), walls("x"), lag_share=1.0, box={"x": (-1.5, 1.5), "v": (-2, 2)}
    )
    with pytest.raises(SimulationError, match="a cell further on either side"):
        hf.solve_parts(parted, {"x": (-1.5, 1.5), "v": (-2, 2)}, 21, 1.0)
    with pytest.raises(SimulationError, match="shape"):
        hf.solve_parts(parted, None, 21, 0.2).at([[0.0, 0.0]])


def test_region_of_predicted_states_beyond_the_box_is_kept_within_it():
    """Between walls at 1 m the predicted place is up to 1.58 m."""
    x, v, u = (hf.symbol(n) for n in ("x", "v", "u"))
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"x": v, "v": u}, input_bounds=hf.Box((-0.94,), (0.7,)),
    )  # fmt: skip
    late = hf.lagged(cart, {"u": 0.37})
    rows = (hf.Inequality("left", -1 - x, "m"), hf.Inequality("right", x - 1, "m"))
    room = hf.Region("room", cart.states[:1], rows)

    within = {"x": (-1.5, 1.5), "v": (-2, 2)}
    parts = hf.decompose(late, room, kind="viability-kernel", lag_share=0.74, box=within)
    assert hf.solve_parts(parts, None, nodes=41, horizon=0.5).contains([[0.0, 0.0, 0.0]]).all()


def test_points_of_an_input_are_taken_in_the_part_that_needs_them():
    """x' = u w, w' = c: the gain of the input is cut off, and the part that keeps it needs none."""
    x, w, u, c = symbols("x w u c")
    system = hf.System(
        "gain", (Q("x"), Q("w")), (Q("u"), Q("c")), {"x": x / 2 + u * w, "w": c},
        input_bounds=hf.Box((-1, -0.4), (1, 0.4)),
    )  # fmt: skip
    rows = {"low": -1 - x, "high": x - 1, "weak": 0.6 - w, "strong": w - 1.2}
    region = hf.Region(
        "room", (Q("x"), Q("w")), tuple(hf.Inequality(n, e) for n, e in rows.items())
    )
    over = {"x": (-1.2, 1.2), "w": (0.4, 1.4)}
    found = hf.solve_parts(hf.decompose(system, region, cut={"w": None}), over, 41, 2.0, samples=3)
    whole = hf.viability_kernel(system, region, hf.grid(system, over, 41), 2.0)
    points = states(over)
    inside = found.contains(points)
    assert inside.sum() > 0.9 * whole.contains(points).sum()
    assert whole.at(points[inside]).min() > -whole.report.cell / 2
    with pytest.raises(DefinitionError, match="samples: 3"):
        hf.solve_parts(hf.decompose(plane(), walls("x")), box("x", "vx"), 15, 0.2, samples=3)


def test_what_a_guarantee_rests_on_is_not_changed_in_a_march():
    parted = hf.decompose(towed(), walls("x"), cut={"w": None})
    for given in ({"disturbance": {"w": 0.0}}, {"parameters": {"w": 0.0}}):
        with pytest.raises(SimulationError, match="of a march over parts"):
            hf.solve_parts(parted, box("x", "v"), 21, 0.5, **given)


def test_a_grid_whose_ends_are_not_checked_is_refused():
    parted = hf.decompose(
        late_cart(), walls("x"), lag_share=1.0, box={"x": (-1.5, 1.5), "v": (-2, 2)}
    )
    with pytest.raises(SimulationError, match="where actuators are predicted"):
        hf.solve_parts(parted, None, 21, 0.5, ends={"x": "extrapolated"})
