"""A safety filter as a node of ROS 2: on the wire, between processes, and when they are killed."""

import itertools
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError, OutputError, SimulationError
from tests.interop.ros2_programs import BOTH, CONTROLLER, FILTER, VEHICLE, camera_filter, pd

for package in ("zenoh", "rosbags", "xxhash"):
    pytest.importorskip(package, reason="needs holdfast[interop]")

from holdfast.interop import ros_messages as ros  # noqa: E402
from holdfast.interop.ros2 import (  # noqa: E402
    ControllerNode,
    FilterNode,
    Interface,
    MessageError,
    Network,
    Node,
    VehicleNode,
    router,
    serve,
)
from holdfast.interop.ros2 import names as wire  # noqa: E402
from holdfast.interop.ros2.node import Loop  # noqa: E402
from tests.interop.ros2_network import local  # noqa: E402

LOST_BY_THE_CONTROLLER = ([-1.3, 0.75, -0.35], [-1.06, -0.49, 0.78], [-1.05, 0.59, -0.44])
"""Starts in the view from which the controller of docs/own_controller.md loses it within 2 s."""
DEADLINE = 60.0
UNDER_THE_COMMAND_LINE = (
    f"from holdfast.host.interruption import listening\nwith listening(): exec({FILTER!r})"
)
"""The filter where the commands of holdfast hear the signals too."""
STRING = "std_msgs/msg/String"


@pytest.fixture
def begin(hub):
    """Starts programs, and ends those that still run."""
    running = []

    def started(code, *arguments):
        running.append(subprocess.Popen([sys.executable, "-c", code, hub, *arguments]))
        return running[-1]

    yield started
    for process in running:
        process.kill()
        process.wait()


class Monitor:
    """Every decision and every odometry of a namespace, as another node hears them."""

    def __init__(self, hub, namespace="/"):
        self.node = Node("monitor", namespace=namespace, network=local(hub))
        self._text = self.node.subscription("safety_filter/decisions", STRING)
        self._odometry = self.node.subscription("odometry", ros.ODOMETRY)
        self._commands = self.node.subscription("command", "geometry_msgs/msg/Wrench")
        self._reports = self.node.subscription(
            "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
        )
        self.records, self.states, self.commands, self.reports = [], [], [], []
        self.face = Interface(hf.systems.marine_vehicle())

    def listen(self):
        self.records += [hf.DecisionRecord.read(m.data) for m in self._text.take()]
        heard = [m for m in self._odometry.take() if m.header.frame_id == "map"]
        self.states += [list(self.face.state(m).values()) for m in heard]
        self.commands += self._commands.take()
        self.reports += [m.status[0] for m in self._reports.take()]

    def until(self, reached, seconds=DEADLINE):
        """Listen until something is so; the seconds that took."""
        began = time.monotonic()
        while not reached(self):
            assert time.monotonic() - began < seconds, (self.records[-1:], self.states[-1:])
            time.sleep(0.005)
            self.listen()
        return time.monotonic() - began

    def last(self, lost):
        return bool(self.records) and self.records[-1].lost == lost


@pytest.fixture
def monitor(hub):
    made = Monitor(hub)
    with made.node:
        yield made


def worst(states):
    view = hf.Boundary(hf.systems.marine_vehicle(), hf.regions.camera_view())
    return view.worst(states).max()


def silent_for(records, lost):
    """The seconds that the first record of the last loss says to have waited."""
    whys = [r.why for r in records if r.lost == lost and f"no {lost} for" in r.why]
    return min(float(re.search(r"for ([\d.]+) s", why)[1]) for why in whys)


# -- between processes


