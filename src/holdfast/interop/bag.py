"""Trajectories as a ROS 2 bag (MCAP), with standard messages."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from holdfast.analysis.simulation.result import Result
from holdfast.errors import OutputError
from holdfast.interop.ros_messages import NANO, ODOMETRY, STORE, encoded, made, odometry


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

    path: of the bag, a folder; it must not exist. runs: the numbers of the runs, by default all.
    frame: the name of the fixed frame. pose: the states that are x, y [m] and the heading [rad]
    (about z, REP 103); twist: surge and sway velocity [m/s] and yaw rate [rad/s] in the vehicle's
    frame, 0 for None or an unknown state. Stamps are the time of the run.

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
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for run in runs if runs is not None else range(data.sizes["run"]):
                _write_run(writer, result, run, names, (pose, twist, frame))
    except OSError as error:
        raise OutputError(f"{folder} cannot be written ({error.strerror})") from None
    return folder


def _write_run(
    writer: Any, result: Result, run: int, names: list[str], how: tuple[Any, Any, str]
) -> None:
    pose, twist, frame = how
    data = result.arrays
    moving = writer.add_connection(f"/run_{run}/odometry", ODOMETRY, typestore=STORE)
    acting = writer.add_connection(f"/run_{run}/mode", "std_msgs/msg/Int32", typestore=STORE)
    states, modes = data["state"].values[run], data["mode"].values[run]
    for t, state, mode in zip(data["time"].values, states, modes, strict=True):
        if not np.isfinite(state).all():
            break  # the record ends where the run diverged
        stamp = round(float(t) * NANO)
        value = dict(zip(names, map(float, state), strict=True))
        x, y, heading = (value[n] for n in pose)
        surge, sway, turn = (value.get(n, 0.0) if n else 0.0 for n in twist)
        message = odometry((x, y, heading), (surge, sway, turn), stamp, frame, f"run_{run}")
        writer.write(moving, stamp, encoded(message))
        writer.write(acting, stamp, encoded(made("std_msgs/msg/Int32", data=int(mode))))
