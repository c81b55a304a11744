"""What a problem falls into, and what its parts say of the whole."""

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.maths.expressions.functions import angle, least
from tests.parted_systems import Q, late_cart, plane, symbols, towed, walls


def states_of(found):
    return [tuple(p.system.state_names) for p in found.parts]


def test_parts_without_a_common_input_make_up_the_kernel_exactly():
    found = hf.decompose(plane(), walls("x", "y"))
    assert states_of(found) == [("x", "vx"), ("y", "vy")]
    assert found.verdict == "exact"


THRUSTERS = hf.LinearImage(sp.Matrix([[1, 1], [1, -1]]), hf.Box((-1, -1), (1, 1)))


@pytest.mark.parametrize("bounds", [hf.Ball(1, 2), THRUSTERS])
def test_inputs_that_are_bounded_together_keep_the_states_together(bounds):
    found = hf.decompose(plane(bounds), walls("x", "y"))
    assert states_of(found) == [("x", "vx", "y", "vy")]
    assert any("one part" in r and "ux, uy" in r for r in found.reasons)


def test_two_states_that_one_input_moves_stay_together():
    u = hf.symbol("u")
    system = hf.System(
        "both", (Q("x"), Q("y")), (Q("u"),), {"x": u, "y": -u}, input_bounds=hf.Box((-1,), (1,))
    )
    found = hf.decompose(system, walls("x", "y"))
    assert len(found.parts) == 1


def test_what_no_choice_enters_falls_into_parts_whatever_is_shared():
    found = hf.decompose(plane(hf.Ball(1, 2)), walls("x", "y"), kind="invariance-kernel")
    assert states_of(found) == [("x", "vx"), ("y", "vy")]
    assert found.verdict == "exact"


def test_a_target_to_be_reached_at_any_time_is_not_taken_apart_and_at_one_time_is():
    tube = hf.decompose(plane(), walls("x", "y"), kind="backward-reachable-tube")
    assert len(tube.parts) == 1
    assert any("at different times" in r for r in tube.reasons)
    assert len(hf.decompose(plane(), walls("x", "y"), kind="backward-reachable-at").parts) == 2


def test_a_disturbance_that_helps_cannot_help_two_parts_differently():
    found = hf.decompose(plane(), walls("x", "y"), kind="backward-reachable-at", disturbances="max")
    assert len(found.parts) == 1


@pytest.mark.parametrize(("push", "verdict"), [(0.0, "exact"), (0.3, "inner")])
def test_either_of_two_targets_may_be_reached(push, verdict):
    x, y = symbols("x y")
    either = hf.Region(
        "either", (Q("x"), Q("y")), (hf.Inequality("near", least(x**2 - 0.1, y**2 - 0.1)),)
    )
    found = hf.decompose(plane(push=push), either, kind="backward-reachable-tube")
    assert [len(parts) for parts in found.alternatives] == [1, 1]
    assert found.verdict == verdict


def test_a_basin_keeps_what_the_goal_does_not_need_for_the_whole_horizon():
    found = hf.decompose(plane(), walls("y"), kind="capture-basin", goal=walls("x", at=0.2))
    assert [p.kind for p in found.parts] == ["capture-basin", "discriminating-kernel"]
    assert found.verdict == "inner"


def test_a_state_that_never_leaves_an_interval_disturbs_the_others():
    found = hf.decompose(towed(), walls("x"), cut={"w": None})
    assert states_of(found) == [("x", "v")]
    assert found.parts[0].cut == {"w": pytest.approx((-0.9, 0.9))}
    assert found.verdict == "inner"
    assert {c.name for c in found.domain} == {"w_low", "w_high"}


def test_a_state_that_the_region_bounds_is_kept_by_a_part_of_its_own():
    found = hf.decompose(towed(), walls("x", "w", at=0.5), cut={"w": None})
    assert states_of(found) == [("x", "v"), ("w",)]
    assert found.domain == ()
    assert found.parts[0].cut == {"w": (-0.5, 0.5)}


