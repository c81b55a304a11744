"""Corners: the exact circle, the radii that were tried, and what is refused."""

import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.planning.corners import (
    Convoy,
    chain_radii,
    critical_radius,
    follower_radius,
    lead_along,
    route_corners,
    turning_radii,
    zero_off_tracking_gain,
)
from holdfast.planning.environment import environment, plan_route, route_fields
from tests.planning.spaces import CORNER, box


def clearance(distance, width, robot, radius):
    """Of a follower on that circle, to the wall: from beside it to past the corner.

    The leader is at the origin; the free space of centres ends at y = -width / 2 for x < 0 less
    what the robot's disc needs about the corner of the wall, which is at (-robot, -width / 2 - robot).
    """
    s = math.sqrt(distance**2 - width**2 / 4)
    sine, cosine = width / (2 * distance), s / distance
    centre = np.array([-s + radius * sine, -width / 2 - radius * cosine])
    angles = np.linspace(math.atan2(cosine, -sine), 0.0, 20001)  # to where it is farthest along x
    x, y = centre[:, None] + radius * np.array([np.cos(angles), np.sin(angles)])
    beside = (x < -robot) & (y < 0)
    gap = np.where(beside, y + width / 2, np.hypot(x + robot, y + width / 2 + robot) - robot)
    return float(gap[x < 0.0].min())


@pytest.mark.parametrize(
    ("distance", "width", "robot", "printed", "exact", "inside"),
    [
        (1.0, 1.2, 0.2, 0.562, 0.5625, 0.0),
        (1.0, 0.8, 0.2, 0.932, 0.951, -0.007),
        (1.0, 1.6, 0.2, 0.317, 0.333, -0.030),
        (0.6, 1.0, 0.15, 0.160, 0.196, None),
    ],
)
def test_critical_circle_touches_the_corner_and_that_of_6_24_goes_into_it(
    distance, width, robot, printed, exact, inside
):
    theirs = critical_radius(distance, width, robot, as_printed=True)
    mine = critical_radius(distance, width, robot)
    assert theirs == pytest.approx(printed, abs=6e-4)
    assert mine == pytest.approx(exact, abs=6e-4)
    if inside is not None:
        assert clearance(distance, width, robot, mine) == pytest.approx(0.0, abs=1e-6)
        assert clearance(distance, width, robot, theirs) == pytest.approx(inside, abs=6e-4)
        assert clearance(distance, width, robot, 0.9 * mine) < -0.005


def farthest(distance, width, radius):
    """How far from the exit of the first corridor a leader gets on its circle, by drawing it.

    The follower is beside the wall at the exit and points at the leader, which is in the middle of
    it. Both turn about a centre abeam of the follower, on the side of the wall.
    """
    leader, follower = np.zeros(2), np.array([-math.sqrt(distance**2 - width**2 / 4), -width / 2])
    ahead = (leader - follower) / distance
    centre = follower + math.sqrt(radius**2 - distance**2) * np.array([ahead[1], -ahead[0]])
    assert math.hypot(*(leader - centre)) == pytest.approx(radius)
    angles = np.linspace(-math.pi, math.pi, 200_001)
    return float((centre[0] + radius * np.cos(angles)).max())


def test_6_25_has_the_wrong_sign_before_the_radius_of_the_follower():
    """RL <= w' + s + RF w / (2 rd): it is - RF w / (2 rd), and + s is right.

    rd 1, w 1.2, r0 .2: at RL = 2 the leader is at x = 2.24 m of a corridor 1.2 m wide.
    """
    mine, printed = (turning_radii(1.0, 1.2, 1.2, 0.2, as_printed=p) for p in (False, True))
    assert (mine.low, mine.high) == pytest.approx((1.147, 1.407), abs=1e-3)
    s, term = 0.8, printed.follower * 1.2 / 2
    assert printed.high == pytest.approx(1.2 + s + term) == pytest.approx(2.337, abs=1e-3)
    assert farthest(1.0, 1.2, mine.high) == pytest.approx(1.2, abs=1e-9)
    follower = critical_radius(1.0, 1.2, 0.2)
    centre = np.array([-0.8, -0.6]) + follower * np.array([0.6, -0.8])
    inwards = math.degrees(math.atan2(-centre[0], -centre[1]))
    assert inwards == pytest.approx(23.8, abs=0.05), "the tangent at the exit, from straight ahead"
    assert farthest(1.0, 1.2, 2.0) == pytest.approx(2.24, abs=0.01)
    least = math.hypot(1.0, printed.follower)  # where the follower's circle is the one in (6.25)
    reach = farthest(1.0, 1.2, least)
    assert reach == pytest.approx(least - s + term, abs=1e-9), "RL - s + RF w / (2 rd) <= w'"
    assert reach != pytest.approx(least - s - term, abs=0.5), "as printed"
    assert reach != pytest.approx(least + s - term, abs=0.5), "with the sign of s turned"
    assert 1.2 + s - term == pytest.approx(1.6625, abs=1e-4)
    assert 1.2 in mine
    assert 1.5 not in mine
    assert turning_radii(1.0, 1.2, 0.6, 0.2).empty
    assert turning_radii(1.0, 1.8, 0.1, 0.05).empty, "no circle fits into 10 cm"
    for width in (-0.5, math.nan):
        with pytest.raises(DefinitionError, match="next_width"):
            turning_radii(1.0, 1.2, width, 0.2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 2.1, 0.2), "the follower may be beside the leader"),
        ((1.0, 1.2, 0.7), "no circular arc leads a follower"),
        ((0.0, 1.2, 0.2), "distance is 0.0"),
        ((1.0, math.nan, 0.2), "width is nan"),
    ],
)
def test_corners_without_a_circle_are_refused(arguments, message):
    with pytest.raises(DefinitionError, match=message):
        critical_radius(*arguments)