@pytest.mark.heavy
def test_view_is_kept_over_ros_2_from_starts_from_which_the_controller_alone_loses_it(hub, begin):
    """Three vehicles and their controllers in a process, three filters in another."""
    vehicle = hf.systems.marine_vehicle()
    starts = {f"/boat_{k}": start for k, start in enumerate(LOST_BY_THE_CONTROLLER)}
    for start in starts.values():
        boat = hf.Plant(vehicle, [*start, 0, 0, 0])
        assert worst([boat.step(pd(boat.state)) for _ in range(100)]) > 0.02
    begin(FILTER, *starts)
    begin(BOTH, *(f"{name}={','.join(map(str, s))}" for name, s in starts.items()))
    heard = [Monitor(hub, name) for name in starts]
    try:
        for one in heard:
            one.until(lambda m: any(r.status == "changed" for r in m.records))
        began = time.monotonic()
        while time.monotonic() - began < 2.2:
            time.sleep(0.01)
            for one in heard:
                one.listen()
        for one in heard:
            assert len(one.states) > 80
            assert worst(one.states) <= 0
            moved = np.subtract(one.states[-1], one.states[0])
            assert math.hypot(*moved[:2]) > 0.2
            assert sum(not r.lost for r in one.records) > 80
    finally:
        for one in heard:
            one.node.close()


@pytest.mark.heavy
def test_killed_controller_and_killed_vehicle_are_said_and_the_node_goes_on(begin, monitor):
    start = ",".join(map(str, LOST_BY_THE_CONTROLLER[0]))
    node = begin(UNDER_THE_COMMAND_LINE, "/")
    boat = begin(VEHICLE, f"/={start}")
    controller = begin(CONTROLLER, "/")
    monitor.until(lambda m: sum(not r.lost for r in m.records) > 60)  # 1.2 s under way
    assert not monitor.last("command")

    os.kill(controller.pid, signal.SIGKILL)
    waited = monitor.until(lambda m: m.last("command"))
    assert 0.15 < waited < 2
    assert 0.25 <= silent_for(monitor.records, "command") < 2.0, "after its patience, rounded"
    under_way = len(monitor.states)
    monitor.until(lambda m: len(m.states) > under_way + 75)
    assert monitor.last("command")
    assert worst(monitor.states) <= 0

    os.kill(boat.pid, signal.SIGKILL)
    waited = monitor.until(lambda m: m.last("measurement"))
    assert 0.15 < waited < 2
    assert 0.25 <= silent_for(monitor.records, "measurement") < 2.0
    record = monitor.records[-1]
    assert record.status == "no measurement"
    assert record.input == {"tau_u": 0.0, "tau_r": 0.0}
    monitor.until(lambda m: m.reports and m.reports[-1].level == 2)
    assert "no measurement for" in monitor.reports[-1].message

    begin(BOTH, f"/={start}")
    monitor.until(lambda m: m.last(""))
    heard = len(monitor.states)
    monitor.until(lambda m: len(m.states) > heard + 50)
    assert worst(monitor.states[heard:]) <= 0
    assert node.poll() is None

    node.send_signal(signal.SIGTERM)
    assert node.wait(60) == 0
    monitor.until(lambda m: m.reports[-1].level == 3)
    assert monitor.commands[-1].force.x == 0.0


@pytest.mark.heavy
def test_ctrl_c_ends_the_node_cleanly_and_its_name_leaves_the_graph(begin, monitor):
    node = begin(FILTER, "/")

    def listed(m):
        return any(token.endswith("/NN/%/%/safety_filter") for token in m.node.graph())

    monitor.until(lambda m: m.records and listed(m))
    node.send_signal(signal.SIGINT)
    assert node.wait(60) == 0
    monitor.until(lambda m: not listed(m), 5)


# -- what should not come


def stepped(node, reached):
    """Samples of a node in this process, until something is so."""
    began = time.monotonic()
    while True:
        record = node.step(time.monotonic())
        if reached(record):
            return record
        assert time.monotonic() - began < 10
        time.sleep(0.01)


def test_node_that_is_there_before_its_router_is_heard_afterwards():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    boat = hf.Plant(hf.systems.marine_vehicle(), [-1.3, 0.2, 0.0, 0.0, 0.0, 0.0])
    network = Network(connect=(address,))
    with FilterNode(camera_filter(), network=network) as node:
        assert node.step(time.monotonic()).lost == "measurement"
        with router(address), VehicleNode(boat, network=network) as sea:

            def measured(record):
                sea.step(time.monotonic())
                return record.lost == "command"

            stepped(node, measured)


