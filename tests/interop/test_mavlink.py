"""A safety filter as a MAVLink component: recorded frames, commands, streams, two processes."""

import hashlib
import math
import signal
import socket
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as common

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from holdfast.interop.mavlink import (
    BodyVelocity,
    Codec,
    ManualControl,
    SafetyComponent,
    SimulatedVehicle,
    serve,
)
from holdfast.interop.mavlink.component import Measurements
from holdfast.interop.planar_motion import PlanarMotion
from holdfast.interop.udp import Port
from tests.interop.mavlink_ends import GROUND, Boat, Ground
from tests.interop.recorded import recorded

START = [-1.3, 0.75, -0.35, 0, 0, 0]
KEY = bytes(range(32))


def pd(state):
    x, y, psi, u, _, r = state
    return {"tau_u": 4 * (-0.5 - x) - 6 * u, "tau_r": -0.6 * psi - 1.2 * y - 0.4 * r}


@pytest.fixture(scope="module")
def keep():
    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    return hf.SafetyFilter(vehicle, view, gains=(1.5, 8))


@pytest.fixture
def link(keep):
    """A component with a controller and a vehicle, on free ports, and a clock that is given."""
    made = []

    def make(commands=None, key=None, key_of_ends=None, **settings):
        keep.reset()
        commands = commands or ManualControl(keep.system)
        component = SafetyComponent(
            keep,
            commands,
            controller="udpin:127.0.0.1:0",
            vehicle="udpin:127.0.0.1:0",
            key=key,
            **settings,
        )
        ends = key if key_of_ends is None else key_of_ends
        ground = Ground(component.controller.port, ends)
        boat = Boat(component.vehicle.port, ends)
        made.extend([component, ground.port, boat.port])
        return component, ground, boat, commands

    yield make
    for one in made:
        one.close()


# -- frames


def test_recorded_stream_of_an_ardupilot_rover_is_read_whole():
    """It begins within a frame and has two that lost bytes: all others are found."""
    codec = Codec()
    found = list(codec.messages(recorded("mavlink.txt", "rover")))
    assert (codec.read, codec.broken) == (len(found), 2)
    kinds = [m.get_type() for m, _ in found]
    assert kinds.count("HEARTBEAT") == 2
    assert kinds.count("RAW_IMU") == kinds.count("BATTERY_STATUS") == 2
    beat = next(m for m, _ in found if m.get_type() == "HEARTBEAT")
    assert (beat.type, beat.autopilot) == (
        common.MAV_TYPE_GROUND_ROVER, common.MAV_AUTOPILOT_ARDUPILOTMEGA
    )  # fmt: skip
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m, _ in found} == {(1, 1)}
    gravity = next(m for m, _ in found if m.get_type() == "RAW_IMU").zacc
    assert gravity == -999  # mG: negative along z, as a specific force


def test_recorded_attitudes_of_px4_and_of_a_vehicle_at_rest_are_read():
    (attitude, frame), (beat, _) = Codec().messages(recorded("mavlink.txt", "px4"))
    assert (attitude.time_boot_ms, beat.autopilot) == (1086760, common.MAV_AUTOPILOT_PX4)
    assert (attitude.yaw, len(frame)) == (pytest.approx(-1.588567852973938), 40)
    ((rest, _),) = Codec().messages(recorded("mavlink.txt", "attitude"))
    assert (rest.time_boot_ms, rest.yaw) == (2347469, -2.4873046875)
    measured = Measurements(PlanarMotion(hf.systems.marine_vehicle()))
    measured.take(common.MAVLink_local_position_ned_message(2347460, 0, 0, 0, 0, 0, 0), 0.0)
    states, _ = measured.take(rest, 0.0)
    assert (states["psi"], states["r"]) == pytest.approx((2.4873046875, 0.000728), abs=1e-6)
    ((command, _),) = Codec().messages(recorded("mavlink.txt", "ground"))
    assert (command.get_srcSystem(), command.command) == (255, common.MAV_CMD_DO_REPOSITION)


def crc(data, extra):
    """CRC-16/MCRF4XX, written out."""
    found = 0xFFFF
    for byte in (*data, extra):
        byte ^= found & 0xFF
        byte = (byte ^ byte << 4) & 0xFF
        found = found >> 8 ^ byte << 8 ^ byte << 3 ^ byte >> 4
    return struct.pack("<H", found & 0xFFFF)


