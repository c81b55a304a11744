"""Trajectories as a ROS 2 bag (MCAP), with standard messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from holdfast.analysis.simulation.result import Result
from holdfast.errors import OutputError

NANO = 1_000_000_000


def write_bag(
    result: Result,
    path: str | Path,
    *,
    runs: Iterable[int] | None = None,
    pose: tuple[str, str, str] = ("x", "y", "psi"),
    twist: tuple[str | None, str | None, str | None] = ("u", "v", "r"),
    frame: str = "map",
) -> Path:
    """Every run as topics /run_K/odometry (nav_msgs/Odometry) and /run_K/mode (std_msgs/Int32).

    pose: the states that are x, y [m] and the heading [rad] (about z, REP 103); twist: surge and
    sway velocity [m/s] and yaw rate [rad/s] in the vehicle's frame, 0 for None or an unknown state.
    Stamps are the time of the run. The bag is a folder; it must not exist.

    Raises `OutputError` for a folder that exists or cannot be written, and for states that the
    result does not have.
    """
    data, folder = result.arrays, Path(path)
    names = [str(n) for n in data["state_name"].values]
    for name in pose:
        if name not in names:
            raise OutputError(f"the result has no state '{name}'", expected="pose=(x, y, heading)")
    if folder.exists():
        raise OutputError(f"{folder} exists already", remedy="choose another folder")
    store = get_typestore(Stores.ROS2_JAZZY)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for run in runs if runs is not None else range(data.sizes["run"]):
                _write_run(writer, store, result, run, names, (pose, twist, frame))
    except OSError as error:
        raise OutputError(f"{folder} cannot be written ({error.strerror})") from None
    return folder


def _write_run(
    writer: Any, store: Any, result: Result, run: int, names: list[str], how: tuple[Any, Any, str]
) -> None:
    pose, twist, frame = how
    data = result.arrays
    types = store.types
    moving = writer.add_connection(f"/run_{run}/odometry", "nav_msgs/msg/Odometry", typestore=store)
    acting = writer.add_connection(f"/run_{run}/mode", "std_msgs/msg/Int32", typestore=store)
    states, modes = data["state"].values[run], data["mode"].values[run]
    none = np.zeros(36)
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    for t, state, mode in zip(data["time"].values, states, modes, strict=True):
        if not np.isfinite(state).all():
            break  # the record ends where the run diverged
        stamp = round(float(t) * NANO)
        value = dict(zip(names, map(float, state), strict=True))
        x, y, heading = (value[n] for n in pose)
        surge, sway, turn = (value.get(n, 0.0) if n else 0.0 for n in twist)
        message = types["nav_msgs/msg/Odometry"](
            header=types["std_msgs/msg/Header"](
                stamp=types["builtin_interfaces/msg/Time"](sec=stamp // NANO, nanosec=stamp % NANO),
                frame_id=frame,
            ),
            child_frame_id=f"run_{run}",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](
                pose=types["geometry_msgs/msg/Pose"](
                    position=point(x=x, y=y, z=0.0),
                    orientation=types["geometry_msgs/msg/Quaternion"](
                        x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2)
                    ),
                ),
                covariance=none,
            ),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                twist=types["geometry_msgs/msg/Twist"](
                    linear=vector(x=surge, y=sway, z=0.0), angular=vector(x=0.0, y=0.0, z=turn)
                ),
                covariance=none,
            ),
        )
        writer.write(moving, stamp, store.serialize_cdr(message, moving.msgtype))
        written = types["std_msgs/msg/Int32"](data=int(mode))
        writer.write(acting, stamp, store.serialize_cdr(written, acting.msgtype))