def test_garbage_on_the_topics_is_counted_and_said_and_does_no_harm(hub, monitor):
    face = Interface(hf.systems.marine_vehicle())
    state = dict(zip(face.states, [-1.3, 0.2, 0.0, 0.0, 0.0, 0.0], strict=True))
    good = ros.encoded(face.odometry(state, 0))
    elsewhere = Interface(hf.systems.marine_vehicle(), frame="odom")
    wrong = ros.encoded(elsewhere.odometry(state, 0))
    sideways = ros.made("geometry_msgs/msg/Wrench", force=ros.vector(y=1.0), torque=ros.vector())
    cases = [
        ("odometry", ros.ODOMETRY, b"", True, "0 bytes are no nav_msgs/msg/Odometry"),
        ("odometry", ros.ODOMETRY, b"\xff" * 720, True, "720 bytes are no nav_msgs/msg/Odometry"),
        ("odometry", ros.ODOMETRY, good[:-9], True, "bytes are no nav_msgs/msg/Odometry"),
        ("odometry", ros.ODOMETRY, good, False, "no node of ROS 2: an attachment of 0 bytes"),
        ("odometry", ros.ODOMETRY, wrong, True, "Odometry in the frame 'odom'; expected map"),
        ("odometry", STRING, good, True, "a message of type std_msgs::msg::dds_::String_"),
        ("nominal_command", "geometry_msgs/msg/Twist", good, True, "a message of type geometry"),
        ("nominal_command", "geometry_msgs/msg/Wrench", ros.encoded(sideways), True, "force.y"),
    ]
    with (
        FilterNode(camera_filter(), network=local(hub)) as node,
        Node("stranger", network=local(hub)) as stranger,
    ):
        topics = {"odometry": node._odometry, "nominal_command": node._nominal}
        for topic, kind, data, attached, why in cases:
            key = wire.topic_key(5, f"/{topic}", kind, ros.digest(kind))
            note = wire.Attachment(1, 0, bytes(16)).encode() if attached else None
            before = topics[topic].refused

            def refused(record, heard=topics[topic], before=before, key=key, data=data, note=note):
                if heard.refused == before:  # not yet connected
                    stranger._session.put(key, data, attachment=note)
                return heard.refused > before

            record = stepped(node, refused)
            assert why in topics[topic].why
            assert record.status == "no measurement"

        def reported(m):
            node.step(time.monotonic())
            told = {v.key: v.value for r in m.reports for v in r.values}
            return (
                bool(told)
                and int(told["odometry refused"]) >= 6
                and int(told["command refused"]) >= 2
            )

        monitor.until(reported)
        told = {v.key: v.value for v in monitor.reports[-1].values}
        assert told["command refused because"].startswith("a command of force.y")

        stranger_says = stranger.publisher("odometry", ros.ODOMETRY)

        def not_a_number(record):
            stranger_says.send(face.odometry({**state, "psi": math.nan}, 0))
            return record.status == "not a number"

        assert stepped(node, not_a_number).input == {"tau_u": 0.0, "tau_r": 0.0}


def test_garbage_beside_good_messages_is_a_warning(hub, monitor):
    face = Interface(hf.systems.marine_vehicle())
    state = dict(zip(face.states, [-1.3, 0.2, 0.0, 0.0, 0.0, 0.0], strict=True))
    with (
        FilterNode(camera_filter(), network=local(hub)) as node,
        Node("other", network=local(hub)) as other,
    ):
        odometry = other.publisher("odometry", ros.ODOMETRY)
        asks = other.publisher("nominal_command", face.command)
        text = other.publisher("nominal_command", STRING)
        garbage = False

        def reported(level):
            def so(m):
                odometry.send(face.odometry(state, 0))
                asks.send(face.wrap({"tau_u": 0.1, "tau_r": 0.0}, 0))
                if garbage:
                    text.send(ros.made(STRING, data="stop"))
                node.step(time.monotonic())
                last = m.reports[-1] if m.reports else None
                return last and last.message == "passed" and last.level == level

            return so

        monitor.until(reported(0))
        garbage = True
        monitor.until(reported(1))
        garbage = False
        monitor.until(reported(0))