def by_hand(payload, number, extra, *, v1=False, sender=GROUND, sequence=0):
    """A frame from the specification alone."""
    if v1:
        head = struct.pack("<BBBBBB", 0xFE, len(payload), sequence, *sender, number)
    else:
        payload = payload.rstrip(b"\0") or b"\0"
        numbers = number & 0xFF, number >> 8 & 0xFF, number >> 16
        head = struct.pack("<BBBBBBBBBB", 0xFD, len(payload), 0, 0, sequence, *sender, *numbers)
    return head + payload + crc(head[1:] + payload, extra)


@pytest.mark.parametrize("v1", [False, True])
def test_manual_control_has_the_layout_of_the_specification(v1):
    """int16 x, y, z, r; uint16 buttons; uint8 target: message 69, extra byte 243."""
    vehicle = hf.systems.marine_vehicle()
    commands = ManualControl(vehicle)
    message = commands.of(
        {"tau_u": commands.full["tau_u"] / 2, "tau_r": -commands.full["tau_r"]}, 1
    )
    payload = struct.pack("<hhhhHB", 500, 0, 0, -1000, 0, 1)
    frame = by_hand(payload, 69, 243, v1=v1)
    assert Codec().frame(message, *GROUND, v1=v1) == frame
    ((read, _),) = Codec().messages(frame)
    assert (read.x, read.r, read.target) == (500, -1000, 1)


def test_broken_cut_and_foreign_bytes_are_counted_and_the_rest_is_read():
    beat = Codec().frame(common.MAVLink_heartbeat_message(10, 3, 0, 0, 4, 3), 1, 1)
    wrong = beat[:-3] + bytes([beat[-3] ^ 1]) + beat[-2:]
    codec = Codec()
    assert len(list(codec.messages(beat + wrong + beat))) == 2
    assert codec.broken == 1
    assert len(list(codec.messages(b"noise" + beat + beat[:9]))) == 1
    assert codec.garbage == len(wrong) + 5 + 9
    for hostile in (b"\xfd" * 60000, b"\xfe" * 60000, b"\xfd\xff\x00" * 20000):
        began = time.monotonic()
        list(codec.messages(hostile))
        assert time.monotonic() - began < 1.0


def test_no_frame_of_random_content_ends_the_component(link):
    """Valid frames of every message with random fields, NaN and infinity among them."""
    component, ground, boat, commands = link(commands=None)
    generator, sent = np.random.default_rng(0), 0
    special = [struct.pack("<f", v) for v in (math.nan, math.inf, -math.inf)]
    for number, kind in common.mavlink_map.items():
        for _ in range(40 if number in (30, 32, 69, 84, 331) else 2):
            size = int(generator.integers(1, kind.unpacker.size + 1))
            payload = bytearray(generator.bytes(size))
            for at in range(0, size - 4, 4):
                if generator.random() < 0.3:
                    payload[at : at + 4] = special[generator.integers(3)]
            frame = by_hand(bytes(payload), number, kind.crc_extra, sender=(1, 1))
            boat.port.send(frame)
            ground.port.send(frame)
            sent += 2
        component.turn(0.01 * number)
    assert component._from_vehicle.read + component._from_controller.read == sent
    for _ in range(300):
        boat.port.send(generator.bytes(int(generator.integers(0, 600))))
    component.turn(1e6)
    boat.states(START, 10.0**6)
    ground.send(commands.of(pd(START), 1))
    assert component.turn(1e6 + 1).status in ("changed", "passed", "no measurement")


def test_frame_of_an_unknown_message_passes_by_its_length():
    unknown = by_hand(b"abc", 60001, 17)
    ((message, frame),) = Codec().messages(unknown)
    assert (message.get_type(), frame) == ("UNKNOWN_60001", unknown)
    assert not list(Codec().messages(b"x" + unknown))  # nothing vouches for it behind garbage


# -- commands


def test_inputs_return_from_their_messages():
    vehicle, robot = hf.systems.marine_vehicle(), hf.systems.unicycle()
    for axes in ({"tau_u": "x", "tau_r": "r"}, {"tau_u": "z", "tau_r": "y"}):
        commands = ManualControl(vehicle, axes)
        assert commands.full["tau_u"] > 0 > commands.full["tau_r"]
        for share in (-1, -0.4, 0, 0.123, 1):
            given = {name: share * full for name, full in commands.full.items()}
            assert commands.command(commands.of(given, 1)) == pytest.approx(given)
        largest = commands.of(commands.full, 1)
        assert [getattr(largest, axis) for axis in axes.values()] == [1000, 1000]
    setpoint = BodyVelocity(robot)
    given = {"v": 0.25, "r": -0.5}
    message = setpoint.of(given, 1)
    assert (message.vx, message.yaw_rate) == (0.25, 0.5)  # to starboard is positive
    assert setpoint.command(message) == given


