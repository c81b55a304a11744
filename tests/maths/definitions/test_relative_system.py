"""The motion of another vehicle in the axes of ours, against both vehicles in the plane."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError

ROBOT = hf.systems.unicycle()
x, y, a, b = (hf.symbol(n) for n in ("x", "y", "a", "b"))
PLACE = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
WALKER = hf.System(
    "walker", PLACE, (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")), {"x": a, "y": b},
    input_bounds=hf.Ball(0.5, 2),
)  # fmt: skip


def _rates(system, **values):
    numbers = {hf.symbol(n): v for n, v in values.items()}
    numbers |= {p.symbol: p.value for p in system.parameters}
    return np.array([float(e.subs(numbers)) for e in system.rates.values()])


def _relative(ours, theirs):
    """Place and heading of the second in the axes of the first, from two poses."""
    (px, py, psi), (qx, qy, phi) = ours[:3], theirs[:3]
    dx, dy = qx - px, qy - py
    return np.array([
        np.cos(psi) * dx + np.sin(psi) * dy, np.cos(psi) * dy - np.sin(psi) * dx, phi - psi,
    ])  # fmt: skip


def _difference(system, ours, theirs, ours_does, theirs_does, common=None):
    """The rates of the relative pose, by a central difference along the motion of both."""
    names = (*system.state_names, *system.input_names)
    common = common or {}

    def rates(state, doing):
        return _rates(system, **dict(zip(names, [*state, *doing], strict=True)), **common)

    h = 1e-6
    v, w = rates(ours, ours_does), rates(theirs, theirs_does)
    ahead = _relative(ours + h * v, theirs + h * w)
    return (ahead - _relative(ours - h * v, theirs - h * w)) / (2 * h)


def test_the_relative_pose_moves_as_two_boats_do_in_one_current():
    boat = hf.systems.marine_vehicle()
    both = hf.relative_system(boat, boat, common=("Vx", "Vy"))
    assert both.disturbance_names == ("other_tau_u", "other_tau_r")
    generator = np.random.default_rng(0)
    for _ in range(5):
        ours, theirs = generator.uniform(-1, 1, (2, 6))
        doing, done = generator.uniform(-1, 1, (2, 2))
        current = {"Vx": 0.2, "Vy": -0.1}
        wanted = _difference(boat, ours, theirs, doing, done, current)
        seen = [*_relative(ours, theirs), *ours[3:], *theirs[3:], *doing, *done]
        names = (*both.state_names, *both.input_names, *both.disturbance_names)
        rates = _rates(both, **dict(zip(names, seen, strict=True)))
        assert rates[:3] == pytest.approx(wanted, abs=1e-8)
        alone = _rates(
            boat, **dict(zip(boat.state_names, theirs, strict=True)), tau_u=done[0],
            tau_r=done[1], **current,
        )  # fmt: skip
        assert rates[6:] == pytest.approx(alone[3:], rel=1e-12)


def test_each_sees_the_other_as_it_is_seen():
    both = hf.relative_system(ROBOT, ROBOT)
    forth = {"x_r": 0.7, "y_r": -0.4, "psi_r": 0.9, "v": 0.6, "r": -1.1}
    forth |= {"other_v": 0.3, "other_r": 0.8}
    rates = _rates(both, **forth)
    cos, sin = np.cos(0.9), np.sin(0.9)
    place = -np.array([[cos, sin], [-sin, cos]]) @ [0.7, -0.4]
    back = {"x_r": place[0], "y_r": place[1], "psi_r": -0.9, "v": 0.3, "r": 0.8}
    back |= {"other_v": 0.6, "other_r": -1.1}
    seen = _rates(both, **back)
    assert rates[2] == pytest.approx(-seen[2], rel=1e-12)
    nearer = (0.7 * rates[0] - 0.4 * rates[1], place @ seen[:2])
    assert nearer[0] == pytest.approx(nearer[1], rel=1e-12)


def test_the_game_of_two_cars_is_the_published_one():
    v, r, other_v, other_r = (hf.symbol(n) for n in ("v", "r", "other_v", "other_r"))
    x_r, y_r, psi_r = (hf.symbol(n) for n in ("x_r", "y_r", "psi_r"))
    rates = hf.relative_system(ROBOT, ROBOT).rates
    assert sp.simplify(rates["x_r"] - (-v + other_v * sp.cos(psi_r) + r * y_r)) == 0
    assert sp.simplify(rates["y_r"] - (other_v * sp.sin(psi_r) - r * x_r)) == 0
    assert rates["psi_r"] == other_r - r


def test_a_velocity_within_a_disc_is_turned_into_the_axes_of_the_vehicle():
    seen = hf.relative_system(ROBOT, WALKER)
    assert seen.state_names == ("x_r", "y_r")
    assert seen.rates["x_r"] == -hf.symbol("v") + hf.symbol("other_a") + hf.symbol("r") * hf.symbol(
        "y_r"
    )
    assert seen.disturbance_bounds == hf.Ball(0.5, 2)
    fixed = hf.relative_system(WALKER, ROBOT)
    assert fixed.rates["psi_r"] == hf.symbol("other_r")


def test_a_current_cancels_only_where_it_is_common():
    boat = hf.systems.drifting_unicycle()
    apart = hf.relative_system(boat, boat)
    assert apart.disturbance_names[:2] == ("Vx", "Vy")
    together = hf.relative_system(boat, boat, common=("Vx", "Vy"))
    assert together.disturbance_names == ("other_u", "other_r")
    assert {s.name for s in together.rates["x_r"].free_symbols} == {
        "other_u", "psi_r", "r", "u", "y_r",
    }  # fmt: skip


def test_what_has_no_relative_motion_is_refused_by_name():
    near_wall = hf.System(
        "slope", PLACE, WALKER.inputs, {"x": a + hf.symbol("steep") * x, "y": b},
        parameters=(hf.Parameter("steep", "1/s", value=0.1),), input_bounds=WALKER.input_bounds,
    )  # fmt: skip
    with pytest.raises(DefinitionError, match="rate of 'x' depends on the place 'x'"):
        hf.relative_system(near_wall, WALKER)
    wind = hf.Quantity("wind", "m/s")
    gusty = hf.System(
        "gusty", ROBOT.states, ROBOT.inputs, {**ROBOT.rates, "x": ROBOT.rates["x"] + wind.symbol},
        ROBOT.parameters, (wind,), ROBOT.input_bounds, hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    with pytest.raises(DefinitionError, match="wind, other_wind act along fixed directions"):
        hf.relative_system(gusty, gusty)
    assert hf.relative_system(gusty, gusty, common=("wind",)).disturbance_names == (
        "other_v", "other_r",
    )  # fmt: skip
    magnetic = hf.System(
        "compass", ROBOT.states, ROBOT.inputs,
        {**ROBOT.rates, "psi": hf.symbol("r") * sp.cos(hf.symbol("psi"))}, ROBOT.parameters,
        input_bounds=ROBOT.input_bounds,
    )  # fmt: skip
    with pytest.raises(DefinitionError, match="depend on where the vehicles head"):
        hf.relative_system(ROBOT, magnetic)
    endless = hf.System("endless", PLACE, WALKER.inputs, WALKER.rates)
    with pytest.raises(DefinitionError, match="inputs of 'endless' have no bounds"):
        hf.relative_system(ROBOT, endless)
    with pytest.raises(DefinitionError, match="has no place 'z'"):
        hf.relative_system(ROBOT, ROBOT, position=("x", "z"))
    with pytest.raises(DefinitionError, match="neither vehicle has a heading 'phi'"):
        hf.relative_system(ROBOT, ROBOT, heading="phi")
    with pytest.raises(DefinitionError, match="no disturbance 'Vx'"):
        hf.relative_system(ROBOT, ROBOT, common=("Vx",))