@pytest.mark.parametrize("interval", [(-0.5, 0.5), (-0.9, 0.8)])
def test_an_interval_that_a_state_leaves_is_refused(interval):
    with pytest.raises(SimulationError, match="not seen to stay within"):
        hf.decompose(towed(), walls("x"), cut={"w": interval})


def test_a_speed_without_a_bound_cannot_be_cut_off():
    with pytest.raises(SimulationError, match="no interval is known"):
        hf.decompose(towed(), walls("x"), cut={"v": None})


def test_a_constraint_of_a_basin_ends_with_the_arrival_and_guarantees_nothing():
    with pytest.raises(SimulationError, match="not seen to stay within"):
        hf.decompose(
            towed(), walls("w", at=0.5), kind="capture-basin", goal=walls("x"),
            cut={"w": (-0.5, 0.5)},
        )  # fmt: skip


def test_states_cut_off_do_not_help():
    with pytest.raises(SimulationError, match="do not"):
        hf.decompose(
            towed(), walls("x"), kind="backward-reachable-tube", disturbances="max", cut={"w": None}
        )


def test_seven_states_are_refused_on_a_grid_with_the_way_out():
    names = [f"x{k}" for k in range(7)]
    seven = hf.System("seven", tuple(Q(n) for n in names), (), dict.fromkeys(names, sp.S.Zero))
    with pytest.raises(SimulationError, match=r"take the problem apart \(hf.decompose"):
        hf.grid(seven, dict.fromkeys(names, (-1, 1)), 5)


def test_a_predicted_cart_is_kept_less_the_reach_of_its_force():
    found = hf.decompose(
        late_cart(0.2), walls("x"), lag_share=1.0, box={"x": (-1.3, 1.3), "v": (-2, 2)}
    )
    assert states_of(found) == [("x", "v")]
    rows = {c.name: c.expression for c in found.parts[0].region.inequalities}
    x, v = symbols("x v")
    assert sp.simplify(rows["x_high"] - (x - 0.2 * v + 0.04 - 1)) == 0
    assert found.verdict == "inner"


def test_the_description_names_parts_verdict_and_reasons():
    text = str(hf.decompose(plane(), walls("x", "y")))
    assert "part (x, vx) by ux: x_low, x_high" in text
    assert "exact: the set put together is the set itself" in text
    assert "Chen" in text


def test_inequalities_of_goal_and_region_are_told_apart_whatever_their_names():
    goal = hf.Region("goal", (Q("x"),), (hf.Inequality("near", hf.symbol("x") - 0.2),))
    region = hf.Region(
        "room", (Q("x"), Q("y")),
        (hf.Inequality("near", hf.symbol("y") - 1), hf.Inequality("near_1", hf.symbol("x") - 1)),
    )  # fmt: skip
    found = hf.decompose(plane(), region, kind="capture-basin", goal=goal)
    (basin,) = (p for p in found.parts if p.kind == "capture-basin")
    assert basin.goal.inequality_names == ("near",)
    assert basin.region.inequality_names == ("near_1",)


def test_an_alternative_that_always_holds_keeps_the_problem_whole():
    x, y = symbols("x y")
    region = hf.Region(
        "any", (Q("x"), Q("y")), (hf.Inequality("any", least(least(x, y), sp.Integer(-1))),)
    )
    assert len(hf.decompose(plane(), region, kind="backward-reachable-tube").alternatives) == 1


def test_an_angle_of_what_is_predicted_is_refused():
    x, v = symbols("x v")
    aim = hf.Region(
        "aim", (Q("x"), Q("v")), (hf.Inequality("aim", angle(x, v, sp.Float(1e-3)) - 1),)
    )
    with pytest.raises(SimulationError, match="does not bound"):
        hf.decompose(late_cart(), aim, lag_share=1.0, box={"x": (-1.5, 1.5), "v": (-2, 2)})
