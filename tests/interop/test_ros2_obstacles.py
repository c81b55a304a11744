"""Obstacles by ROS 2: boxes of a detector, neighbours of a fleet, and a node that keeps clear."""

import math
import time

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate, translate

import holdfast as hf
from holdfast.errors import DefinitionError

for package in ("zenoh", "rosbags", "xxhash"):
    pytest.importorskip(package, reason="needs holdfast[interop]")

from holdfast.interop import ros_messages as ros  # noqa: E402
from holdfast.interop.ros2 import FilterNode, Interface, Lookout, MessageError, Node  # noqa: E402
from holdfast.interop.ros2.lookout import Watch  # noqa: E402
from tests.interop.test_ros2 import hub, local  # noqa: E402, F401

SIDES = (2.0, 1.0)


def detections(boxes, frame="map"):
    """boxes: (x, y, heading, length, width, name); None as heading is no quaternion."""
    made = ros.made
    rows = []
    for x, y, heading, length, width, name in boxes:
        turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
        if heading is not None:
            turned |= {"z": math.sin(heading / 2), "w": math.cos(heading / 2)}
        pose = made(
            "geometry_msgs/msg/Pose",
            position=made("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.3),
            orientation=made("geometry_msgs/msg/Quaternion", **turned),
        )
        box = made(
            "vision_msgs/msg/BoundingBox3D", center=pose,
            size=ros.vector(float(length), float(width), 1.0),
        )  # fmt: skip
        rows.append(
            made("vision_msgs/msg/Detection3D", header=ros.header(0, ""), results=[], bbox=box,
                 id=name)
        )  # fmt: skip
    return made(ros.DETECTIONS, header=ros.header(0, frame), detections=rows)


@pytest.fixture
def watch():
    neighbours = {"/boat_2/odometry": 0.4}
    look = Lookout(neighbours=neighbours, share=0.5, speed=0.2, radius=0.1, acceleration=0.05)
    return Watch(look, "map")


def test_a_box_is_the_rectangle_around_what_was_found(watch):
    message = ros.decoded(ros.encoded(detections([(3, 1, 0.5, *SIDES, "tug")])), ros.DETECTIONS)
    (tug,) = watch.boxes(message)
    ((corners, radius),) = tug.bodies
    turned = rotate(shapely.box(-1, -0.5, 1, 0.5), 0.5, origin=(0, 0), use_radians=True)
    wanted = translate(turned, 3, 1)
    assert shapely.Polygon(corners).symmetric_difference(wanted).area < 1e-9
    assert (radius, tug.velocity_error, tug.name) == (0.1, 0.2, "tug")


def test_a_box_without_sides_or_heading_is_a_disc_and_one_of_nan_is_no_number(watch):
    flat, turned, lost = watch.boxes(
        detections([(1, 2, 0, 0, 0, ""), (1, 2, None, *SIDES, ""), (math.nan, 2, 0, *SIDES, "")])
    )
    assert flat.bodies == ((((1.0, 2.0),), 0.1),)
    assert flat.name == "box 1"
    assert turned.bodies[0][1] == pytest.approx(math.hypot(1, 0.5) + 0.1)
    robot = hf.systems.unicycle()
    keep = hf.SafetyFilter(robot, obstacles=hf.Obstacles(3, lead=0.3), gains=(1, 4))
    assert keep.step([0, 0, 0], [0, 0], obstacles=[lost]).status is hf.Status.NOT_A_NUMBER


def test_what_is_of_another_frame_or_of_no_size_is_refused(watch):
    odd = detections([(1, 2, 0, *SIDES, "")])
    odd.detections[0].header = ros.header(0, "camera")
    for message, why in (
        (detections([], frame="camera"), "detections in the frame 'camera'"),
        (odd, "detections in the frame 'camera'"),
        (detections([(1, 2, 0, -1, 1, "")]), "a box of -1 m x 1 m"),
        (detections([(1, 2, 0, 1, 1, "")] * 501), "501 boxes"),
    ):
        with pytest.raises(MessageError, match=why):
            watch.boxes(message)
    with pytest.raises(MessageError, match="Odometry in the frame 'odom'"):
        watch.neighbour(
            "/boat_2/odometry", ros.odometry((0, 0, 0), (0, 0, 0), 0, "odom", "base_link")
        )


def test_a_neighbour_moves_in_its_own_axes_and_has_its_share(watch):
    message = ros.odometry((4, 1, math.pi / 2), (0.6, -0.1, 0), 0, "map", "boat_2")
    boat = watch.neighbour("/boat_2/odometry", message)
    assert boat.bodies == ((((4.0, 1.0),), 0.4),)
    assert boat.velocity == pytest.approx((0.1, 0.6))
    assert (boat.share, boat.acceleration, boat.name) == (0.5, 0.05, "/boat_2/odometry")


def test_the_list_is_as_old_as_its_boxes_and_a_silent_neighbour_ends_it(watch):
    assert watch.around(0.0) is None
    watch.seen([], 1.0)
    assert watch.around(1.1) == ([], 1.0)
    message = ros.odometry((4, 1, 0), (0.6, 0, 0), 0, "map", "boat_2")
    watch.met("/boat_2/odometry", watch.neighbour("/boat_2/odometry", message), 1.2)
    (boat,), at = watch.around(1.2)
    assert at == 1.0
    assert boat.bodies[0][0][0] == pytest.approx((4 - 0.6 * 0.2, 1.0))  # where it was at 1 s
    watch.seen([], 3.0)
    (boat,), _ = watch.around(3.0)
    assert (boat.age, boat.bodies[0][0][0]) == (pytest.approx(1.8), (4.0, 1.0))
    watch.seen([], 6.5)
    assert watch.around(6.5) is None


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"speed": -1.0}, "speed is -1"),
        ({"share": 0.0}, "share is 0"),
        ({"neighbours": {"/a": math.nan}}, "the radius of '/a' is nan"),
        ({"detections": None}, "names no topic"),
    ],
)
def test_a_lookout_of_no_numbers_is_refused(settings, why):
    with pytest.raises(DefinitionError, match=why):
        Lookout(**settings)