# -- a map


def robot_filter(**settings):
    """A robot with a disc around it among the cells of a map."""
    return hf.SafetyFilter(
        hf.systems.unicycle(),
        obstacles=hf.Obstacles(20, hull=0.15, lead=0.3),
        gains=(1, 4),
        **settings,
    )


def wall_ahead(unknown="free"):
    cells = np.zeros((40, 40))
    cells[:, 30:32] = 100
    return hf.OccupancyMap(cells, 0.1, (-2.0, -2.0, 0.0), unknown=unknown)


def test_newest_map_of_a_topic_keeps_a_robot_from_its_walls(hub):
    """A latched map that was sent before the filter was there; later one without the wall."""
    robot = hf.systems.unicycle()
    face = Interface(robot)
    with (
        Node("map_server", network=local(hub)) as server,
        Node("other", network=local(hub)) as other,
    ):
        maps = server.publisher("map", ros.GRID, latched=True)
        maps.send(ros.grid_of(wall_ahead(), 0, "map"))
        odometry = other.publisher("odometry", ros.ODOMETRY)
        asks = other.publisher("nominal_command", face.command)
        with FilterNode(robot_filter(), network=local(hub), map="map", unknown="free") as node:
            state = dict(zip(face.states, [0.35, 0.0, 0.0], strict=True))

            def asked(record):
                odometry.send(face.odometry(state, 0))
                asks.send(face.wrap({"v": 1.0, "r": 0.0}, 0))
                return record.status == "changed"

            record = stepped(node, asked)
            assert record.input["v"] < 0.1
            assert "body 1 of the map" in record.why
            before = node.map
            maps.send(
                ros.grid_of(
                    hf.OccupancyMap(np.zeros((40, 40)), 0.1, (-2, -2, 0), unknown="free"), 0, "map"
                )
            )
            stepped(node, lambda record: asked(record) or record.status == "passed")
            assert node.map is before  # updated in place


def test_a_filter_moves_nothing_before_a_map_came_and_refuses_one_without_a_frame(hub):
    face = Interface(hf.systems.unicycle())
    with (
        FilterNode(robot_filter(), network=local(hub), map="map") as node,
        Node("other", network=local(hub)) as other,
    ):
        odometry = other.publisher("odometry", ros.ODOMETRY)
        asks = other.publisher("nominal_command", face.command)
        maps = other.publisher("map", ros.GRID, latched=True)
        whys = []
        for frame, why in (("", "a map with no frame"), ("odom", "a map in the frame 'odom'")):

            def refused(record, frame=frame, why=why):
                odometry.send(face.odometry({"x": 0.0, "y": 0.0, "psi": 0.0}, 0))
                asks.send(face.wrap({"v": 1.0, "r": 0.0}, 0))
                maps.send(ros.grid_of(wall_ahead(), 0, frame))
                whys.append(record.why)
                return why in node._map.why

            record = stepped(node, refused)
            assert record.status == "no measurement"
            assert record.input == {"v": 0.0, "r": 0.0}
        assert "no map yet: the input is the fallback" in whys


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda m: setattr(m.header, "frame_id", ""), "a map with no frame"),
        (lambda m: setattr(m.header, "frame_id", "odom"), "frame 'odom'; expected map"),
        (lambda m: setattr(m.info.origin.orientation, "x", 0.5), "tilted"),
        (lambda m: setattr(m.info.origin.orientation, "w", math.nan), "origin of the map"),
        (lambda m: setattr(m.info.origin.position, "y", math.inf), "origin of the map"),
        (lambda m: setattr(m.info, "resolution", -0.1), "resolution of the map is -0.1"),
        (lambda m: setattr(m.info, "width", 41), "a map of 40 x 41 cells has 1600"),
        (lambda m: (setattr(m.info, "width", 0), setattr(m, "data", np.zeros(0, np.int8))), "shape"),
        (lambda m: m.data.__setitem__(5, 101), "row 0, column 5 is 101"),
    ],
)  # fmt: skip
def test_a_map_that_is_none_is_refused_in_a_line(change, why):
    message = ros.decoded(ros.encoded(ros.grid_of(wall_ahead(), 7, "map")), ros.GRID)
    message = ros.made(ros.GRID, header=message.header, info=message.info, data=message.data.copy())
    change(message)
    with pytest.raises(MessageError, match=why) as refused:
        Interface(hf.systems.unicycle()).map(message)
    assert "\n" not in str(refused.value)


