"""Logs of messages: MCAP files and bags of ROS 2, their topics, times and faults."""

import json
import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError, SimulationError

for package in ("mcap", "rosbags", "pandas"):
    pytest.importorskip(package, reason="needs holdfast[interop]")

from mcap.writer import Writer  # noqa: E402
from rosbags import rosbag2  # noqa: E402

from holdfast.interop import ros_messages as ros  # noqa: E402
from holdfast.interop.logs.read import read_log  # noqa: E402

BOAT = hf.systems.marine_vehicle()
COUNT, BEGAN = 60, 1_700_000_000_000_000_000
T = np.arange(COUNT) * 0.1
HEADING = 0.7 * T
STATES = {"x": 2 * T, "y": T**2, "psi": HEADING, "u": np.cos(T), "v": 0.1 * T, "r": 0.7 + 0 * T}
SURGE = np.repeat(np.arange(6.0), 10)


def nanoseconds(t):
    return round(t * 1e9)


def odometry(k, stamp):
    x, y, psi, u, v, r = (float(STATES[n][k]) for n in STATES)
    return ros.odometry((x, y, psi), (u, v, r), stamp, "odom", "boat")


def wrench(k):
    return ros.made(
        "geometry_msgs/msg/Wrench", force=ros.vector(SURGE[k]), torque=ros.vector(z=0.5)
    )


def bag(folder, messages):
    """A bag of (topic, log time [ns], message)."""
    with rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        topics = {}
        for topic, when, message in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=ros.STORE
                )
            writer.write(topics[topic], when, ros.encoded(message))
    return folder


def under_way(clock=lambda t: BEGAN + nanoseconds(t), late=lambda k: 0.02, more=()):
    """Odometry with a header of a clock, written later; a command without a header."""
    for k, t in enumerate(T):
        when = BEGAN + nanoseconds(t + late(k))
        yield "/odom", when, odometry(k, clock(t))
        yield "/cmd", when, wrench(k)
        for topic, message in more:
            yield topic, when, message


def as_sent(log):
    for name, value in STATES.items():
        assert log.states[name].value == pytest.approx(value, abs=1e-12)
    assert log.inputs["tau_u"].value == pytest.approx(SURGE)
    assert log.inputs["tau_r"].value == pytest.approx(np.full(COUNT, 0.5))
    assert np.diff(log.states["x"].time) == pytest.approx(np.diff(T), abs=1e-6)


@pytest.mark.parametrize("single", [False, True], ids=["bag", "file"])
def test_only_odometry_and_only_wrench_are_the_states_and_the_inputs(tmp_path, single):
    folder = bag(tmp_path / "run", under_way())
    log = read_log(next(folder.glob("*.mcap")) if single else folder, BOAT)
    as_sent(log)
    late = log.inputs["tau_u"].time - log.states["x"].time
    assert late == pytest.approx(np.full(COUNT, 0.02), abs=1e-6)
    assert log.repairs == tuple(
        f"{n}: times are those of the log, not of a header" for n in ("tau_u", "tau_r")
    )


def test_fields_are_named_with_their_topic_and_unit(tmp_path):
    folder = bag(tmp_path / "run", under_way())
    names = {
        "x": "/odom:pose.pose.position.y",
        "psi": "/odom:pose.pose.orientation.heading",
        "u": "/cmd:force.x [cm/s]",
    }
    log = read_log(folder, BOAT, names=names)
    assert log.states["x"].value == pytest.approx(STATES["y"])
    assert log.states["psi"].value == pytest.approx(HEADING)
    assert log.states["u"].value == pytest.approx(SURGE / 100)
    for wrong, cause in (
        ("/odon:pose.pose.position.x", "did you mean '/odom:pose.pose.position.x'"),
        ("/odom:pose.pose.position.w", "did you mean '/odom:pose.pose.position.z'"),
        ("/odom", "no column '/odom'"),
        ("/odom:header.frame_id", "no column"),
    ):
        with pytest.raises(SimulationError, match=cause):
            read_log(folder, BOAT, names={"x": wrong})


def test_topics_are_not_guessed_where_two_could_be_meant(tmp_path):
    twice = bag(tmp_path / "run", under_way(more=[("/odom2", odometry(0, BEGAN))]))
    with pytest.raises(SimulationError, match=r"no state of system .* the log has /odom:"):
        read_log(twice, BOAT)


