"""Obstacles by MAVLink: sectors, points, vessels and aircraft, and a filter that keeps clear."""

import math

import numpy as np
import pytest
import shapely
import sympy as sp
from pymavlink.dialects.v20 import ardupilotmega as common

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.interop.mavlink import BodyVelocity, Lookout, SafetyComponent
from holdfast.interop.mavlink.lookout import Watch
from holdfast.interop.planar_motion import PlanarMotion
from tests.interop.test_mavlink import Boat, Ground

NONE, UNKNOWN, FAR = 1001, 0xFFFF, 1000
POSE = ("x", "y", "psi")


@pytest.fixture(scope="module")
def vehicle():
    psi, v, r = (hf.symbol(n) for n in ("psi", "v", "r"))
    return hf.System(
        "rover",
        states=(hf.Quantity("x", "m"), hf.Quantity("y", "m"),
                hf.Quantity("psi", "rad", angle=True)),
        inputs=(hf.Quantity("v", "m/s"), hf.Quantity("r", "rad/s")),
        rates={"x": v * sp.cos(psi), "y": v * sp.sin(psi), "psi": r},
        input_bounds=hf.Box((-1.0, -1.5), (1.0, 1.5)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def keep(vehicle):
    clear = hf.Obstacles(20, hull=0.2, lead=0.4, speed=0.5)
    return hf.SafetyFilter(vehicle, obstacles=clear, gains=(1, 4), sample_time=0.02)


def distances(values, *, increment=5, offset=0.0, frame=12, most=FAR, fine=0.0, sensor=0):
    row = [NONE] * 72
    row[: len(values)] = values
    message = common.MAVLink_obstacle_distance_message(
        0, sensor, row, increment, 20, most, fine, offset, frame
    )
    return message


def heard(message, system=1, component=196):
    message._header.srcSystem, message._header.srcComponent = system, component
    return message


def watch(vehicle, pose=(0, 0, 0), bearing=0.0, **look):
    made = Watch(PlanarMotion(vehicle, bearing=bearing), Lookout(**look), 0.25)
    made.measured(dict(zip(POSE, pose, strict=True)))
    return made


def shapes(obstacles):
    parts = [
        shapely.Point(c[0]).buffer(r) if len(c) == 1
        else (shapely.LineString(c) if len(c) == 2 else shapely.Polygon(c)).buffer(r)
        for o in obstacles for c, r in o.bodies
    ]  # fmt: skip
    return shapely.union_all(parts)


# -- sectors ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("increment", "fine"), [(5, 0.0), (45, 0.0), (1, -2.5)])
@pytest.mark.parametrize("frame", [0, 12])
def test_a_sector_covers_its_arc_and_little_more(vehicle, increment, fine, frame):
    """The arc, worked out in the axes of the compass, against the union of the bodies."""
    pose, bearing = (2.0, -1.0, 0.7), 0.3
    seen = watch(vehicle, pose, bearing)
    values = [NONE, 400, UNKNOWN, 250]
    message = distances(values, increment=increment, fine=fine, offset=20.0, frame=frame)
    seen.take(heard(message), 5.0)
    obstacles, at = seen.around(5.0)
    assert (seen.taken, seen.refused, at) == (1, 0, 5.0)
    assert [o.name for o in obstacles] == ["sector 1", "sector 3"]
    width = math.radians(fine or increment)
    bow = bearing - pose[2] if frame == 12 else 0.0
    for obstacle, k, d in zip(obstacles, (1, 3), (4.0, 2.5), strict=True):
        body = shapes([obstacle])
        middle = bow + math.radians(20) + k * width
        angles = middle + np.linspace(-width / 2, width / 2, 50)
        north, east = d * np.cos(angles), d * np.sin(angles)
        x = pose[0] + north * math.cos(bearing) + east * math.sin(bearing)
        y = pose[1] + north * math.sin(bearing) - east * math.cos(bearing)
        assert body.buffer(2e-3).covers(shapely.MultiPoint(np.stack([x, y], 1)))
        nearest = body.distance(shapely.Point(pose[:2]))
        assert d * 0.985 < nearest <= d + 1e-9


def test_what_no_sector_says_is_not_there_and_what_none_knows_is_no_list(vehicle):
    seen = watch(vehicle)
    assert seen.around(0.0) is None
    seen.take(heard(distances([UNKNOWN] * 72)), 0.0)
    assert (seen.around(0.0), seen.refused) == (None, 1)
    assert seen.why == "OBSTACLE_DISTANCE of which every sector is unknown"
    seen.take(heard(distances([NONE, 0xFFFE])), 1.0)
    assert seen.around(1.0) == ([], 1.0)
    seen.take(heard(distances([0])), 2.0)
    ((touching,), _) = seen.around(2.0)
    assert touching.bodies == ((((0.0, 0.0), (0.0, 0.0)), 0.0),)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (distances([100], frame=8), "in the frame 8"),
        (distances([100], increment=0), "of sectors of 0 deg"),
        (distances([100], offset=math.nan), "with the offset nan"),
        (distances([100], fine=math.inf), "of sectors of inf deg"),
        (common.MAVLink_obstacle_distance_3d_message(0, 0, 7, 1, 1, 1, 0, 0, 9), "in the frame 7"),
        (common.MAVLink_obstacle_distance_3d_message(0, 0, 12, 1, math.nan, 1, 0, 0, 9), "at (nan"),
    ],
)
def test_a_message_of_another_frame_or_of_no_numbers_is_refused(vehicle, message, why):
    seen = watch(vehicle)
    seen.take(heard(message), 0.0)
    assert (seen.taken, seen.refused, seen.around(0.0)) == (0, 1, None)
    assert why in seen.why