def test_a_map_returns_from_its_message():
    world = hf.OccupancyMap(wall_ahead().cells, 0.1, (1.0, -2.0, 0.7), unknown="free")
    message = ros.decoded(ros.encoded(ros.grid_of(world, 7, "map")), ros.GRID)
    again = Interface(hf.systems.unicycle()).map(message, "free")
    assert (again.cells == world.cells).all()
    assert again.resolution == 0.1
    assert again.origin == pytest.approx(world.origin)
    assert Interface(hf.systems.unicycle()).map(message, "free", again) is again


def test_a_map_beside_a_filter_without_obstacles_is_refused():
    with pytest.raises(DefinitionError, match="a map is given, and the filter keeps clear of no"):
        FilterNode(camera_filter(), map="map")


def test_samples_that_pass_during_a_long_step_are_skipped_and_counted():
    loop, times = Loop(0.02), []

    def step(now):
        times.append(now)
        if len(times) == 3:
            time.sleep(0.09)

    loop.run(step, seconds=0.2)
    assert loop.skipped >= 3
    assert len(times) + loop.skipped >= 10
    assert all(b > a for a, b in itertools.pairwise(times))


def test_any_bytes_are_a_message_or_an_error_that_says_so():
    face = Interface(hf.systems.marine_vehicle())
    good = ros.encoded(face.odometry(dict(zip(face.states, range(6), strict=True)), 1))
    generator = np.random.default_rng(2)
    refused = 0
    for _ in range(2000):
        data = bytearray(good)
        for _ in range(generator.integers(1, 6)):
            data[generator.integers(len(data))] = generator.integers(256)
        cut = generator.integers(len(data) + 1) if generator.random() < 0.5 else len(data)
        try:
            face.state(ros.decoded(bytes(data[:cut]), ros.ODOMETRY))
        except MessageError:
            refused += 1
    assert 1000 < refused < 2000


def test_nodes_of_other_domains_and_namespaces_do_not_hear_each_other(hub):
    face = Interface(hf.systems.marine_vehicle())
    message = face.odometry(dict(zip(face.states, [-1.3, 0.1, 0, 0, 0, 0], strict=True)), 0)
    places = {(5, "/"): 1, (6, "/"): 0, (5, "/other"): 0}
    keep = camera_filter()
    nodes = {
        (domain, space): FilterNode(keep, namespace=space, network=local(hub, domain))
        for domain, space in places
    }
    with Node("boat", network=local(hub)) as boat:
        says = boat.publisher("odometry", ros.ODOMETRY)

        def heard(record):
            says.send(message)
            return not record.lost or record.lost == "command"

        stepped(nodes[5, "/"], heard)
        for place, node in nodes.items():
            record = node.step(time.monotonic())
            assert (record.lost == "command") == places[place]
            assert (node._odometry.received > 0) == places[place]
            node.close()