def test_axis_that_is_none_and_setpoints_of_other_kinds_are_no_commands():
    commands = ManualControl(hf.systems.marine_vehicle())
    for x, r in ((32767, 0), (0, 1001), (-1001, 0)):
        assert commands.command(common.MAVLink_manual_control_message(1, x, 0, 0, r, 0)) is None
    setpoint = BodyVelocity(hf.systems.unicycle())
    for changed in (
        {"coordinate_frame": 1}, {"type_mask": 0}, {"type_mask": 3527}, {"vy": 0.1}, {"vz": 0.1}
    ):  # fmt: skip
        message = setpoint.of({"v": 0.1, "r": 0.0}, 1)
        for name, value in changed.items():
            setattr(message, name, value)
        assert setpoint.command(message) is None


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ({"tau_u": "x"}, "'tau_r' has no field"),
        ({"tau_u": "x", "tau_r": "x"}, "the same field"),
        ({"tau_u": "x", "tau_r": "q"}, "'tau_r' is 'q'"),
        ({"tau_u": "x", "torque": "r"}, "no input 'torque'"),
    ],
)
def test_axes_that_do_not_fit_are_refused(axes, said):
    with pytest.raises(SimulationError, match=said):
        ManualControl(hf.systems.marine_vehicle(), axes)
    with pytest.raises(SimulationError, match="full says"):
        ManualControl(hf.systems.marine_vehicle(), full={"tau_u": 0.0})


# -- states


def test_states_are_those_of_both_messages_and_as_old_as_the_older():
    vehicle = hf.systems.marine_vehicle()
    measured = Measurements(PlanarMotion(vehicle))
    position = common.MAVLink_local_position_ned_message(1000, 1.0, 2.0, 0, 0.3, 0.4, 0)
    attitude = common.MAVLink_attitude_message(1010, 0, 0, math.pi / 2, 0, 0, 0.1)
    assert measured.take(position, 5.0) is None
    states, received = measured.take(attitude, 7.0)
    assert received == 5.0
    expected = {"x": 1, "y": -2, "psi": -math.pi / 2, "u": 0.4, "v": 0.3, "r": -0.1}
    assert states == pytest.approx(expected, abs=1e-7)
    old = common.MAVLink_attitude_message(990, 0, 0, 0.0, 0, 0, 0.1)
    assert measured.take(old, 7.1) is None
    assert (measured.stale, measured.restarts) == (1, 0)
    again = common.MAVLink_attitude_message(5, 0, 0, 0.0, 0, 0, 0.1)
    assert measured.take(again, 8.0) is None  # the position is of the time before
    assert measured.restarts == 1


def test_message_that_is_sent_again_is_no_newer_measurement():
    measured = Measurements(PlanarMotion(hf.systems.marine_vehicle()))
    measured.take(common.MAVLink_local_position_ned_message(1000, 1, 2, 0, 0, 0, 0), 1.0)
    attitude = common.MAVLink_attitude_message(1000, 0, 0, 0.1, 0, 0, 0)
    assert measured.take(attitude, 1.0) is not None
    assert [measured.take(attitude, t) for t in (2.0, 3.0)] == [None, None]
    assert measured.stale == 2


def test_odometry_gives_the_same_states():
    vehicle, half = hf.systems.marine_vehicle(), math.pi / 4
    measured, none = Measurements(PlanarMotion(vehicle)), [math.nan] * 21
    message = common.MAVLink_odometry_message(
        10**6, 1, 12, 1, 2, 0, [math.cos(half), 0, 0, math.sin(half)],
        0.4, -0.3, 0, 0, 0, 0.1, none, none,
    )  # fmt: skip
    states, received = measured.take(message, 3.0)
    expected = {"x": 1, "y": -2, "psi": -math.pi / 2, "u": 0.4, "v": 0.3, "r": -0.1}
    assert received == 3.0
    assert states == pytest.approx(expected, abs=1e-7)
    message.child_frame_id = 8
    assert measured.take(message, 3.1) is None
    assert measured.other == 1


# -- the component