# -- circles of followers -----------------------------------------------------------------------


def circling(law, radius, followers=1, speed=0.2, seconds=300.0):
    """The radii of the followers' circles in the end, by simulation."""
    from holdfast.maths.catalogue.systems.chain import chain
    from holdfast.maths.formations.chain import joint_law

    system = chain(followers)
    lead = hf.Law("circle", system.states[:3], {"uL": hf.symbol("s"), "wL": hf.symbol("s") / hf.symbol("R")},
        parameters=(hf.Parameter("s", "m/s", value=speed), hf.Parameter("R", "m", value=radius)))  # fmt: skip
    law = joint_law(system, hf.Switching("lead", {"on": lead}), [law] * followers)
    start = [radius, 0, math.pi / 2]
    for k in range(1, followers + 1):
        start += [radius, -1.0 * k, math.pi / 2]
    data = hf.simulate(
        system, law, starts=[start], horizon=seconds, sample_time=0.01, substeps=1, record_every=1.0
    ).dataset
    end = data["state"].values[0, -1].reshape(-1, 3)
    return np.hypot(end[1:, 0], end[1:, 1])


def test_radii_of_a_chain_are_those_of_a_tractor_with_trailers():
    """Where they point at the one before, by a large gain: sqrt(R^2 - rd^2) again and again."""
    exact = chain_radii(3.0, 1.0, 4)
    assert exact == pytest.approx((2.828, 2.646, 2.449, 2.236), abs=1e-3)
    law = hf.laws.follow_leader(k1=0.6, k2=40.0, leader_speed=0.25, softness=0.005)
    assert circling(law, 3.0, followers=4) == pytest.approx(exact, abs=0.02)


def test_radius_of_a_follower_that_sees_the_leader_aside():
    """In the end it turns as the leader does: k2 bearing = uL / RL."""
    law = hf.laws.follow_leader(k1=0.6, k2=0.8, leader_speed=0.25, softness=0.01)
    found = circling(law, 3.0)[0]
    bearing = 0.2 / 3.0 / 0.8
    assert found == pytest.approx(follower_radius(3.0, 1.0, bearing), abs=0.02)
    assert found == pytest.approx(2.919, abs=0.02)


def test_gain_without_off_tracking_puts_all_followers_on_the_leaders_circle():
    gain = zero_off_tracking_gain(0.2, 3.0, 1.0)
    assert gain == pytest.approx(0.4, rel=0.01)
    law = hf.laws.follow_leader(k1=0.6, k2=gain, leader_speed=0.25, softness=0.01)
    assert circling(law, 3.0, followers=3) == pytest.approx(3.0, abs=0.02)


def test_circles_that_are_none_are_refused():
    with pytest.raises(DefinitionError, match="a follower 1 m behind"):
        chain_radii(1.5, 1.0, 3)
    with pytest.raises(DefinitionError, match="at most twice the radius"):
        zero_off_tracking_gain(0.2, 0.4, 1.0)


# -- corners that are tried -----------------------------------------------------------------------


def planned(cells, start, goal):
    return route_fields(plan_route(environment(cells, 0.2), start, goal))


def convoy(followers=1, **options):
    law = hf.laws.follow_leader(k1=0.6, k2=0.8, leader_speed=0.25, **options)
    return Convoy(0.2, 2.0, (law,) * followers, 1.0)


def in_line(followers, start, apart=1.0):
    """Poses of a leader and of those behind it."""
    x, y, theta = start
    back = apart * np.arange(followers + 1)
    return [(x - s * math.cos(theta), y - s * math.sin(theta), theta) for s in back]


def corner(fields, number, convoy, start=(-3.0, 0.0, 0.0), **options):
    starts = in_line(len(convoy.laws), start)
    return route_corners(fields, convoy, starts, **options)[number]