def test_depth_of_a_command_is_passed_on_while_commands_come(hub):
    """The filter is of the plane; what the controller wants out of it is left as it is."""
    face = Interface(hf.systems.marine_vehicle())
    with (
        FilterNode(camera_filter(), network=local(hub)) as node,
        Node("other", network=local(hub)) as other,
    ):
        odometry = other.publisher("odometry", ros.ODOMETRY)
        asks = other.publisher("nominal_command", face.command)
        hears = other.subscription("command", face.command)
        state = dict(zip(face.states, [-1.3, 0, 0, 0, 0, 0], strict=True))
        got = []

        def answered(record):
            odometry.send(face.odometry(state, 0))
            asks.send(face.wrap({"tau_u": 0.5, "tau_r": 0.0}, 0, {"force.z": -3.0}))
            got.extend(hears.take())
            return bool(got) and got[-1].force.x == 0.5

        stepped(node, answered)
        assert got[-1].force.z == -3.0

        def silent(record):
            got.extend(hears.take())
            return record.lost == "measurement" and bool(got) and got[-1].force.z == 0.0

        stepped(node, silent)


# -- on the wire

GRAPH = (
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener",
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/"
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    "/::,10:,:,:,,",
)
"""Examples of docs/design.md in the repository ros2/rmw_zenoh."""

