"""How fast the connections to autopilots are, on loopback UDP, each end in a process of its own.

`python benchmarks/links.py` prints the frames that the physics of ArduPilot's JSON interface
answers in a second, and the delay that the MAVLink component adds to messages that pass and to
commands at 50 Hz, which it decides on.
"""

from __future__ import annotations

import multiprocessing
import socket
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection

from pymavlink.dialects.v20 import ardupilotmega as dialect

import holdfast as hf
from holdfast.interop.ardupilot import Autopilot, Physics
from holdfast.interop.ardupilot import serve as serve_physics
from holdfast.interop.mavlink import Codec, ManualControl, SafetyComponent
from holdfast.interop.mavlink import serve as serve_component
from holdfast.interop.udp import Port

START = [-1.3, 0.2, 0.0, 0.0, 0.0, 0.0]
FRAMES, MESSAGES = 20_000, 1_000


def physics(told: Connection) -> None:
    serve_physics(Physics(hf.systems.marine_vehicle(), START), port=0, ready=told.send)


def component(told: Connection) -> None:
    vehicle = hf.systems.marine_vehicle()
    keep = hf.SafetyFilter(vehicle, hf.regions.camera_view(), gains=(1.5, 8))
    made = SafetyComponent(
        keep,
        ManualControl(vehicle),
        controller="udpin:127.0.0.1:0",
        vehicle="udpin:127.0.0.1:0",
    )
    told.send((made.controller.port, made.vehicle.port))
    serve_component(made)


def echo(told: Connection) -> None:
    """Answers every datagram with a line as long as an answer of the physics."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        told.send(wire.getsockname()[1])
        while True:
            _, sender = wire.recvfrom(4096)
            wire.sendto(b"x" * 320, sender)


@contextmanager
def begun(target, *arguments) -> Iterator[object]:
    """A process, ended at the end, and what it tells first."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=target, args=(there, *arguments))
    process.start()
    try:
        yield here.recv()
    finally:
        process.terminate()
        process.join()


def frames_per_second(rate: int) -> float:
    with begun(physics) as port, Autopilot(port=int(port), rate=rate) as autopilot:
        for _ in range(200):
            autopilot.frame([1600, 1500, 1550])
        began = time.perf_counter()
        for _ in range(FRAMES):
            autopilot.frame([1600, 1500, 1550])
        return FRAMES / (time.perf_counter() - began)


def bare_exchanges() -> float:
    with begun(echo) as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", int(port)))
        began = time.perf_counter()
        for _ in range(FRAMES):
            wire.send(b"x" * 40)
            wire.recv(4096)
        return FRAMES / (time.perf_counter() - began)


def delays() -> tuple[list[float], list[float]]:
    """Of messages that pass and of commands, in milliseconds, from send to receipt."""
    vehicle = hf.systems.marine_vehicle()
    commands, codec = ManualControl(vehicle), Codec()
    passed, filtered = [], []
    with begun(component) as ports:
        ground, boat = (Port(f"udpout:127.0.0.1:{p}") for p in ports)
        for port in (ground, boat):
            port.send(codec.frame(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190))
        time.sleep(0.3)
        first = time.perf_counter()
        for number in range(MESSAGES):
            boot = number * 20
            while time.perf_counter() < first + number * 0.02:
                pass
            for message in (
                dialect.MAVLink_local_position_ned_message(boot, -1.3, -0.2, 0, 0, 0, 0),
                dialect.MAVLink_attitude_message(boot, 0, 0, 0, 0, 0, 0),
            ):
                boat.send(codec.frame(message, 1, 1))
            # two commands in turn, told apart by their buttons
            asked = commands.of({"tau_u": 0.2, "tau_r": 0.0}, 1)
            asked.buttons = number % 2 + 1
            until(ground, lambda m, at=boot: m.get_type() == "ATTITUDE" and m.time_boot_ms == at)
            began = time.perf_counter()
            ground.send(codec.frame(asked, 255, 190))
            now = lambda m, b=asked.buttons: m.get_type() == "MANUAL_CONTROL" and m.buttons == b  # noqa: E731
            until(boat, now)
            filtered.append(1e3 * (time.perf_counter() - began))
            ping = dialect.MAVLink_ping_message(number, number, 1, 1)
            began = time.perf_counter()
            ground.send(codec.frame(ping, 255, 190))
            until(boat, lambda m, n=number: m.get_type() == "PING" and m.seq == n)
            passed.append(1e3 * (time.perf_counter() - began))
        ground.close()
        boat.close()
    return passed, filtered


def until(port: Port, wanted, codec: Codec | None = None) -> None:
    """Receive until a message is there."""
    codec = codec or READERS.setdefault(port, Codec())
    end = time.monotonic() + 5
    port.socket.setblocking(False)
    while time.monotonic() < end:
        for datagram in port.receive(0.0):
            if any(wanted(message) for message, _ in codec.messages(datagram)):
                return
    raise RuntimeError("nothing came")


READERS: dict[Port, Codec] = {}


def main() -> None:
    print("| connection | number |")
    print("|---|---|")
    print(f"| frames of the physics, 50 Hz steps | {frames_per_second(50):,.0f} a second |")
    print(f"| frames of the physics, 400 Hz steps | {frames_per_second(400):,.0f} a second |")
    print(f"| the same datagrams, with nothing computed | {bare_exchanges():,.0f} a second |")
    passed, filtered = delays()
    for name, row in (("a message that passes", passed), ("a command, filtered", filtered)):
        row.sort()
        most = row[int(0.99 * len(row))]
        print(f"| delay of {name}, median | {statistics.median(row):.2f} ms |")
        print(f"| delay of {name}, 99 of 100 | {most:.2f} ms |")


if __name__ == "__main__":
    main()