def test_command_that_the_filter_passes_is_sent_as_it_was(link):
    component, ground, boat, commands = link()
    boat.states([-1.3, 0.2, 0, 0, 0, 0], 0.0)
    given = common.MAVLink_manual_control_message(1, 40, 7, 500, -3, 5)
    ground.send(given, sender=(255, 190))
    record = component.turn(0.0)
    assert (record.status, record.lost) == ("passed", "")
    (sent,) = [m for m in boat.hear() if m.get_type() == "MANUAL_CONTROL"]
    assert sent.to_dict() == given.to_dict()
    assert (sent.get_srcSystem(), sent.get_srcComponent()) == (255, 190)
    assert record.input == commands.command(given)


def test_command_that_would_lose_the_target_is_changed_and_said(link):
    component, ground, boat, commands = link()
    boat.states(START, 0.0)
    ground.send(commands.of(pd(START), 1))
    record = component.turn(0.0)
    assert record.overruled
    (sent,) = [m for m in boat.hear() if m.get_type() == "MANUAL_CONTROL"]
    expected = {name: pytest.approx(value, abs=abs(commands.full[name]) / 1999)
                for name, value in record.input.items()}  # fmt: skip
    assert commands.command(sent) == expected
    heard = ground.hear()
    texts = [m for m in heard if m.get_type() == "STATUSTEXT"]
    assert "".join(m.text for m in texts) == f"holdfast: {record.why}"
    assert [m.chunk_seq for m in texts] == list(range(len(texts)))
    assert {m.severity for m in texts} == {common.MAV_SEVERITY_WARNING}
    values = {m.name: m.value for m in heard if m.get_type() == "NAMED_VALUE_FLOAT"}
    assert values["hf_value"] == pytest.approx(record.value)
    assert values["hf_slack"] == 0.0


def test_everything_else_passes_unchanged_both_ways(link):
    component, ground, boat, _ = link()
    boat.states([-1.3, 0.2, 0, 0, 0, 0], 0.0)
    ground.send(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    component.turn(0.0)
    ground.hear(), boat.hear()
    ground.frames.clear(), boat.frames.clear()
    up = recorded("mavlink.txt", "rover")
    down = [recorded("mavlink.txt", "ground"), by_hand(b"abc", 60001, 17)]
    boat.port.send(up)
    for frame in down:
        ground.port.send(frame)
    component.turn(0.01)
    ground.hear(), boat.hear()
    assert ground.frames == [frame for _, frame in Codec().messages(up)]
    assert boat.frames == down
    assert component.counts.broken == 2


def test_commands_that_are_not_filtered_are_warned_of(link):
    component, ground, boat, _ = link()
    boat.states(START, 0.0)
    for _ in range(5):
        ground.send(common.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8))
    component.turn(0.0)
    assert component.counts.unfiltered == 5
    texts = [m.text for m in ground.hear() if m.get_type() == "STATUSTEXT"]
    assert [t for t in texts if "unfiltered" in t] == [
        "holdfast: RC_CHANNELS_OVERRIDE passes unfiltered"
    ]
    assert sum(m.get_type() == "RC_CHANNELS_OVERRIDE" for m in boat.hear()) == 5


def test_nothing_is_sent_before_the_first_command_and_long_after_the_last(link):
    """Then it is the vehicle's own failsafe that has to act."""
    component, ground, boat, commands = link(hold=2.0)
    times = {}
    for k in range(300):
        now = k * 0.02
        boat.states([-1.3, 0.2, 0, 0, 0, 0], now)
        if 1.0 <= now <= 2.0:
            ground.send(commands.of({"tau_u": 0.2, "tau_r": 0.0}, 1))
        record = component.turn(now)
        times[now] = [m for m in boat.hear() if m.get_type() == "MANUAL_CONTROL"], record
    sent = [now for now, (messages, _) in times.items() if messages]
    assert (sent[0], sent[-1]) == (1.0, 4.0)
    assert len(sent) == 151
    assert {len(m) for m, _ in times.values()} == {0, 1}
    lost = [now for now, (_, r) in times.items() if r.lost == "command" and now > 2]
    assert lost[0] == pytest.approx(2.26)  # the patience is 0.25 s
    assert all(m[0].x == 0 for now, (m, _) in times.items() if 2.3 < now <= 4.0)
    beats = [m for m in boat.heard if m.get_type() == "HEARTBEAT"]
    assert len(beats) == 6
    assert {(m.get_srcSystem(), m.get_srcComponent(), m.type) for m in beats} == {
        (1, 191, common.MAV_TYPE_ONBOARD_CONTROLLER)
    }