HASHES = {
    STRING: "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    ros.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "geometry_msgs/msg/Wrench": "018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52",
    "geometry_msgs/msg/WrenchStamped": "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
"""As public nodes for rmw_zenoh state them, who read them from `ros2 topic info -v`."""


def test_keys_and_tokens_are_those_of_the_design_document_of_rmw_zenoh():
    listener = wire.NodeName("listener", domain=2)
    digest = ros.digest(STRING)
    session = "aac3178e146ba6f1fc6e6a4085e77f21"
    assert wire.node_token(listener, session) == GRAPH[0]
    topic = listener.topic("chatter")
    assert wire.endpoint_token(listener, session, 10, "MS", topic, STRING, digest) == GRAPH[1]
    robot = wire.NodeName("talker", "/robot1")
    assert wire.topic_key(0, robot.topic("chatter"), STRING, digest) == (
        f"0/robot1/chatter/std_msgs::msg::dds_::String_/RIHS01_{HASHES[STRING]}"
    )
    assert robot.topic("~/decisions") == "/robot1/talker/decisions"
    assert robot.topic("/diagnostics") == "/diagnostics"


def test_hashes_of_types_are_those_of_ros_2_jazzy():
    assert {kind: f"RIHS01_{h}" for kind, h in HASHES.items()} == {
        kind: ros.digest(kind) for kind in HASHES
    }


def test_attachment_is_number_time_and_identifier():
    """Little-endian, with the length before the identifier: 33 bytes."""
    made = wire.Attachment(1, 1_700_000_000_123_456_789, bytes(range(16)))
    data = made.encode()
    assert data[:8] == (1).to_bytes(8, "little")
    assert data[8:16] == (1_700_000_000_123_456_789).to_bytes(8, "little")
    assert data[16:] == b"\x10" + bytes(range(16))
    assert wire.Attachment.decode(data) == made
    for wrong in (b"", data[:-1], data + b"\0", data[:16] + b"\x0f" + data[17:]):
        with pytest.raises(ValueError, match="bytes instead of"):
            wire.Attachment.decode(wrong)


def test_identifier_is_the_hash_of_the_token_low_half_first():
    """XXH3-128 of an empty text is 99aa06d3014798d86001c324468d497f (xxHash's own test vector)."""
    assert wire.gid("").hex() == "7f498d4624c30160d8984701d306aa99"


def test_bytes_of_rclpy_are_read_and_written():
    """What `rclpy.serialization` wrote, as others published it; its padding is not zeroed."""
    twist = bytes.fromhex(
        "00010000" "000000000000f83f" "000000000000d0bf" + "00" * 24 + "000000000000e83f"
    )  # fmt: skip
    message = ros.decoded(twist, "geometry_msgs/msg/Twist")
    assert (message.linear.x, message.linear.y, message.angular.z) == (1.5, -0.25, 0.75)
    assert ros.encoded(message) == twist

    stamped = bytes.fromhex(
        "00010000" "07000000" "08000000" "050000006f646f6d00" "6c696e6b000c08"
        "0000000000000040" + "00" * 32 + "000000000000f4bf"
    )  # fmt: skip
    message = ros.decoded(stamped, "geometry_msgs/msg/TwistStamped")
    assert (message.header.frame_id, message.header.stamp.nanosec) == ("odom", 8)
    assert (message.twist.linear.x, message.twist.angular.z) == (2.0, -1.25)
    written = ros.encoded(message)
    assert written[:21] == stamped[:21]
    assert written[28:] == stamped[28:]

    header = ros.made(
        "std_msgs/msg/Header",
        stamp=ros.made("builtin_interfaces/msg/Time", sec=1, nanosec=2),
        frame_id="map",
    )
    assert ros.encoded(header).hex() == "000100000100000002000000040000006d617000"


def test_names_that_ros_2_does_not_allow_are_refused(monkeypatch):
    for name in ("", "1st", "a b", "a/b", "a__b"):
        with pytest.raises(DefinitionError, match="names no node"):
            wire.NodeName(name)
    for space in ("", "robot", "/robot/", "/1"):
        with pytest.raises(DefinitionError, match="is no namespace"):
            wire.NodeName("a", space)
    for topic in ("", "/", "a//b", "~", "a/*", "a/**", "@a", "a__b", "é"):
        with pytest.raises(DefinitionError, match="names no topic"):
            wire.NodeName("a").topic(topic)
    with pytest.raises(DefinitionError, match="0 to 232"):
        wire.NodeName("a", domain=233)
    with pytest.raises(DefinitionError, match="connect is 'tcp/localhost:7447'"):
        Network(connect="tcp/localhost:7447")
    with pytest.raises(DefinitionError, match="did you mean 'nav_msgs/msg/Odometry'"):
        ros.digest("nav_msgs/msg/Odometri")
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert Network().domain_id() == 42
    monkeypatch.setenv("ROS_DOMAIN_ID", "all")
    with pytest.raises(DefinitionError, match="ROS_DOMAIN_ID is 'all'"):
        Network().domain_id()


def test_address_that_cannot_be_used_is_refused(hub, tmp_path, monkeypatch):
    with pytest.raises(OutputError, match="in use"), router(hub):
        pass
    for wrong in ("nonsense", "tcp/", "carrier_pigeon/1"):
        with pytest.raises(OutputError, match="no session of Zenoh"):
            Node("a", network=Network(connect=(), listen=(wrong,)))
    monkeypatch.setenv("ZENOH_SESSION_CONFIG_URI", str(tmp_path / "none.json5"))
    with pytest.raises(OutputError, match="no session of Zenoh"):
        Node("a")


def test_missing_package_is_named_with_its_remedy():
    code = "import sys; sys.modules['zenoh'] = None; import holdfast.interop.ros2"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "needs the package 'zenoh'; python -m pip install \"holdfast[interop]\"" in found.stderr


# -- states and inputs


def test_fields_of_the_command_follow_from_the_units_of_the_inputs():
    face = Interface(hf.systems.marine_vehicle())
    assert face.command == "geometry_msgs/msg/Wrench"
    assert face.fields == {"tau_u": "force.x", "tau_r": "torque.z"}
    robot = Interface(hf.systems.unicycle(), stamped=True)
    assert robot.command == "geometry_msgs/msg/TwistStamped"
    assert robot.fields == {"v": "linear.x", "r": "angular.z"}
    assert robot.states == ("x", "y", "psi")
    message = ros.decoded(ros.encoded(robot.wrap({"v": 0.2, "r": -0.1}, 5)), robot.command)
    assert robot.inputs(message)[0] == {"v": 0.2, "r": -0.1}
    assert message.header.stamp.nanosec == 5


def test_state_returns_from_its_odometry_whatever_the_tilt_and_the_turns():
    face = Interface(hf.systems.marine_vehicle())
    generator = np.random.default_rng(1)
    for _ in range(50):
        state = dict(zip(face.states, generator.uniform(-9, 9, 6).tolist(), strict=True))
        message = ros.decoded(ros.encoded(face.odometry(state, 10**18 + 1)), ros.ODOMETRY)
        found = face.state(message)
        turned = found.pop("psi") - state.pop("psi")
        assert found == state
        assert math.remainder(turned, 2 * math.pi) == pytest.approx(0, abs=1e-12)
    rolled = ros.made("geometry_msgs/msg/Quaternion", x=0.3, y=0.0, z=0.0, w=0.9)
    assert ros.heading_of(rolled) == pytest.approx(0)
    half = ros.made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.3, w=0.4)
    assert ros.heading_of(half) == pytest.approx(2 * math.atan2(3, 4))
    none = ros.made("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
    assert math.isnan(ros.heading_of(none))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pose": ("x", "y", "theta")}, "no state 'theta'"),
        ({"pose": ("x", "psi", "y")}, "state 'psi' is in rad; expected m"),
        ({"twist": ("u", "v", "w")}, "no state 'w'"),
        ({"pose": ("x", "y")}, "pose has 2 names and twist 3"),
        ({"fields": {"tau_u": "force.x"}}, "fields are given for tau_u; expected tau_u, tau_r"),
        ({"fields": {"tau_u": "torque.x", "tau_r": "torque.z"}}, "'torque.x' for input 'tau_u'"),
        ({"fields": {"tau_u": "linear.x", "tau_r": "torque.z"}}, "'linear.x' for input 'tau_u'"),
    ],
)
def test_interface_that_does_not_fit_the_system_is_refused(settings, said):
    with pytest.raises(DefinitionError, match=said.replace(".", r"\.")):
        Interface(hf.systems.marine_vehicle(), **settings)


