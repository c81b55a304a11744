"""ArduPilot's JSON physics interface: recorded packets, signs, lockstep, two processes."""

import math
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from holdfast.interop.ardupilot import (
    Autopilot,
    Physics,
    Servo,
    ServoOutputs,
    ServoPacket,
    motion_line,
    read_motion,
    serve,
)
from holdfast.interop.planar_motion import GRAVITY, Motion, PlanarMotion
from tests.interop.lossy import Lossy
from tests.interop.recorded import recorded

START = [-1.3, 0.75, -0.35, 0, 0, 0]
PHYSICS = """
import holdfast as hf
from holdfast.interop.ardupilot import Physics, serve
physics = Physics(hf.systems.marine_vehicle(), [-1.3, 0.75, -0.35, 0, 0, 0])
print(serve(physics, port=PORT, ready=lambda port: print(port, flush=True)))
"""


def pd(states):
    x, y, psi, u, _, r = states
    return np.array([4 * (-0.5 - x) - 6 * u, -0.6 * psi - 1.2 * y - 0.4 * r])


def packet(count, *pwm, rate=50):
    return ServoPacket(rate, count, (*pwm, *[1500] * (16 - len(pwm)))).pack()


@pytest.fixture
def started():
    """Starts the physics in a process of its own: the process and its port."""
    begun = []

    def start(port=0):
        process = subprocess.Popen(
            [sys.executable, "-c", PHYSICS.replace("PORT", str(port))],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        begun.append(process)
        return process, int(process.stdout.readline())

    yield start
    for process in begun:
        process.kill()
        process.communicate()


# -- the layout of both directions


def test_recorded_servo_packet_of_ardupilot_is_read_and_made_again():
    data = recorded("ardupilot_json.txt", "servos")
    found = ServoPacket.read(data)
    assert (found.frame_rate, found.frame_count) == (1200, 50474)
    assert found.pwm == (1561, 1560, 1560, 1562, 0, 0, 0, 0, 1100, 1100, 1800, *[0] * 5)
    assert found.pack() == data
    physics = Physics(hf.systems.marine_vehicle())
    assert read_motion(physics.answer(data)).t == 1 / 1200
    assert physics.outputs.servos["port"].value(1561) > physics.outputs.servos["port"].value(1560)


def test_recorded_answer_of_gazebo_to_ardupilot_is_read():
    """A copter that hovers at 2.2 m: gravity is negative along its z axis, as in our answers."""
    found = read_motion(recorded("ardupilot_json.txt", "answer"))
    assert found.t == 55.896
    assert found.position == (0.002134498059463723, -0.00029686061309706766, -2.1994146968889609)
    assert found.gyro[2] == -0.00002985104549187322
    assert found.accel[2] == pytest.approx(-GRAVITY, abs=2e-3)
    assert found.attitude[2] == pytest.approx(2 * math.asin(0.007663052097629297), abs=1e-6)
    assert found.others == {"no_time_sync": True, "no_lockstep": False}
    states = PlanarMotion(hf.systems.unicycle()).states(found)
    assert states["psi"] == -found.attitude[2]
    ours = read_motion(Physics(hf.systems.marine_vehicle()).answer(packet(0, 1500, 0, 1500)))
    assert ours.accel == (0.0, 0.0, -GRAVITY)


def test_servo_packet_with_32_channels_has_its_own_number():
    data = struct.pack("<HHI32H", 29569, 400, 7, *range(1000, 1032))
    found = ServoPacket.read(data)
    assert len(found.pwm) == 32
    assert (found.frame_rate, found.frame_count, found.pwm[31]) == (400, 7, 1031)
    assert found.pack() == data


@pytest.mark.parametrize(
    "data",
    [
        b"", b"test", packet(0)[:-1], packet(0) + b"\0", b"\0" * 40,
        struct.pack("<HHI32H", 18458, 50, 0, *[1500] * 32),
    ],
)  # fmt: skip
def test_datagram_that_is_no_servo_packet_is_counted_and_not_answered(data):
    physics = Physics(hf.systems.marine_vehicle())
    assert physics.answer(data) is None
    assert (physics.counts.refused, physics.counts.steps) == (1, 0)
    with pytest.raises(SimulationError, match="no servo packet"):
        ServoPacket.read(data)


def scanned(text, key):
    """The numbers behind a key, as ArduPilot's reader looks for them: strstr, then sscanf."""
    behind = text[text.index(key) + len(key) + 2 :]
    number = r"\s*([-+]?\d[\d.e+-]*)"
    found = re.match(rf"\[{number},{number},{number}\]", behind)
    return [float(n) for n in found.groups()] if found else float(re.match(number, behind)[1])


def test_answer_has_the_form_that_the_reader_of_ardupilot_takes():
    physics = Physics(hf.systems.marine_vehicle(), START, also=lambda t, q: {"rng_1": -q[0]})
    data = physics.answer(packet(0, 1800, 1500, 1600))
    assert data[:1] == data[-1:] == b"\n"
    assert data.count(b"\n") == 2
    text, motion = data.decode(), read_motion(data)
    assert scanned(text, "timestamp") == motion.t == 0.02
    for key, value in {
        "gyro": motion.gyro, "accel_body": motion.accel, "position": motion.position,
        "attitude": motion.attitude, "velocity": motion.velocity,
    }.items():  # fmt: skip
        assert scanned(text, key) == list(value)
    assert motion.others == {"rng_1": -physics.state[0]}


def test_numbers_of_an_answer_return_to_the_bit():
    generator = np.random.default_rng(0)
    for _ in range(200):
        rows = generator.normal(size=(5, 3)) * 10.0 ** generator.integers(-12, 9, size=(5, 3))
        motion = Motion(float(generator.uniform(0, 1e6)), *(tuple(r.tolist()) for r in rows))
        assert read_motion(motion_line(motion)) == motion


@pytest.mark.parametrize(
    "data",
    [b"", b"\n\n", b"{", b"[]", b"null", b"\xff", b"[" * 9000, b'{"timestamp":0}']
    + [motion_line(Motion(0, *[(0, 0, 0)] * 5)).replace(b"[0,0,0]", b, 1)
       for b in (b"[0,0]", b"[0,0,NaN]", b'["0",0,0]', b"0", b"[true,0,0]", b"[1" + b"0" * 400 + b",0,0]")],
)  # fmt: skip
def test_answer_that_is_none_is_refused(data):
    with pytest.raises(SimulationError, match="no answer of a physics backend"):
        read_motion(data)
    with pytest.raises(SimulationError, match="cannot be written"):
        motion_line(Motion(math.nan, *[(0.0, 0.0, 0.0)] * 5))


# -- axes and signs


def test_port_thrust_turns_to_starboard_and_the_instruments_show_it():
    """With psi = 0 and x to the north: ahead is north, starboard east, clockwise is positive."""
    physics = Physics(hf.systems.marine_vehicle())
    for count in range(40):
        motion = read_motion(physics.answer(packet(count, 1900, 1500, 1800)))
    assert motion.velocity[0] > 0.1
    assert motion.attitude[2] > 0.1
    assert motion.gyro[2] > 0.1
    assert motion.position[1] > 0
    _, y, psi, _, _, r = physics.state
    assert (y, psi, r) == (-motion.position[1], -motion.attitude[2], -motion.gyro[2])


@pytest.mark.parametrize("bearing", [0.0, 0.7, math.pi / 2])
def test_gyroscope_and_accelerometer_are_the_differences_of_what_is_told(bearing):
    """In a current, ahead and in a turn; central differences at 1 kHz."""
    physics = Physics(
        hf.systems.marine_vehicle(), START, disturbance={"Vx": 0.1, "Vy": -0.05}, bearing=bearing
    )
    told = [read_motion(physics.answer(packet(k, 1900, 1500, 1650, rate=1000))) for k in range(400)]
    for before, at, after in zip(told[250:], told[251:], told[252:], strict=False):
        step = after.t - before.t
        cos, sin = math.cos(at.attitude[2]), math.sin(at.attitude[2])
        north, east = ((after.velocity[i] - before.velocity[i]) / step for i in (0, 1))
        assert at.accel[0] == pytest.approx(north * cos + east * sin, abs=1e-5)
        assert at.accel[1] == pytest.approx(east * cos - north * sin, abs=1e-5)
        assert at.gyro[2] == pytest.approx(
            (after.attitude[2] - before.attitude[2]) / step, abs=1e-5
        )
        for i in (0, 1):
            moved = (after.position[i] - before.position[i]) / step
            assert at.velocity[i] == pytest.approx(moved, abs=1e-6)
    assert abs(told[-1].accel[1]) > 0.05
    states = physics.planar.states(told[-1])
    for name, value in zip(("x", "y", "psi"), physics.state, strict=False):
        assert states[name] == pytest.approx(value, abs=1e-12)


def test_accelerometer_of_a_robot_without_inertia_integrates_to_its_velocity():
    """Its velocity jumps with its input, and the mean over the step holds the jump."""
    robot = hf.systems.unicycle()
    servos = {"v": 3, "r": Servo(1, at=(2.0, 0.0, -2.0))}
    physics = Physics(robot, servos=servos)
    generator, velocity = np.random.default_rng(1), np.zeros(2)
    first = read_motion(physics.answer(packet(0, rate=1000)))
    assert first.velocity[:2] == (0, 0)
    for count in range(1, 500):
        pulses = generator.integers(1000, 2000, size=3).tolist() if count < 499 else [1500, 0, 1990]
        motion = read_motion(physics.answer(packet(count, *pulses, rate=1000)))
        cos, sin = math.cos(motion.attitude[2]), math.sin(motion.attitude[2])
        forward, right, _ = motion.accel
        velocity += [
            1e-3 * (forward * cos - right * sin),
            1e-3 * (forward * sin + right * cos),
        ]
    assert velocity == pytest.approx(motion.velocity[:2], abs=0.05)
    assert np.hypot(*motion.velocity[:2]) == pytest.approx(0.98)


def test_states_are_those_of_the_system_in_still_water():
    vehicle = hf.systems.marine_vehicle()
    for bearing in (0.0, 1.1):
        physics = Physics(vehicle, START, bearing=bearing)
        for count in range(50):
            motion = read_motion(physics.answer(packet(count, 1700, 1500, 1900)))
        found = PlanarMotion(vehicle, bearing=bearing).states(motion)
        assert list(found.values()) == pytest.approx(physics.state, abs=1e-12)


# -- servos


def test_pulses_are_thrust_ahead_and_astern_over_the_limits():
    vehicle = hf.systems.marine_vehicle()
    limit = next(p.value for p in vehicle.parameters if p.name == "thrust_limit")
    arm = next(p.value for p in vehicle.parameters if p.name == "thruster_arm")
    outputs = ServoOutputs(vehicle)
    channels = {name: servo.channel for name, servo in outputs.servos.items()}
    assert channels == {"port": 1, "starboard": 3}
    for pulses, expected in {
        (2000, 0, 2000): (2 * limit, 0),
        (1000, 0, 1000): (-2 * limit, 0),
        (2000, 0, 1000): (0, -2 * arm * limit),
        (0, 0, 0): (0, 0),
        (2500, 0, 800): (0, -2 * arm * limit),
        (1750, 0, 1500): (limit / 2, -arm * limit / 2),
    }.items():
        assert outputs.inputs(pulses) == pytest.approx(expected)
    for us in range(1000, 2001):
        assert outputs.servos["port"].us(outputs.servos["port"].value(us)) == us
    assert outputs.pulses([limit, -limit / 2]) == [2000, 1500, 1250]


@pytest.mark.parametrize(
    ("servos", "said"),
    [
        ({"port": 1}, "'starboard' has no channel"),
        ({"port": 1, "starboard": 1}, "channel 1 drives two"),
        ({"port": 1, "starbord": 3}, "did you mean 'starboard'"),
        ({"port": 0, "starboard": 3}, "channel 0"),
        ({"port": 33, "starboard": 3}, "channel 33"),
        ({"port": Servo(1, (1500, 1500, 2000)), "starboard": 3}, "shortest < neutral"),
        ({"port": Servo(1, at=(-99.0, 0.0, 99.0)), "starboard": 3}, "values from"),
    ],
)
def test_servos_that_do_not_fit_are_refused(servos, said):
    with pytest.raises(SimulationError, match=said):
        Physics(hf.systems.marine_vehicle(), servos=servos)


def test_systems_that_do_not_fit_are_refused():
    with pytest.raises(SimulationError, match="known are port and starboard"):
        Physics(hf.systems.unicycle())
    with pytest.raises(DefinitionError, match="has no state 'x'"):
        Physics(hf.systems.nonholonomic_integrator(), pose=("x", "y", "z"))
    with pytest.raises(DefinitionError, match="neither of the pose"):
        PlanarMotion(hf.systems.marine_vehicle(), twist=("u", "v", "w"))
    with pytest.raises(DefinitionError, match="bearing"):
        PlanarMotion(hf.systems.marine_vehicle(), bearing=math.inf)


@pytest.mark.parametrize("bearing", [0.0, math.pi / 2, -3.0])
def test_heading_of_an_autopilot_that_wraps_its_yaw_is_wrapped_too(bearing):
    planar = PlanarMotion(hf.systems.marine_vehicle(), bearing=bearing)
    for psi in np.linspace(-3.1, 3.1, 63):
        state = np.array([1.0, 2.0, psi, 0.3, -0.1, 0.2])
        motion = planar.motion(0.0, state, np.zeros(2), np.zeros(2))
        roll, pitch, yaw = motion.attitude
        sent = replace(motion, attitude=(roll, pitch, math.remainder(yaw, 2 * math.pi)))
        assert planar.states(sent)["psi"] == pytest.approx(psi, abs=1e-12)


# -- lockstep


def test_repeated_frame_is_answered_again_and_moves_nothing():
    physics = Physics(hf.systems.marine_vehicle(), START)
    one = physics.answer(packet(0, 1900, 0, 1900))
    two = physics.answer(packet(1, 1900, 0, 1900))
    assert physics.answer(packet(1, 1000, 0, 1000)) == two != one
    assert physics.answer(packet(0, 1900, 0, 1900)) is None
    assert (physics.counts.steps, physics.counts.repeated, physics.counts.late) == (2, 1, 1)


def test_autopilot_that_starts_again_within_its_first_frames_is_answered():
    """A late duplicate comes once or twice; one that waits for its answer sends again and again."""
    physics = Physics(hf.systems.marine_vehicle(), START)
    first = physics.answer(packet(0, 1900, 0, 1900))
    for count in range(1, 8):
        physics.answer(packet(count, 1900, 0, 1900))
    found = [physics.answer(packet(0, 1900, 0, 1900)) for _ in range(4)]
    assert found == [None, None, None, first]
    assert physics.counts.restarts == 1


def test_count_that_falls_is_a_new_start_of_the_autopilot():
    physics = Physics(hf.systems.marine_vehicle(), START)
    first = physics.answer(packet(0, 1900, 0, 1900))
    for count in range(1, 100):
        physics.answer(packet(count, 1900, 0, 1900))
    assert physics.answer(packet(0, 1900, 0, 1900)) == first
    assert physics.answer(packet(0, 1900, 0, 1900), ("127.0.0.1", 9)) == first
    assert (physics.counts.restarts, physics.counts.steps) == (2, 102)


def test_frames_that_are_missing_are_counted():
    physics = Physics(hf.systems.marine_vehicle(), START)
    physics.answer(packet(7))
    assert physics.counts.missed == 0
    assert read_motion(physics.answer(packet(10))).t == 0.04
    assert physics.counts.missed == 2


def test_frame_rate_is_the_step_and_may_change():
    physics = Physics(hf.systems.marine_vehicle(), START)
    boat = hf.Plant(hf.systems.marine_vehicle(), START, sample_time=1 / 400)
    for count in range(40):
        motion = read_motion(physics.answer(packet(count, 1800, 0, 1600, rate=400)))
        boat.step(physics.outputs.inputs([1800, 0, 1600]))
    assert (motion.t, physics.state.tolist()) == (0.1, boat.state.tolist())
    motion = read_motion(physics.answer(packet(40, 1800, 0, 1600, rate=50)))
    slow = hf.Plant(hf.systems.marine_vehicle(), boat.state, sample_time=1 / 50)
    assert motion.t == pytest.approx(0.12)
    assert physics.state.tolist() == slow.step(physics.outputs.inputs([1800, 0, 1600])).tolist()
    assert physics.answer(packet(41, rate=0)) is None


# -- two processes


def driven(port, frames, **settings):
    """The PD controller of the documentation over the interface: pulses and answers."""
    vehicle = hf.systems.marine_vehicle()
    outputs, planar, told = ServoOutputs(vehicle), PlanarMotion(vehicle), []
    arm = next(p.value for p in vehicle.parameters if p.name == "thruster_arm")
    with Autopilot(port=port, **settings) as autopilot:
        pulses = [1500, 1500, 1500]
        for _ in range(frames):
            motion = autopilot.frame(pulses)
            told.append((pulses, motion))
            push, turn = pd(planar.states(motion).values())
            pulses = outputs.pulses([push / 2 - turn / arm / 2, push / 2 + turn / arm / 2])
    return told, autopilot


def replayed(told, rate=50):
    """The positions and headings of `Plant` with the same pulses."""
    vehicle = hf.systems.marine_vehicle()
    boat, outputs = hf.Plant(vehicle, START, sample_time=1 / rate), ServoOutputs(vehicle)
    for pulses, motion in told:
        x, y, psi, *_ = boat.step(outputs.inputs(pulses)).tolist()
        yield motion, (boat.t, (x, -y, 0.0), (0.0, 0.0, -psi))


@pytest.mark.heavy
def test_trajectory_over_a_lossy_connection_is_that_of_the_plant_to_the_bit(started):
    """Another process; 5 % each of the datagrams lost, doubled and late, both ways."""
    process, port = started()
    with Lossy(port, 0.05, seed=1) as proxy:
        told, autopilot = driven(proxy.port, 500, resend=0.02)
    assert min(proxy.counts.values()) > 20
    assert autopilot.resent > 20
    assert autopilot.ignored > 20
    assert autopilot.restarts == 0
    for motion, (t, position, attitude) in replayed(told):
        assert (motion.t, motion.position, motion.attitude) == (t, position, attitude)
    direct, _ = driven(started()[1], 500)
    assert [m for _, m in direct] == [m for _, m in told]
    process.send_signal(signal.SIGTERM)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    assert output.startswith("500 steps, ")


@pytest.mark.heavy
def test_physics_that_was_killed_and_started_again_is_noticed_and_goes_on(started):
    process, port = started()
    with Autopilot(port=port, resend=0.05) as autopilot:
        for _ in range(100):
            before = autopilot.frame([1700, 1500, 1700])
        process.kill()
        process.wait()
        started(port)
        for _ in range(10):
            after = autopilot.frame([1700, 1500, 1700])
    assert (before.t, autopilot.restarts, autopilot.count) == (2.0, 1, 110)
    assert after.t == 0.2
    assert after.position[0] < before.position[0]


def test_autopilot_that_starts_again_begins_at_the_start(started):
    process, port = started()
    one, _ = driven(port, 30)
    two, _ = driven(port, 30)
    assert one == two
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    assert "60 steps" in output
    assert "1 restarts" in output


def test_numbers_that_are_none_are_refused():
    vehicle = hf.systems.marine_vehicle()
    with pytest.raises(SimulationError, match="the start is"):
        Physics(vehicle, [math.nan, 0, 0, 0, 0, 0])
    with pytest.raises(SimulationError, match="the disturbance is"):
        Physics(vehicle, disturbance={"Vx": math.inf})
    with pytest.raises(SimulationError, match="unknown disturbance 'Vz'"):
        Physics(vehicle, disturbance={"Vz": 0.1})
    with pytest.raises(SimulationError, match="also gives 3"):
        Physics(vehicle, also=lambda t, q: 3).answer(packet(0))
    with pytest.raises(SimulationError, match="'position' is a field of the motion"):
        Physics(vehicle, also=lambda t, q: {"position": 0}).answer(packet(0))
    for wrong in ([1.0], [math.nan, 0.0], {"port": 1.0}):
        with pytest.raises(SimulationError, match="actuators"):
            ServoOutputs(vehicle).pulses(wrong)
    with pytest.raises(SimulationError, match="port is 0"):
        Autopilot(port=0)


def test_physics_that_is_silent_is_named():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        port = deaf.getsockname()[1]
        with (
            Autopilot(port=port, resend=0.02, patience=0.1) as autopilot,
            pytest.raises(
                SimulationError, match=f"127.0.0.1:{port} is silent for 0.1 s at frame 0"
            ),
        ):
            autopilot.frame([1500])
    for settings in ({"rate": 0}, {"channels": 8}, {"resend": 0.0}, {"resend": 2, "patience": 1}):
        with pytest.raises(SimulationError, match="expected"):
            Autopilot(**settings)
    with Autopilot(port=port) as autopilot, pytest.raises(SimulationError, match="no servo packet"):
        autopilot.frame([70000])


def test_port_in_use_is_refused():
    physics = Physics(hf.systems.marine_vehicle())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(SimulationError, match="end the program that uses the port"):
            serve(physics, port=taken.getsockname()[1])
    with pytest.raises(SimulationError, match="cannot be bound"):
        serve(physics, port=70000)


def test_events_are_told_once_a_second():
    physics, news, ports = Physics(hf.systems.marine_vehicle(), START), [], []
    server = threading.Thread(
        target=serve,
        args=(physics,),
        kwargs={"port": 0, "ready": ports.append, "say": news.append, "frames": 3},
    )
    server.start()
    end = time.monotonic() + 10
    while not ports and time.monotonic() < end:
        time.sleep(0.001)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", ports[0]))
        wire.settimeout(10)
        for data in (packet(0), packet(1)):
            wire.send(data)
            wire.recv(4096)
        for _ in range(50):
            wire.send(b"nonsense")
        wire.send(packet(2))
        wire.recv(4096)
    server.join(60)
    assert not server.is_alive()
    assert "has started" in news[0]
    assert len(news) <= 2
    assert physics.counts.refused == 50