def test_command_is_decided_on_at_once_unless_the_filter_remembers(link, keep):
    """Not oftener than every half sample; one with rates of inputs keeps its samples."""
    component, ground, _, commands = link()
    slow = hf.SafetyFilter(
        keep.system, keep.keep, gains=(1.5, 8), rates={"tau_u": 4.0, "tau_r": 4.0}
    )
    names = {"controller": "udpin:127.0.0.1:0", "vehicle": "udpin:127.0.0.1:0"}
    with SafetyComponent(slow, commands, **names) as remembers:
        other = Ground(remembers.controller.port)
        decided = {component: [], remembers: []}
        for k in range(40):
            now = 1 + k * 0.001
            if k in (3, 12, 15):
                for end in (ground, other):
                    end.send(commands.of({"tau_u": 0.1, "tau_r": 0.0}, 1))
            for one, times in decided.items():
                if one.turn(now):
                    times.append(k)
        other.port.close()
    assert decided == {component: [0, 10, 20], remembers: [0, 20]}


def test_states_that_cease_give_the_fallback_though_the_other_half_goes_on(link):
    component, ground, boat, commands = link()
    boat.states(START, 0.0)
    lost = []
    for k in range(40):
        now = k * 0.02
        boat.send(
            common.MAVLink_attitude_message(round(1000 * now) + 1, 0, 0, 0.35, 0, 0, 0),
            sender=(1, 1),
        )
        ground.send(commands.of({"tau_u": 1.0, "tau_r": 0.0}, 1))
        record = component.turn(now)
        if record.lost == "measurement":
            lost.append(now)
            assert record.input == {"tau_u": 0.0, "tau_r": 0.0}
    assert lost[0] == pytest.approx(0.26)
    assert any("no measurement" in m.text for m in ground.hear() if m.get_type() == "STATUSTEXT")


def test_commands_that_cease_leave_nothing_of_the_last_one(link):
    """Full down and two buttons, then silence: they are not repeated while the fallback is sent."""
    component, ground, boat, _ = link()
    given = common.MAVLink_manual_control_message(1, 40, 7, -1000, -3, 3)
    ground.send(given, sender=(255, 190))
    for k in range(30):
        boat.states([-1.3, 0.2, 0, 0, 0, 0], 1.0 + k * 0.02)
        component.turn(k * 0.02)
    sent = [m for m in boat.hear() if m.get_type() == "MANUAL_CONTROL"]
    assert (sent[0].z, sent[0].buttons) == (-1000, 3)
    assert [getattr(sent[-1], n) for n in ("x", "y", "z", "r", "buttons")] == [0] * 5


def test_other_systems_are_neither_measured_nor_commanded(link):
    component, ground, boat, commands = link()
    boat.states(START, 0.0, system=2)
    ground.send(commands.of({"tau_u": 1.0, "tau_r": 0.0}, 2))
    record = component.turn(0.0)
    assert record.lost == "measurement"
    assert component.counts.other_system == 2
    (passed,) = [m for m in boat.hear() if m.get_type() == "MANUAL_CONTROL"]
    assert passed.target == 2


@pytest.mark.parametrize("v1", [False, True])
def test_command_is_sent_on_in_its_own_version(link, v1):
    component, ground, boat, commands = link()
    boat.states(START, 0.0)
    ground.send(commands.of(pd(START), 1), v1=v1)
    component.turn(0.0)
    boat.hear()
    (frame,) = [f for m, f in zip(boat.heard, boat.frames, strict=True) if m.get_msgId() == 69]
    assert frame[0] == (0xFE if v1 else 0xFD)


def test_signed_connection_is_verified_and_signed_again(link):
    component, ground, boat, commands = link(key=KEY)
    boat.states(START, 0.0)
    ground.send(commands.of(pd(START), 1))
    record = component.turn(0.0)
    assert record.overruled
    (sent,) = [
        f for d in boat.port.receive(0.0) for m, f in boat.codec.messages(d) if m.get_msgId() == 69
    ]
    assert sent[2] == 1
    assert hashlib.sha256(KEY + sent[:-6]).digest()[:6] == sent[-6:]
    stranger = Codec(bytes(32)).frame(commands.of({"tau_u": 1, "tau_r": 0}, 1), *GROUND)
    unsigned = Codec().frame(commands.of({"tau_u": 1, "tau_r": 0}, 1), *GROUND)
    ground.port.send(stranger)
    ground.port.send(unsigned)
    replayed = ground.codec.frame(commands.of({"tau_u": 1, "tau_r": 0}, 1), *GROUND)
    ground.port.send(replayed)
    ground.port.send(replayed)
    later = bytearray(replayed)
    later[-12:-6] = b"\xff" * 6  # a forged time must not silence the true sender
    ground.port.send(later)
    ground.send(commands.of({"tau_u": 1, "tau_r": 0}, 1))
    component.turn(0.02)
    assert component.counts.unsigned == 4
    assert component.counts.commands == 3
    with pytest.raises(SimulationError, match="the key has 3 bytes"):
        Codec(b"abc")