def test_systems_and_filters_that_no_message_fits_are_refused(hub):
    with pytest.raises(DefinitionError, match="which states are its pose"):
        Interface(hf.systems.nonholonomic_integrator())
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True)),
        (hf.Quantity("share"),), {"x": hf.symbol("share"), "y": hf.symbol("x"), "psi": hf.symbol("y")},
        input_bounds=hf.Box((-1,), (1,)), empirical="a chain of integrators",
    )  # fmt: skip
    with pytest.raises(DefinitionError, match=r"no standard message has .*share \[1\]"):
        Interface(cart)
    keep = camera_filter()
    partly = Interface(hf.systems.marine_vehicle(), twist=("u", None, "r"))
    with pytest.raises(DefinitionError, match="the filter measures v, which Odometry does not"):
        FilterNode(keep, interface=partly)
    with pytest.raises(DefinitionError, match="the interface is of inputs v, r"):
        FilterNode(keep, interface=Interface(hf.systems.unicycle()))
    with pytest.raises(DefinitionError, match="'an odometry' names no topic"):
        FilterNode(keep, odometry="an odometry")
    with pytest.raises(SimulationError, match="patience"):
        serve(keep, patience=0.0, network=local(hub))


def test_vehicle_without_commands_stays_and_moves_by_those_that_come(hub):
    vehicle = hf.systems.marine_vehicle()
    face = Interface(vehicle)
    with (
        VehicleNode(hf.Plant(vehicle, [-1.3, 0, 0, 0, 0, 0]), network=local(hub)) as boat,
        ControllerNode(lambda s: [1.0, 0.0], face, network=local(hub), command="command") as drive,
    ):
        assert boat.plant.state[0] == -1.3

        def moved(_):
            drive.step(time.monotonic())
            return boat.plant.state[0] > -1.29

        boat.step(time.monotonic())
        assert boat.plant.state[0] == -1.3
        stepped(boat, moved)
        drive.close()
        stepped(boat, lambda _: boat._input == [1.0, 0.0] and time.monotonic() - boat._at > 0.5)
        speed = boat.plant.state[3]
        for _ in range(20):
            boat.step(time.monotonic())
        assert boat.plant.state[3] < speed


def test_decisions_of_a_served_filter_are_lines_of_json(hub, monitor):
    records = []
    serve(camera_filter(), said=records.append, seconds=0.3, network=local(hub))
    assert len(records) == 15
    monitor.until(lambda m: len(m.records) > 2, 5)
    assert json.loads(monitor.records[0].line())["status"] == "no measurement"
