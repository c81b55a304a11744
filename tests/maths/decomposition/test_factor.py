"""The smallest factor of a system that inequalities depend on."""

import holdfast as hf
from holdfast.maths.decomposition.grouping import factor
from holdfast.maths.expressions.functions import select
from tests.parted_systems import Q, pair, plane, symbols, walls


def test_states_on_which_nothing_depends_are_left_out():
    found = factor(plane(), walls("x").inequalities)
    assert found.system.state_names == ("x", "vx")
    assert found.system.input_names == ("ux",)
    assert found.system.disturbance_names == ("d",)


def test_two_vehicles_whose_distance_matters_are_seen_from_each_other():
    x1, x2, v1, v2 = symbols("x1 x2 v1 v2")
    found = factor(pair(), [hf.Inequality("near", 1 - (x2 - x1))])
    assert found.coordinates == {"x2_less_x1": x2 - x1, "v2_less_v1": v2 - v1}
    gap = hf.symbol("v2_less_v1")
    u1, u2 = symbols("u1 u2")
    assert found.system.rates == {"x2_less_x1": gap, "v2_less_v1": u2 - u1}


def test_a_distance_and_a_wall_need_every_position():
    x1, x2 = symbols("x1 x2")
    found = factor(pair(), [hf.Inequality("near", 1 - (x2 - x1)), hf.Inequality("wall", x1 - 3)])
    assert set(found.coordinates) == {"x1", "v1", "x2", "v2"}


def test_rates_that_differ_between_vehicles_keep_both_speeds():
    x1, x2, v1, v2, u1, u2 = symbols("x1 x2 v1 v2 u1 u2")
    dragged = hf.System(
        "dragged",
        pair().states,
        pair().inputs,
        {"x1": v1, "v1": u1 - v1, "x2": v2, "v2": u2 - 2 * v2},
        input_bounds=pair().input_bounds,
    )
    found = factor(dragged, [hf.Inequality("near", 1 - (x2 - x1))])
    assert set(found.coordinates) == {"x2_less_x1", "v1", "v2"}


def test_a_jump_in_a_state_is_a_dependence_on_it():
    x, y, u = symbols("x y u")
    system = hf.System(
        "switch", (Q("x"), Q("y")), (Q("u"),), {"x": u, "y": select(x, u, -u)},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    found = factor(system, [hf.Inequality("end", y - 1)])
    assert set(found.coordinates) == {"x", "y"}


def test_inequalities_without_states_have_no_factor():
    assert factor(plane(), [hf.Inequality("none", hf.parse_expression("-1", {}))]) is None