# -- a node -------------------------------------------------------------------------------------


@pytest.mark.heavy
def test_a_node_keeps_clear_of_what_is_detected_and_says_what_it_lacks(hub):  # noqa: F811
    """A robot is commanded straight at a box; the messages come over Zenoh."""
    robot = hf.systems.unicycle()
    clear = hf.Obstacles(10, hull=0.2, lead=0.4, speed=0.5)
    keep = hf.SafetyFilter(robot, obstacles=clear, gains=(1, 4))
    face = Interface(robot)
    room = hf.obstacles(robot, {}, room=[[-3, -3], [3, -3], [3, 3], [-3, 3]])
    alone = hf.SafetyFilter(robot, room, gains=(1, 4))
    with pytest.raises(DefinitionError, match="keeps clear of no obstacles"):
        FilterNode(alone, network=local(hub), lookout=Lookout())
    look = Lookout(neighbours={"/boat_2/odometry": 0.3})
    plant = hf.Plant(robot, [0.0, 0.0, 0.05])
    with (
        FilterNode(keep, network=local(hub), lookout=look) as node,
        Node("others", network=local(hub)) as other,
    ):
        boxes = other.publisher("detections", ros.DETECTIONS)
        beside = other.publisher("/boat_2/odometry", ros.ODOMETRY)
        where = other.publisher("odometry", ros.ODOMETRY)
        wanted = other.publisher("nominal_command", face.command)
        names = robot.state_names, robot.input_names

        def send(frame="map", box=True):
            state = dict(zip(names[0], plant.state.tolist(), strict=True))
            where.send(face.odometry(state, 0))
            wanted.send(face.wrap(dict(zip(names[1], (1.0, 0.0), strict=True)), 0))
            if box:
                boxes.send(detections([(3, 0, 0, *SIDES, "wall")], frame))
            beside.send(ros.odometry((1.5, 1.5, 0), (0.1, 0, 0), 0, frame, "boat_2"))

        began, now, records = time.monotonic(), 0.0, []

        def step(**how):
            nonlocal now
            send(**how)
            time.sleep(0.002)
            now += 0.02
            records.append(node.step(now))
            return records[-1]

        while step().lost or len(records) < 5:  # until all have met
            assert time.monotonic() - began < 30
        for _ in range(250):
            record = step()
            plant.step(list(record.input.values()))
            box = shapely.box(2, -0.5, 4, 0.5)
            assert box.distance(shapely.Point(plant.state[:2])) > 0.2
        assert {r.lost for r in records[-200:]} == {""}
        assert "changed" in {r.status for r in records}
        assert plant.state[0] > 0.8
        for _ in range(20):
            record = step(box=False)
        assert (record.lost, record.status) == ("list of obstacles", "no measurement")
        assert set(record.input.values()) == {0.0}
        for _ in range(3):
            step(frame="camera")
        assert node._boxes.refused >= 1
        assert node._boxes.why.startswith("detections in the frame 'camera'")
        assert np.isfinite(plant.state).all()