def test_signature_of_another_implementation_is_valid_once():
    frame, key = recorded("mavlink.txt", "signed"), recorded("mavlink.txt", "key")
    codec = Codec(key)
    ((beat, _),) = codec.messages(frame)
    assert (beat.get_type(), beat.get_srcSystem(), codec.unsigned) == ("HEARTBEAT", 1, 0)
    assert not list(codec.messages(frame))
    assert not list(Codec(KEY).messages(frame))
    assert codec.unsigned == 1


def test_signed_command_without_a_key_is_refused_and_not_sent_on(link):
    """Changed it would lose its signature; unchanged it would not be filtered."""
    component, ground, boat, commands = link(key_of_ends=KEY)
    boat.states(START, 0.0)
    ground.send(commands.of(pd(START), 1))
    component.turn(0.0)
    assert component.counts.refused == 1
    assert component.counts.sent == 0


def test_vehicle_that_starts_again_is_measured_anew(link):
    component, ground, boat, commands = link()
    boat.states(START, 100.0)
    component.turn(0.0)
    boat.states([-1.0, 0.1, 0, 0, 0, 0], 0.2)
    ground.send(commands.of({"tau_u": 0.1, "tau_r": 0.0}, 1))
    record = component.turn(0.02)
    assert component.counts.restarts == 1
    assert record.state["x"] == -1.0


def test_command_stays_live_where_the_vehicle_starts_again(link):
    component, ground, boat, commands = link()
    boat.states(START, 100.0)
    ground.send(commands.of({"tau_u": 0.1, "tau_r": 0.0}, 1))
    assert component.turn(0.0).lost == ""
    boat.states(START, 0.2)
    assert component.turn(0.02).lost == ""
    assert component.counts.restarts == 1
    boat.states(START, 0.5)
    assert component.turn(0.3).lost == "command"  # as old as it is


@pytest.mark.parametrize("seed", range(4))
def test_position_and_attitude_that_come_apart_lose_no_command(link, seed):
    """Each 20 times a second, up to 45 ms old when it comes, in any order among themselves."""
    component, ground, boat, commands = link()
    generator, lost, waiting = np.random.default_rng(seed), [], []
    x, y, psi, *_ = START
    for k in range(600):
        now = 100.0 + 0.01 * k
        if k % 5 == 0:
            boot = round(1000 * now)
            attitude = common.MAVLink_attitude_message(boot, 0, 0, -psi, 0, 0, 0)
            place = common.MAVLink_local_position_ned_message(boot, x, -y, 0, 0, 0, 0)
            for message in (attitude, place):
                waiting.append((now + generator.uniform(0.0, 0.045), message))
            ground.send(commands.of({"tau_u": 0.1, "tau_r": 0.0}, 1))
        for one in [one for one in waiting if one[0] <= now]:
            waiting.remove(one)
            boat.send(one[1], sender=(1, 1))
        record = component.turn(now)
        if record is not None and k >= 10:
            lost.append(record.lost)
    assert len(lost) > 290
    assert set(lost) == {""}


def test_setpoints_of_velocity_are_filtered_for_a_robot(link):
    robot = hf.systems.unicycle()
    wall = hf.Region("wall", robot.states, (hf.Inequality("wall", hf.symbol("x") - 1, "m"),))
    keep, commands = hf.SafetyFilter(robot, wall), BodyVelocity(robot)
    names = {"controller": "udpin:127.0.0.1:0", "vehicle": "udpin:127.0.0.1:0"}
    with SafetyComponent(keep, commands, **names) as component:
        ground, boat = Ground(component.controller.port), Boat(component.vehicle.port)
        boat.states([0.9, 0, 0, 0, 0, 0], 0.0)
        ground.send(commands.of({"v": 0.8, "r": 0.1}, 1))
        component.turn(0.0)
        (sent,) = [m for m in boat.hear() if m.get_msgId() == 84]
        assert sent.vx == pytest.approx(0.1)
        position = commands.of({"v": 0.8, "r": 0.1}, 1)
        position.type_mask = 3576
        ground.send(position)
        component.turn(0.02)
        assert component.counts.refused == 1
        assert any("sets something else" in m.text
                   for m in ground.hear() if m.get_type() == "STATUSTEXT")  # fmt: skip
        ground.port.close()
        boat.port.close()


