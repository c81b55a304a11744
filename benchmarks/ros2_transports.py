"""Two ways to speak ROS 2 from wheels alone, side by side: Zenoh (rmw_zenoh) and CycloneDDS.

`python benchmarks/ros2_transports.py` runs those that are installed
(`python -m pip install "holdfast[interop]" cyclonedds`). A process sends nav_msgs/Odometry at 50 Hz
to another one, which sends it back, with the serialisation of both; then as many messages as it
can, in one go, with the default quality of service of ROS 2 (reliable, the last 10 kept). Then
the time of a step of a `FilterNode`.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

RATE, PINGS, BURST, PATIENCE = 50.0, 500, 5000, 8.0  # Hz, messages, messages, s
PACKAGES = {"zenoh": ("eclipse-zenoh", "rosbags", "xxhash"), "dds": ("cyclonedds", "rich-click")}
IMPORTS = {
    "zenoh": "import zenoh, rosbags.typesys as t; t.get_typestore(t.Stores.ROS2_JAZZY)",
    "dds": "import cyclonedds.domain, cyclonedds.pub, cyclonedds.sub, cyclonedds.idl",
}
ROUTER = "tcp/127.0.0.1:17451"
NO_MULTICAST = "<General><AllowMulticast>false</AllowMulticast></General>"
CASES: dict[str, dict[str, dict[str, str]]] = {
    "zenoh": {"with a router": {}, "without a router": {}},
    "dds": {
        "with multicast": {},
        "without multicast": {
            "CYCLONEDDS_URI": f"<CycloneDDS><Domain>{NO_MULTICAST}</Domain></CycloneDDS>"
        },
    },
}


class Transport(Protocol):
    """One end: what it sends is the x of an Odometry."""

    def send(self, x: float) -> None: ...

    def hear(self, said: Callable[[float], None]) -> None: ...

    def close(self) -> None: ...


class Zenoh:
    """As the nodes of holdfast send: CDR by rosbags, keys and attachments of rmw_zenoh."""

    def __init__(self, outward: str, inward: str) -> None:
        from holdfast.interop import ros_messages
        from holdfast.interop.ros2 import Network, Node
        from holdfast.interop.ros2.node import topic_key

        self.messages = ros_messages
        self.node = Node("bench", network=Network(7, (ROUTER,), ("tcp/127.0.0.1:0",)))
        self.publisher = self.node.publisher(outward, ros_messages.ODOMETRY)
        kind, digest = ros_messages.ODOMETRY, ros_messages.digest(ros_messages.ODOMETRY)
        self.key = topic_key(7, f"/{inward}", kind, digest)

    def send(self, x: float) -> None:
        self.publisher.send(
            self.messages.odometry((x, 0.0, 0.0), (0.0, 0.0, 0.0), 0, "map", "base_link")
        )

    def hear(self, said: Callable[[float], None]) -> None:
        def read(sample: Any) -> None:
            got = self.messages.decoded(sample.payload.to_bytes(), self.messages.ODOMETRY)
            said(got.pose.pose.position.x)

        self.heard = self.node._session.declare_subscriber(self.key, read)

    def close(self) -> None:
        self.node.close()


class Dds:
    """CycloneDDS with the names of ROS 2 on DDS."""

    def __init__(self, outward: str, inward: str) -> None:
        from cyclonedds.core import Listener, Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        self.types = dds_types()
        kind = self.types["Odometry"]
        second = duration(seconds=1)
        qos = Qos(Policy.Reliability.Reliable(second), Policy.History.KeepLast(10))
        self.participant = DomainParticipant(7)
        topic = Topic(self.participant, f"rt/{outward}", kind)
        self.writer = DataWriter(self.participant, topic, qos=qos)
        self.make = lambda listener: DataReader(
            self.participant, Topic(self.participant, f"rt/{inward}", kind), qos, listener
        )
        self.listener: Any = Listener

    def send(self, x: float) -> None:
        t = self.types
        none = [0.0] * 36
        zero = t["Vector3"](0.0, 0.0, 0.0)
        pose = t["Pose"](t["Point"](x, 0.0, 0.0), t["Quaternion"](0.0, 0.0, 0.0, 1.0))
        self.writer.write(
            t["Odometry"](
                t["Header"](t["Time"](0, 0), "map"),
                "base_link",
                t["PoseWithCovariance"](pose, none),
                t["TwistWithCovariance"](t["Twist"](zero, zero), none),
            )
        )

    def hear(self, said: Callable[[float], None]) -> None:
        from cyclonedds.internal import InvalidSample

        class Told(self.listener):  # type: ignore[misc, name-defined]
            def on_data_available(self, reader: Any) -> None:
                for got in reader.take(100):
                    if not isinstance(got, InvalidSample):  # its writer is gone
                        said(got.pose.pose.position.x)

        self.heard = self.make(Told())

    def close(self) -> None:
        del self.heard, self.writer, self.participant


def dds_types() -> dict[str, Any]:
    """The ten types that an Odometry consists of: CycloneDDS needs a class for each."""
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import array, float64, int32, uint32

    def struct(package: str, name: str, **fields: Any) -> Any:
        made = type(
            name,
            (IdlStruct,),
            {"__annotations__": fields, "__module__": __name__},
            typename=f"{package}::msg::dds_::{name}_",
        )
        return dataclass(made)

    found: dict[str, Any] = {}

    def add(package: str, name: str, **fields: Any) -> Any:
        found[name] = struct(package, name, **fields)
        return found[name]

    time_ = add("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
    header = add("std_msgs", "Header", stamp=time_, frame_id=str)
    point = add("geometry_msgs", "Point", x=float64, y=float64, z=float64)
    turned = add("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
    pose = add("geometry_msgs", "Pose", position=point, orientation=turned)
    many = array[float64, 36]
    placed = add("geometry_msgs", "PoseWithCovariance", pose=pose, covariance=many)
    vector = add("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
    twist = add("geometry_msgs", "Twist", linear=vector, angular=vector)
    moving = add("geometry_msgs", "TwistWithCovariance", twist=twist, covariance=many)
    add("nav_msgs", "Odometry", header=header, child_frame_id=str, pose=placed, twist=moving)
    return found


ENDS: dict[str, Callable[[str, str], Transport]] = {"zenoh": Zenoh, "dds": Dds}


def echo(name: str) -> None:
    """The other process: sends back what is above 0, and the count of what came for -1."""
    end = ENDS[name]("back", "forth")
    heard = 0

    def said(x: float) -> None:
        nonlocal heard
        if x > 0:
            end.send(x)
        elif x == -1.0:
            end.send(-1.0 - heard)
            heard = 0
        else:
            heard += 1

    end.hear(said)
    print("ready", flush=True)
    sys.stdin.read()
    end.close()
    os._exit(0)


def measured(name: str) -> str:
    """Round trips and the messages of a burst, between this process and another."""
    words = [sys.executable, __file__, "--echo", name]
    other = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert other.stdout is not None
    assert other.stdin is not None
    other.stdout.readline()
    came: dict[float, float] = {}
    counted, event = [0.0], threading.Event()

    def said(x: float) -> None:
        if x > 0:
            came[x] = time.perf_counter()
        else:
            counted[0] = -1.0 - x
        event.set()

    end = ENDS[name]("forth", "back")
    end.hear(said)
    began = time.monotonic()
    try:
        while not event.is_set():  # until they have found each other
            if time.monotonic() - began > PATIENCE:
                return f"the processes did not find each other in {PATIENCE:.0f} s"
            end.send(0.5)
            event.wait(0.02)
        met = time.monotonic() - began
        time.sleep(0.5)
        sent = {}
        for k in range(1, PINGS + 1):
            sent[float(k)] = time.perf_counter()
            end.send(float(k))
            time.sleep(1 / RATE)
        time.sleep(0.2)
        trips = [1e3 * (came[k] - sent[k]) for k in sent if k in came]
        began = time.perf_counter()
        for _ in range(BURST):
            end.send(-0.5)
        spent = time.perf_counter() - began
        time.sleep(1.0)
        event.clear()
        end.send(-1.0)
        event.wait(5.0)
        return (
            f"met after {met:.2f} s; round trip {np.median(trips):.2f} ms, 99 % below "
            f"{np.quantile(trips, 0.99):.2f} ms, {PINGS - len(trips)} of {PINGS} lost; "
            f"{BURST / spent:.0f} messages/s sent, {100 * counted[0] / BURST:.0f} % arrived"
        )
    finally:
        other.stdin.close()
        other.wait(10)
        end.close()


def installed(name: str) -> tuple[str, float]:
    """The version of the first package, and the megabytes of all that it needs."""
    size = 0
    for package in PACKAGES[name]:
        for file in importlib.metadata.files(package) or ():
            path = file.locate()
            size += os.path.getsize(path) if os.path.exists(path) else 0
    return importlib.metadata.version(PACKAGES[name][0]), size / 1e6


def import_time(name: str) -> float:
    """Seconds of a process that imports it, above those of one that does not; the least of five."""
    least = []
    for code in ("", IMPORTS[name]):
        times = []
        for _ in range(5):
            began = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            times.append(time.perf_counter() - began)
        least.append(min(times))
    return least[1] - least[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--echo", choices=list(ENDS))
    parser.add_argument("--measure", choices=list(ENDS))
    chosen = parser.parse_args()
    if chosen.echo:
        return echo(chosen.echo)
    if chosen.measure:
        return print(measured(chosen.measure))
    for name, cases in CASES.items():
        try:
            version, size = installed(name)
        except importlib.metadata.PackageNotFoundError as error:
            print(f"{name}: {error.name} is not installed")
            continue
        print(f"{PACKAGES[name][0]} {version}: {size:.0f} MB, import {import_time(name):.2f} s")
        for case, environment in cases.items():
            print(f"  {case}: ", end="", flush=True)
            with router_of(case):
                words = [sys.executable, __file__, "--measure", name]
                subprocess.run(words, env=os.environ | environment, check=True)
        if name == "zenoh":
            print(f"  a step of the node of a safety filter: {step_of_node():.2f} ms")


def step_of_node() -> float:
    """Milliseconds of a sample of a `FilterNode`, with a vehicle and a controller; the median."""
    import holdfast as hf
    from holdfast.interop.ros2 import (
        ControllerNode,
        FilterNode,
        Interface,
        Network,
        VehicleNode,
        router,
    )

    vehicle = hf.systems.marine_vehicle()
    keep = hf.SafetyFilter(vehicle, hf.regions.camera_view(), gains=(1.5, 8))
    here = Network(7, (ROUTER,), ("tcp/127.0.0.1:0",))
    boat = hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0])
    times = []
    with (
        router(ROUTER),
        FilterNode(keep, network=here) as node,
        VehicleNode(boat, network=here) as sea,
        ControllerNode(lambda s: [2.0, -0.1], Interface(vehicle), network=here) as mine,
    ):
        for _ in range(PINGS):
            sea.step(time.monotonic())
            time.sleep(0.004)
            mine.step(time.monotonic())
            time.sleep(0.004)
            began = time.perf_counter()
            node.step(time.monotonic())
            times.append(1e3 * (time.perf_counter() - began))
    return float(np.median(times))


def router_of(case: str) -> AbstractContextManager[None]:
    """The router of Zenoh, where the case is one with a router."""
    if case != "with a router":
        return nullcontext()
    from holdfast.interop.ros2 import router

    return router(ROUTER)


if __name__ == "__main__":
    main()