def test_commands_come_to_the_clock_of_a_simulation_at_half_the_speed(tmp_path):
    folder = bag(tmp_path / "run", under_way(clock=lambda t: nanoseconds(5 + t / 2)))
    log = read_log(folder, BOAT)
    assert log.states["x"].time == pytest.approx(T / 2, abs=1e-6)
    assert log.inputs["tau_u"].time == pytest.approx(T / 2, abs=1e-6)
    assert "tau_u: times are those of the log, brought to the clock of /odom" in log.repairs


def test_order_of_measuring_counts_not_that_of_writing(tmp_path):
    folder = bag(tmp_path / "run", under_way(late=lambda k: 0.25 if k == 20 else 0.02))
    log = read_log(folder, BOAT)
    as_sent_times = log.states["x"].time - log.states["x"].time[0]
    assert as_sent_times == pytest.approx(T, abs=1e-6)
    assert log.states["x"].value == pytest.approx(STATES["x"])
    assert "x: time goes back 1 times, sorted" in log.repairs


def objects(path, rows, encoding="json", schema="jsonschema", text=b"{}"):
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        of = writer.register_schema("boat", schema, text)
        channel = writer.register_channel("/boat", encoding, of)
        for when, row in rows:
            data = row if isinstance(row, bytes) else json.dumps(row).encode()
            writer.add_message(channel, when, data, when)
        writer.finish()
    return path


def test_objects_of_json_have_states_by_name_and_by_path(tmp_path):
    rows = [
        (nanoseconds(t), {"x": 2 * t, "state": {"psi": math.remainder(3 * t, 2 * math.pi)},
         "thrust": [t, -t], "name": "boat", "on": True})
        for t in T
    ]  # fmt: skip
    rows[8] = (rows[8][0], b"{")
    rows[9] = (rows[9][0], {"x": 10**400, "header": {"stamp": {"sec": "now"}}})
    path = objects(tmp_path / "a.mcap", rows)
    names = {"psi": "/boat:state.psi", "tau_u": "/boat:thrust.1"}
    log = read_log(path, BOAT, names=names)
    left = np.delete(T, [8, 9])
    assert log.states["x"].time == pytest.approx(left)
    assert log.states["x"].value == pytest.approx(2 * left)
    assert log.states["psi"].value == pytest.approx(3 * left)
    assert log.inputs["tau_u"].value == pytest.approx(-left)


def test_files_that_are_damaged_or_of_another_encoding_are_refused(tmp_path):
    whole = objects(tmp_path / "a.mcap", [(k, {"x": k}) for k in range(500)]).read_bytes()
    generator = np.random.default_rng(3)
    for n in range(40):
        spoilt = bytearray(whole)
        for at in generator.integers(0, len(whole), 3):
            spoilt[at] = generator.integers(0, 256)
        path = tmp_path / f"{n}.mcap"
        path.write_bytes(spoilt[: generator.integers(10, len(whole))] if n % 2 else spoilt)
        try:
            log = read_log(path, BOAT)
        except HoldfastError:
            continue
        assert np.isfinite(log.states["x"].value).all()
    unknown = objects(tmp_path / "b.mcap", [(1, b"1")], "protobuf", "protobuf")
    with pytest.raises(SimulationError, match="no message that can be read: /boat"):
        read_log(unknown, BOAT)
    odd = objects(tmp_path / "c.mcap", [(1, b"1")], "cdr", "ros2msg", b"no definition at all")
    with pytest.raises(SimulationError, match="no message that can be read: /boat"):
        read_log(odd, BOAT)
    (tmp_path / "folder").mkdir()
    with pytest.raises(SimulationError, match="cannot be read"):
        read_log(tmp_path / "folder", BOAT)
    (tmp_path / "part.db3").write_bytes(b"SQLite format 3\0")
    with pytest.raises(SimulationError, match="give its folder"):
        read_log(tmp_path / "part.db3", BOAT)


def test_images_beside_the_odometry_are_left_out_and_said(tmp_path):
    image = ros.made(
        "sensor_msgs/msg/CompressedImage", header=ros.header(BEGAN, ""), format="jpeg",
        data=np.zeros(100_000, np.uint8),
    )  # fmt: skip
    log = read_log(bag(tmp_path / "run", under_way(more=[("/camera", image)])), BOAT)
    as_sent(log)
    assert "topic /camera cannot be read" in log.repairs