def test_datagrams_of_a_third_address_are_not_heard_until_the_first_is_silent(link):
    component, _, boat, _ = link()
    boat.states(START, 0.0)
    component.turn(0.0)
    other = Boat(component.vehicle.port)
    other.states([0, 0, 0, 0, 0, 0], 0.1)
    component.turn(0.1)
    assert component.counts.strangers == 2
    other.states([-1.0, 0, 0, 0, 0, 0], 5.0)
    assert component.turn(5.0).state["x"] == -1.0
    other.port.close()


def test_settings_that_do_not_fit_are_refused(keep):
    commands = ManualControl(keep.system)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        used = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SimulationError, match="end the program that uses the port"):
            SafetyComponent(keep, commands, controller="udpin:127.0.0.1:0", vehicle=used)
    for text in ("tcp:127.0.0.1:5760", "udpin:127.0.0.1", "udpin:127.0.0.1:70000", ""):
        with pytest.raises(SimulationError, match="is no connection"):
            Port(text)
    measuring = hf.SafetyFilter(keep.system, keep.keep, gains=(1.5, 8), disturbance_measured=True)
    with pytest.raises(SimulationError, match="the filter measures Vx, Vy"):
        SafetyComponent(measuring, commands)
    for settings in ({"hold": 0.1}, {"system": 0}, {"component": 300}, {"hold": math.inf}):
        with pytest.raises(SimulationError, match="expected"):
            SafetyComponent(keep, commands, **settings)
    with pytest.raises(DefinitionError, match="has no state 'north'"):
        SafetyComponent(keep, commands, pose=("north", "y", "psi"))


def test_missing_package_is_named_with_its_remedy():
    code = (
        "import sys\nsys.modules['pymavlink'] = None\n"
        "from holdfast.errors import HoldfastError\n"
        "try:\n    import holdfast.interop.mavlink\n"
        "except HoldfastError as error:\n    print(error)\n"
        "import holdfast.interop.ardupilot"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (found.returncode, found.stderr) == (0, "")
    assert found.stdout.strip().endswith('pip install "holdfast[interop]"')


# -- the loop that own_controller.md closes


def starts(count):
    """Starts in the view, of those of the page."""
    view = hf.Boundary(hf.systems.marine_vehicle(), hf.regions.camera_view())
    generator = np.random.default_rng(3)
    while count:
        x, y, psi = generator.uniform([-2, -0.8, -0.8], [-0.6, 0.8, 0.8])
        if view.worst([[x, y, psi, 0, 0, 0]])[0] <= 0:
            count -= 1
            yield [x, y, psi, 0, 0, 0]


def closed_loop(start, commands, keep=None, seconds=8.0):
    """The PD over MAVLink, through the component or straight to the vehicle: all states."""
    system, told = hf.systems.marine_vehicle(), []
    if keep is None:
        ends = [Port("udpin:127.0.0.1:0")]
    else:
        names = {"controller": "udpin:127.0.0.1:0", "vehicle": "udpin:127.0.0.1:0"}
        component = SafetyComponent(keep, commands, **names)
        ends = [Port(f"udpout:127.0.0.1:{component.controller.port}"), component]
    port = ends[0].port if keep is None else component.vehicle.port
    vehicle = SimulatedVehicle(
        system, start, commands, connection=f"udpout:127.0.0.1:{port}",
        on_states=lambda t, q: told.append(q),
    )  # fmt: skip
    codec, measured = Codec(), Measurements(PlanarMotion(system))
    ends[0].send(codec.frame(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), *GROUND))
    for k in range(round(seconds / 0.02) + 1):
        now = k * 0.02
        vehicle.turn(now)
        if keep is not None:
            component.turn(now)
        for datagram in ends[0].receive(now):
            for message, _ in codec.messages(datagram):
                found = measured.take(message, now)
                if found is not None and message.get_type() == "ATTITUDE":
                    asked = commands.of(pd(found[0].values()), 1)
                    ends[0].send(codec.frame(asked, *GROUND))
    for end in (vehicle, *ends):
        end.close()
    return np.array(told)