def test_points_are_placed_in_both_frames_and_pass(vehicle):
    seen = watch(vehicle, (1.0, 2.0, math.pi / 2), radius=0.3)
    point = common.MAVLink_obstacle_distance_3d_message
    seen.take(heard(point(10, 0, 12, 4, 3.0, 1.0, 0.0, 0.2, 9.0)), 0.0)  # 3 m ahead, 1 m right
    seen.take(heard(point(10, 0, 1, UNKNOWN, 5.0, -6.0, 0.0, 0.2, 9.0)), 0.1)
    seen.take(heard(point(10, 0, 1, UNKNOWN, 5.0, -7.0, 0.0, 0.2, 9.0)), 0.1)
    obstacles, at = seen.around(0.1)
    assert at == 0.1
    places = [o.bodies[0][0][0] for o in obstacles]
    assert places[0] == pytest.approx((2.0, 5.0))
    assert places[1:] == [(5.0, 6.0), (5.0, 7.0)]
    assert {o.bodies[0][1] for o in obstacles} == {0.3}
    seen.take(heard(point(11, 0, 12, 4, 2.0, 0.0, 0.0, 0.2, 9.0)), 0.2)
    assert len(seen.around(0.2)[0]) == 3
    assert len(seen.around(0.4)[0]) == 1


# -- vessels and aircraft -----------------------------------------------------------------------

LATITUDE, LONGITUDE = 63.44, 10.4
PHI = math.radians(LATITUDE)
METRE_NORTH = 1 / (111_132.92 - 559.82 * math.cos(2 * PHI) + 1.175 * math.cos(4 * PHI))
METRE_EAST = 1 / (111_412.84 * math.cos(PHI) - 93.5 * math.cos(3 * PHI) + 0.118 * math.cos(5 * PHI))
"""Degrees at this latitude, by the series for WGS 84 of the U.S. National Geospatial Agency."""


def vessel(north, east, *, course=9000, speed=150, heading=9000, tslc=0, flags=None, sides=None):
    """Metres from the place of the test."""
    bow, stern, port, starboard = sides or (0, 0, 0, 0)
    valid = common.AIS_FLAGS_VALID_COG | common.AIS_FLAGS_VALID_VELOCITY
    valid |= common.AIS_FLAGS_VALID_DIMENSIONS if sides else 0
    return heard(
        common.MAVLink_ais_vessel_message(
            257_000_001, round(1e7 * (LATITUDE + north * METRE_NORTH)),
            round(1e7 * (LONGITUDE + east * METRE_EAST)), course, heading, speed, 0, 0, 0,
            bow, stern, port, starboard, b"", b"TRONDHEIM", tslc, valid if flags is None else flags,
        )
    )  # fmt: skip


