"""A log of a vehicle from a file: which column is which state and input, and its repairs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from holdfast.analysis.identification.log import Log, Signal, period
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.interop.logs.recording import Recording
from holdfast.interop.logs.repairs import repaired
from holdfast.maths.definitions.lag import actuator_units
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import UnitError, convert

GAP = 5.0
"""Periods without a value that are a gap."""


@checked
def read_log(
    path: str | Path,
    system: System,
    *,
    names: Mapping[str, str] | None = None,
    time: str = "",
    gap: float | None = None,
) -> Log:
    """The states and the inputs of a system in a log: CSV, an MCAP file, or a ROS 2 bag (a folder).

    names: state, input or actuator -> column, with a unit if it is not SI and the header does not
    say it: {"psi": "heading [deg]"} of a table, {"x": "/odom:pose.pose.position.x", "psi":
    "/odom:pose.pose.orientation.heading"} of messages. By default columns of their own names; in
    messages the fields of the only Odometry, and of the only Wrench, Twist or Accel (stamped or
    not) that has the units of the inputs; or the fields of a JSON object. time: the column of times
    of a table. gap [s]: the longest time without a value that does not split the log, by default
    five times the longest period of a measured state.

    Values that are not numbers, times out of order, times that another value has, and single values
    far off are left out, and counted in `Log.repairs`; angles become continuous. Raises
    `SimulationError` for a file that is none of these, names that are not there (with those that
    are), units that do not fit, a log without a state, and signals without enough numbers.
    """
    path = Path(path)
    if gap is not None and not (math.isfinite(gap) and gap > 0):
        raise SimulationError(f"gap is {gap}", expected="seconds, above 0")
    recording = _opened(path, system, time)
    units = {q.name: q.unit for q in (*system.states, *system.inputs)} | actuator_units(system)
    given = dict(names or {})
    for name in given:
        if name not in units:
            raise SimulationError(
                f"'{name}' is neither a state nor an input of system '{system.name}'",
                remedy=suggestion(name, units),
            )
    angles = {q.name for q in system.states if q.angle}
    signals: dict[str, Signal] = {}
    told = [*recording.notes]
    for name, unit in units.items():
        where = given.get(name) or recording.usual(name)
        if not where:
            continue
        column = recording.column(where)
        if name not in given and not column.unreadable and np.isnan(column.value).all():
            told.append(f"{name}: the column is empty")
            continue
        try:
            factor = convert(1.0, column.unit, unit) if column.unit else 1.0
        except UnitError as error:
            raise SimulationError(f"{recording.name}: '{where}' as {name}: {error}") from None
        signals[name], repairs = repaired(
            name, column, factor, angle=name in angles, measured=name in system.state_names
        )
        told += repairs
    states = {n: signals[n] for n in system.state_names if n in signals}
    if not states:
        raise SimulationError(
            f"{recording.name} has no state of system '{system.name}' "
            f"({', '.join(system.state_names)})",
            expected="columns of these names, or names={state: column}; the log has "
            + _some(recording.columns()),
        )
    inputs = {n: s for n, s in signals.items() if n not in states}
    longest = GAP * max(period(s) for s in states.values()) if gap is None else gap
    return Log(path.name, states, inputs, float(longest), tuple(dict.fromkeys(told)))


def _opened(path: Path, system: System, time: str) -> Recording:
    """The log, by its kind."""
    if not path.exists():
        raise SimulationError(f"{path} does not exist", expected="a CSV or MCAP file, or a bag")
    if path.suffix.lower() == ".db3":
        raise SimulationError(
            f"{path} is a part of a bag", remedy=f"give its folder, {path.parent}"
        )
    if path.is_dir() or path.suffix.lower() == ".mcap" or _is_mcap(path):
        try:
            from holdfast.interop.logs.messages import Messages
        except ImportError as error:
            raise SimulationError(
                f"{path} needs the package '{error.name}', which is not installed",
                remedy="python -m pip install 'holdfast[interop]'",
            ) from None
        return Messages(path, system)
    from holdfast.interop.logs.table import Table

    return Table(path, time)


def _is_mcap(path: Path) -> bool:
    with open(path, "rb") as file:
        return file.read(8) == b"\x89MCAP0\r\n"


def _some(names: tuple[str, ...]) -> str:
    shown = ", ".join(names[:30])
    return shown + (f" and {len(names) - 30} more" if len(names) > 30 else "")