def test_arcs_without_a_jump_may_be_half_as_wide():
    """0.6 m against 1.15 m with the jump of the thesis, wherever the follower is."""
    fields = planned(CORNER, (-3, 0), (0.6, -4.5))
    found = corner(fields, 0, convoy())
    assert found.side == -1
    assert found.low == pytest.approx(0.59, abs=0.03)
    assert found.high == pytest.approx(1.2, abs=1e-9)
    assert found.low < found.radius < found.high
    left = {"west": CORNER["west"], "north": [[x, -y] for x, y in CORNER["south"]]}
    mirrored = corner(planned(left, (-3, 0), (0.6, 4.5)), 0, convoy())
    assert mirrored.side == 1
    assert (mirrored.low, mirrored.high) == pytest.approx((found.low, found.high), abs=0.03)


def test_straight_on_is_no_corner():
    cells = {"a": box(-6, 0, 0, 2), "b": box(0, 0, 6, 2)}
    assert corner(planned(cells, (-3, 1), (5, 1)), 0, convoy(), (-3, 1, 0)).side == 0


def test_corner_that_cannot_be_taken_is_named():
    narrow = {"west": box(-6, -0.5, -0.3, 0.5), "south": box(-0.3, -5, 0.5, 0.5)}
    with pytest.raises(
        DefinitionError, match=r"no radius .* from cell 'west' to cell 'south' at \(-0.1, 0\)"
    ):
        corner(planned(narrow, (-2.5, 0), (0.1, -4)), 0, convoy(3), (-2.5, 0, 0))
    fields = planned(CORNER, (-3, 0), (0.6, -4.5))
    with pytest.raises(DefinitionError, match="the given radius leads the robots"):
        corner(fields, 0, convoy(), radius=0.3)
    assert corner(fields, 0, convoy(), radius=0.8).radius == 0.8


@pytest.mark.heavy
def test_row_that_is_longer_than_a_cell_goes_through_it():
    """Five robots, 4 m from the first to the last, and a cell of 2 m between two corners."""
    cells = {
        "west": box(-9, -1, -1, 1),
        "middle": box(-1, -1, 1, 3),
        "north": box(-1, 3, 9, 5),
    }
    goal = (8.0, 4.0)
    fields = planned(cells, (-2.5, 0), goal)
    starts = in_line(4, (-2.5, 0.0, 0.0), 1.05)
    corners = route_corners(fields, convoy(4), starts)
    assert [c.side for c in corners] == [1, -1]
    moved = driven(fields, corners, convoy(4), starts, 100.0)
    assert fields.route.environment.room(moved[..., :2]).min() > -1e-3
    assert np.linalg.norm(moved[-1, 0, :2] - goal) < 0.1
    assert np.hypot(*(moved[-1, :-1, :2] - moved[-1, 1:, :2]).T) == pytest.approx(1.0, abs=0.03)


def driven(fields, corners, convoy, starts, seconds):
    """Poses (time, robot, x y theta) by the compiled loop: the plan is not asked."""
    from holdfast.maths.catalogue.systems.chain import chain
    from holdfast.maths.formations.chain import joint_law

    system = chain(len(convoy.laws))
    law = joint_law(system, lead_along(fields, corners, speed=convoy.speed), convoy.laws)
    data = hf.simulate(
        system, law, starts=[sum(starts, ())], horizon=seconds, sample_time=0.01, substeps=1,
        record_every=0.1,
    ).dataset  # fmt: skip
    return data["state"].values[0].reshape(-1, len(starts), 3)


def test_plan_moves_robots_as_the_loop_does():
    """Steps of 2 cm against those of a hundredth of a second: some millimetres."""
    fields = planned(CORNER, (-3, 0), (0.6, -4.5))
    starts = [(-3.0, 0.2, -0.3), (-4.1, -0.3, 0.4)]
    corners = route_corners(fields, convoy(), starts)
    mine = convoy()
    exact = driven(fields, corners, mine, starts, 15.0)
    poses = np.array([starts])
    on, off = np.array([True]), np.array([False])
    for _ in range(round(14 / mine.step)):
        poses, _ = mine.moved(fields, 0, poses, np.zeros(1), off, on)
    then = exact[round(10 * mine.step * round(14 / mine.step))]
    assert poses[0] == pytest.approx(then, abs=0.01)


def test_robot_that_starts_towards_a_wall_is_named():
    fields = planned(CORNER, (-3, 0), (0.6, -4.5))
    with pytest.raises(
        DefinitionError, match=r"the leader goes into a wall at \(-\d.*\), with the leader in cell"
    ):
        corner(fields, 0, convoy(), (-3.0, 0.55, 1.5))
    blind = hf.Law(
        "blind",
        convoy().laws[0].reads,
        {"uF": hf.symbol("range") / 8, "wF": 0 * hf.symbol("range")},
    )
    with pytest.raises(DefinitionError, match="follower 1 goes into a wall at"):
        route_corners(fields, Convoy(0.2, 2.0, (blind,), 1.0), [(-3, 0, 0), (-4, 0.3, 0.8)])