def origin(seen):
    seen.placed(
        common.MAVLink_gps_global_origin_message(round(1e7 * LATITUDE), round(1e7 * LONGITUDE), 0)
    )


def decoded(message):
    """The message as it is read from the wire."""
    mav = common.MAVLink(None)
    mav.srcSystem, mav.srcComponent = 1, 196
    return mav.decode(bytearray(message.pack(mav)))


def test_a_vessel_is_where_it_says_and_moves_along_its_course(vehicle):
    seen = watch(vehicle, ranges=False, radius=1.0)
    seen.take(decoded(vessel(200, 100)), 10.0)
    assert (seen.refused, seen.around(10.0)) == (1, ([], 10.0))
    assert seen.why == "AIS_VESSEL before the place of the vehicle on the Earth is known"
    origin(seen)
    seen.take(decoded(vessel(200, 100, tslc=2)), 10.0)
    ((ship,), _) = seen.around(11.5)
    (((centre,), radius),) = ship.bodies
    assert centre == pytest.approx((200, -100), abs=0.02)
    assert ship.velocity == pytest.approx((0, -1.5), abs=1e-9)  # to the east
    assert (radius, ship.age, ship.name) == (1.0, pytest.approx(3.5), "TRONDHEIM")
    assert seen.around(40.1) == ([], 40.1)


def test_the_hull_of_a_vessel_is_that_of_its_sides(vehicle):
    seen = watch(vehicle, ranges=False, radius=0.0)
    origin(seen)
    seen.take(decoded(vessel(0, 0, heading=9000, sides=(30, 10, 4, 2))), 0.0)
    ((ship,), _) = seen.around(0.0)
    hull = shapes([ship])
    assert hull.bounds == pytest.approx((-2, -30, 4, 10), abs=0.02)  # x is north, y is west
    seen.take(decoded(vessel(0, 0, heading=0, sides=(30, 10, 4, 2))), 0.0)  # or not available
    ((ship,), _) = seen.around(0.0)
    assert ship.bodies[0][1] == pytest.approx(math.hypot(30, 4))
    seen.take(decoded(vessel(0, 0, heading=9000, sides=(30, 10, 0, 0))), 0.0)
    ((ship,), _) = seen.around(0.0)
    assert shapes([ship.bodies and hf.Obstacle(((ship.bodies[0][0], 0.1),))]).bounds[3] > 9.9


def test_a_vessel_without_a_valid_course_may_go_anywhere(vehicle):
    seen = watch(vehicle, ranges=False, unknown_speed=4.0)
    origin(seen)
    for message in (vessel(50, 0, flags=0), vessel(50, 0, course=36000)):
        seen.take(decoded(message), 0.0)
        ((ship,), _) = seen.around(0.0)
        assert (ship.velocity, ship.velocity_error) == ((0.0, 0.0), 4.0)


def aircraft(altitude, flags=None):
    every = (
        common.ADSB_FLAGS_VALID_COORDS | common.ADSB_FLAGS_VALID_ALTITUDE
        | common.ADSB_FLAGS_VALID_HEADING | common.ADSB_FLAGS_VALID_VELOCITY
    )  # fmt: skip
    return decoded(
        common.MAVLink_adsb_vehicle_message(
            0x4CA1FA, round(1e7 * LATITUDE), round(1e7 * (LONGITUDE + 80 * METRE_EAST)), 0,
            round(1000 * altitude), 0, 1200, 0, b"LN-ABC", 0, 1, every if flags is None else flags,
            0,
        )
    )  # fmt: skip


def test_aircraft_count_at_the_height_of_the_vehicle(vehicle):
    seen = watch(vehicle, (40.0, 0.0, 0.0), ranges=False, height=50.0)
    at = round(1e7 * (LATITUDE + 40 * METRE_NORTH)), round(1e7 * LONGITUDE)
    seen.placed(common.MAVLink_global_position_int_message(0, *at, 30_000, 0, 0, 0, 0, 0))
    seen.take(aircraft(70), 0.0)
    ((plane,), _) = seen.around(0.0)
    assert plane.bodies[0][0][0] == pytest.approx((0, -80), abs=0.02)
    assert plane.velocity == pytest.approx((12.0, 0.0))
    assert (plane.age, plane.name) == (1.0, "LN-ABC")
    seen.take(aircraft(90), 0.1)
    assert seen.around(0.1)[0] == []
    seen.take(aircraft(90, common.ADSB_FLAGS_VALID_COORDS), 0.2)  # its altitude is not valid
    assert len(seen.around(0.2)[0]) == 1
    seen.take(aircraft(70, 0), 0.3)
    assert (seen.refused, seen.why) == (1, "ADSB_VEHICLE without valid coordinates")