@pytest.mark.heavy
def test_pd_controller_over_mavlink_loses_the_target_and_with_the_filter_from_no_start(keep):
    """12 of the starts of the page; the filter's command is late by a sample and has 1/1000."""
    view = hf.Boundary(keep.system, hf.regions.camera_view())
    commands, lost = ManualControl(keep.system), {True: 0, False: 0}
    for start in starts(12):
        for filtered in lost:
            keep.reset()
            states = closed_loop(start, commands, keep if filtered else None)
            lost[filtered] += bool(view.worst(states).max() > 1e-3)
    assert lost == {True: 0, False: 4}


# -- two processes

COMPONENT = """
import holdfast as hf
from holdfast.interop.mavlink import ManualControl, SafetyComponent, serve
vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
keep = hf.SafetyFilter(vehicle, view, gains=(1.5, 8))
component = SafetyComponent(keep, ManualControl(vehicle), controller="udpin:127.0.0.1:CONTROLLER",
                            vehicle="udpin:127.0.0.1:VEHICLE")
print(component.controller.port, component.vehicle.port, flush=True)
print(serve(component))
"""


def begun(controller=0, vehicle=0):
    text = COMPONENT.replace("CONTROLLER", str(controller)).replace("VEHICLE", str(vehicle))
    process = subprocess.Popen(
        [sys.executable, "-c", text], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    return process, [int(n) for n in process.stdout.readline().split()]


def until(done, *ends, patience=60.0):
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if done():
            return
        for one in ends:
            one()
        time.sleep(0.005)
    raise AssertionError("it does not happen")


@pytest.mark.heavy
def test_component_that_was_killed_and_started_again_filters_again(keep):
    """A process of its own; the vehicle and the controller go on, and know nothing of it."""
    commands = ManualControl(keep.system)
    process, (controller, at) = begun()
    ground = Ground(controller)
    vehicle = SimulatedVehicle(
        keep.system, START, commands, connection=f"udpout:127.0.0.1:{at}", rate=50
    )
    heard = []

    def drive():
        vehicle.turn(time.monotonic())
        ground.send(commands.of({"tau_u": 3.0, "tau_r": 0.0}, 1))
        heard.extend(ground.hear())

    try:
        until(lambda: any("changed" in getattr(m, "text", "") for m in heard), drive)
        process.kill()
        process.communicate()
        process, ports = begun(controller, at)
        assert ports == [controller, at]
        heard.clear()
        until(lambda: any("holdfast" in getattr(m, "text", "") for m in heard), drive)
        until(lambda: any(m.get_type() == "ATTITUDE" for m in heard), drive)
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=60)
        assert (process.returncode, errors) == (0, "")
        assert "commands" in output
        assert "sent" in output
    finally:
        process.kill()
        process.communicate()
        ground.port.close()
        vehicle.close()


def test_served_component_ends_in_time_and_closes_its_ports(keep):
    names = {"controller": "udpin:127.0.0.1:0", "vehicle": "udpin:127.0.0.1:0"}
    component, records = SafetyComponent(keep, ManualControl(keep.system), **names), []
    port = component.vehicle.port
    serve(component, on_decision=records.append, seconds=0.2)
    assert 1 <= len(records) <= 12
    assert all(hf.DecisionRecord.read(r.line()) for r in records)
    Port(f"udpin:127.0.0.1:{port}").close()


def test_vehicle_publishes_at_its_rates_and_stops_without_commands(keep):
    commands = ManualControl(keep.system)
    port = Port("udpin:127.0.0.1:0")
    with SimulatedVehicle(
        keep.system, START, commands, connection=f"udpout:127.0.0.1:{port.port}", rate=10
    ) as vehicle:
        codec, heard = Codec(), []
        for k in range(301):
            now = 5.0 + k * 0.01
            vehicle.turn(now)
            heard += [m for d in port.receive(now) for m, _ in codec.messages(d)]
            if now < 6.0:
                port.send(codec.frame(commands.of({"tau_u": 2.0, "tau_r": 0.0}, 1), *GROUND))
                other = commands.of({"tau_u": -9.0, "tau_r": 0.0}, 7)
                port.send(codec.frame(other, *GROUND))
        kinds = [m.get_type() for m in heard]
        assert (kinds.count("LOCAL_POSITION_NED"), kinds.count("ATTITUDE")) == (31, 31)
        assert kinds.count("HEARTBEAT") == 4
        assert vehicle.plant.t == pytest.approx(3.0)
        assert list(vehicle._input) == pytest.approx([2.0, 0.0], abs=0.02)
        speed = [math.hypot(m.vx, m.vy) for m in heard if m.get_type() == "LOCAL_POSITION_NED"]
        assert np.argmax(speed) in (20, 21)  # a second after the last command
    port.close()