# -- a component --------------------------------------------------------------------------------


@pytest.fixture
def link(keep):
    made = []

    def make(**settings):
        keep.reset()
        component = SafetyComponent(
            keep, BodyVelocity(keep.system, {"v": "vx", "r": "yaw_rate"}),
            controller="udpin:127.0.0.1:0", vehicle="udpin:127.0.0.1:0",
            twist=("u", "v", "r"), **settings,
        )  # fmt: skip
        ground, boat = Ground(component.controller.port), Boat(component.vehicle.port)
        made.extend([component, ground.port, boat.port])
        return component, ground, boat

    yield make
    for one in made:
        one.close()


@pytest.mark.heavy
def test_a_rover_that_is_commanded_at_a_wall_stops_in_front_of_it(link, vehicle):
    """Its sensor says how far the wall is; without the sensor it stops at once."""
    component, ground, boat = link()
    plant, records = hf.Plant(vehicle, [0.0, 0.3, 0.1]), []
    command = component.commands.of({"v": 1.0, "r": 0.0}, 1)
    for k in range(420):
        now = 0.02 * k
        x, y, psi = plant.state
        boat.states([x, y, psi, 0, 0, 0], now + 1.0)
        angles = np.radians(np.arange(0, 360, 5)) + psi * -1.0  # clockwise from the bow
        # the wall is x = 3: along the angle a from north the distance is (3 - x) / cos(a)
        with np.errstate(divide="ignore"):
            away = np.where(np.cos(angles) > 0.05, (3.0 - x) / np.cos(angles), 99.0)
        if k < 350 and k % 5 == 0:
            rows = [NONE if d > 10 else round(100 * d) for d in away.tolist()]
            boat.send(distances(rows), sender=(1, 196))
        ground.send(command)
        record = component.turn(now)
        assert record is not None
        records.append(record)
        plant.step(list(record.input.values()))
        if k < 350:
            assert plant.state[0] + 0.2 < 3.0
    assert records[100].status in ("passed", "changed")
    assert 2.0 < max(r.state["x"] for r in records[:350]) < 2.8
    assert {r.lost for r in records[:350]} == {""}
    assert records[-1].lost == "list of obstacles"
    assert set(records[-1].input.values()) == {0.0}
    assert component.counts.obstacles == 70
    assert "70 obstacles" in str(component.counts)


def test_what_is_not_counted_is_said(link):
    component, ground, boat = link(lookout=Lookout(ranges=False))
    ground.send(component.commands.of({"v": 0.5, "r": 0.0}, 1))
    component.turn(-1.0)  # now it knows where the controller is
    boat.states([0, 0, 0, 0, 0, 0], 1.0)
    ground.send(component.commands.of({"v": 0.5, "r": 0.0}, 1))
    boat.send(distances([100], frame=8), sender=(1, 196))
    boat.send(vessel(0, 100), sender=(7, 1))
    record = component.turn(0.0)
    assert (record.lost, record.status) == ("", "passed")
    assert (component.counts.unplaced, component.counts.other_system) == (1, 1)
    texts = [m.text for m in ground.hear() if m.get_type() == "STATUSTEXT"]
    assert "holdfast: not counted: OBSTACLE_DISTANCE in the frame 8" in "".join(texts)


def test_a_lookout_without_obstacles_and_of_no_numbers_is_refused(vehicle):
    room = hf.obstacles(vehicle, {}, room=[[-3, -3], [3, -3], [3, 3], [-3, 3]])
    alone = hf.SafetyFilter(vehicle, room, gains=(1, 4))
    with pytest.raises(SimulationError, match="keeps clear of no obstacles"):
        SafetyComponent(alone, BodyVelocity(vehicle), lookout=Lookout())
    with pytest.raises(SimulationError, match="lasts is -1"):
        Lookout(lasts=-1.0)
