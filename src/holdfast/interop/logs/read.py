"""A log of a vehicle from a file: which column is which state and input, and its repairs.

The faults of a signal are repaired and counted: what is no number, times out of order, spikes.

A log is written as a table that `read_log` reads: CSV.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from holdfast.analysis.identification.log import Log, Signal, period
from holdfast.arguments import checked
from holdfast.errors import OutputError, SimulationError, suggestion
from holdfast.execution.arrays import Array
from holdfast.interop.logs.table import Column, Recording
from holdfast.maths.definitions.extension import actuator_units
from holdfast.maths.definitions.quantity import UnitError, convert
from holdfast.maths.definitions.system import System


@checked
def write_log(log: Log, path: str | Path) -> Path:
    """Write the states and inputs of a log as CSV, in SI units, with a column `time` [s].

    log: a `Log`. path: of the file, which must not exist.

    A row for every time of any signal; a signal that has no value then has an empty place. Times
    and values are written in full. Reading counts the time from the first row on, and makes the
    repairs that a measurement needs.

    Raises `OutputError` for a file that exists or cannot be written, and for a signal that is
    called `time`.
    """
    path, signals = Path(path), {**log.states, **log.inputs}
    if "time" in signals:
        raise OutputError("a signal is called 'time'", expected="another name")
    times = np.unique(np.concatenate([np.zeros(0), *(s.time for s in signals.values())]))
    frame = pd.DataFrame({"time": times})
    for name, signal in signals.items():
        column = np.full(len(times), np.nan)
        column[np.searchsorted(times, signal.time)] = signal.value
        frame[name] = column
    try:
        frame.to_csv(path, index=False, mode="x")
    except FileExistsError:
        raise OutputError(f"{path} exists already", remedy="choose another file") from None
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error})") from None
    return path


SPIKE = 10.0
"""Deviations by which a single value must be off to be left out."""

DEVIATION = 1.4826
"""Standard deviations of a normal distribution in the median of its absolute values."""

FEW = 0.05
"""The largest share of values that are left out as spikes; more of them are no spikes."""

LATE = 5
"""Values in a row, in order among themselves, that lie before an earlier one: a clock was set."""

AROUND = 15
"""Values to either side that say what is usual."""

LEAST_RUNS, REGULAR = 20, 0.8
"""Runs of equal values, and the part of them that is of one length, of a slower sensor."""

STUCK = 50
"""Equal values in a row that are worth a sentence, where the signal moves otherwise."""


def repaired(
    name: str, column: Column, factor: float, *, angle: bool, measured: bool
) -> tuple[Signal, list[str]]:
    """The signal of a column, and a sentence for each repair.

    factor: to SI units. angle: jumps by a turn are taken out. measured: single values far off their
    neighbours are left out (a command may jump). Raises `SimulationError` for fewer than two
    values, for a column of which most is not numbers, for a clock that was set back, and for an
    angle that seems to be in degrees.
    """
    notes = [f"{name}: {fault}" for fault in column.faults]
    time, value = column.time, column.value * factor
    there = ~np.isnan(column.value)
    finite = there & np.isfinite(value) & np.isfinite(time)
    if lost := int((there & ~finite).sum()):
        notes.append(f"{name}: {lost} values without a number or a time left out")
    if finite.sum() < 2:
        raise SimulationError(f"the log has {int(finite.sum())} values of {name}", expected="many")
    if finite.sum() < 0.5 * (there.sum() + column.unreadable):
        raise SimulationError(f"most values of {name} are not finite numbers")
    time, value = time[finite], value[finite]
    _check_clock(name, time)
    time, value = _in_order(name, time, value, notes)
    if len(time) < 2:
        raise SimulationError(f"all values of {name} have one time", expected="times that differ")
    if angle and factor == 1.0:
        _check_degrees(name, value)
    if measured:
        time, value = _without_repeats(name, time, value, notes)
        time, value = _without_spikes(name, time, value, notes, angle=angle)
    if angle:
        if not column.unit:
            _say_degrees(name, value, notes)
        value = np.unwrap(value)
    _say_stuck(name, time, value, notes, measured)
    return Signal(time, value), notes


def _check_clock(name: str, time: Array) -> None:
    """Refuse a clock that went back and on from there: sorted, two motions would be mixed."""
    before = np.maximum.accumulate(time)[:-1]
    follows = (time[1:] < before) & (np.diff(time) > 0)
    ends = np.concatenate([[-1], np.flatnonzero(~follows), [len(follows)]])
    runs = np.diff(ends) - 1
    if runs.max() < LATE:
        return
    at = int(ends[int(np.argmax(runs >= LATE))])
    raise SimulationError(
        f"{name}: the clock goes back by {before[at] - time[at + 1]:.4g} s after "
        f"{before[at] - time[0]:.4g} s and goes on from there: it was set, or two logs are joined",
        remedy="cut the log into two files there",
    )


def _in_order(name: str, time: Array, value: Array, notes: list[str]) -> tuple[Array, Array]:
    back = int((np.diff(time) < 0).sum())
    if back:
        notes.append(f"{name}: time goes back {back} times, sorted")
        order = np.argsort(time, kind="stable")
        time, value = time[order], value[order]
    fresh = np.append(True, np.diff(time) > 0)
    if twice := int((~fresh).sum()):
        notes.append(f"{name}: {twice} values at a time that another has left out")
    return time[fresh], value[fresh]


def _check_degrees(name: str, value: Array) -> None:
    """An angle that jumps by about 360 is not in radians."""
    jumps = np.abs(np.diff(value))
    if ((jumps > 350) & (jumps < 370)).any():
        raise SimulationError(
            f"{name} jumps by 360: it seems to be in degrees", remedy=f'say so: "{name} [deg]"'
        )


def _say_degrees(name: str, value: Array, notes: list[str]) -> None:
    """Question an angle beyond a turn that never jumps by one: continuous radians, or degrees."""
    largest = float(np.abs(value).max())
    if largest > 7.0 and not (np.abs(np.diff(value)) > 5.5).any():
        notes.append(
            f"{name} reaches {largest:.3g} without a jump by a turn and has no unit: taken as "
            f'radians; if it is in degrees, say "{name} [deg]"'
        )


def _without_spikes(
    name: str, time: Array, value: Array, notes: list[str], *, angle: bool
) -> tuple[Array, Array]:
    """Without single values far from the line between their neighbours (a Hampel filter of it).

    The neighbours are nearer to each other than to the value, unlike at a step, and move less among
    themselves, unlike at a turning point.
    """
    if len(value) < 2 * AROUND + 3:
        return time, value

    def least(d: Array) -> Array:
        return d - 2 * math.pi * np.round(d / (2 * math.pi)) if angle else d

    moves = least(np.diff(value))
    both = least(moves[:-1] + moves[1:])
    share = (time[1:-1] - time[:-2]) / (time[2:] - time[:-2])
    off = np.abs(least(moves[:-1] - share * both))
    sizes = np.abs(moves)
    beside = np.minimum(np.append(np.inf, sizes[:-2]), np.append(sizes[2:], np.inf))
    resolution = sizes[sizes > 0].min(initial=np.inf)  # of a sensor that counts
    least_off = np.maximum(
        3 * beside, max(SPIKE * DEVIATION * np.median(off), 3 * resolution, 1e-6 * np.ptp(value))
    )
    peak = off >= np.maximum(np.append(off[1:], 0), np.append(0, off[:-1]))
    spike = peak & (np.abs(both) < 0.5 * off) & (off > least_off)
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(off, AROUND, "reflect"), 2 * AROUND + 1
    )
    spike[spike] = off[spike] > SPIKE * DEVIATION * np.median(windows[spike], axis=1)
    count = int(spike.sum())
    if count > FEW * len(value):
        notes.append(f"{name}: {count} single values far off are too many to be faults; kept")
        return time, value
    if count:
        notes.append(f"{name}: {count} single values far off left out")
    good = np.ones(len(value), dtype=bool)
    good[1:-1] = ~spike
    return time[good], value[good]


def _without_repeats(name: str, time: Array, value: Array, notes: list[str]) -> tuple[Array, Array]:
    """The first of equal values of a sensor that is slower than its log, each held as long."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(value) != 0) + 1])
    runs = np.diff(starts)
    if len(runs) < LEAST_RUNS:
        return time, value
    usual = float(np.median(runs))
    if usual < 2 or np.mean(np.abs(runs - usual) <= 1) < REGULAR:
        return time, value
    notes.append(f"{name}: every value stands {usual:.0f} times, the first of each is kept")
    return time[starts], value[starts]


def _say_stuck(name: str, time: Array, value: Array, notes: list[str], measured: bool) -> None:
    """Say where a measured signal does not change for long, though it does elsewhere."""
    if not measured or len(value) < 2:
        return
    changes = np.flatnonzero(np.diff(value) != 0)
    ends = np.concatenate([[-1], changes, [len(value) - 1]])
    runs = np.diff(ends)
    longest = int(np.argmax(runs))
    count = int(runs[longest])
    if count > STUCK and count < 0.9 * len(value) and len(changes) > 0.2 * len(value):
        begin = float(time[int(ends[longest]) + 1])
        lasts = float(time[int(ends[longest + 1])]) - begin
        notes.append(f"{name}: does not change for {lasts:.3g} s from {begin:.3g} s on; kept")


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

    path: of the file or the folder. names: state, input or actuator -> column, with a unit if it is
    not SI and the header does not say it: {"psi": "heading [deg]"} of a table, {"x":
    "/odom:pose.pose.position.x", "psi": "/odom:pose.pose.orientation.heading"} of messages. By
    default columns of their own names; in messages the fields of the only Odometry, and of the only
    Wrench, Twist or Accel (stamped or not) that has the units of the inputs; or the fields of a
    JSON object. time: the column of times of a table. gap [s]: the longest time without a value
    that does not split the log, by default five times the longest period of a measured state.

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
    columns = dict(names or {})
    for name in columns:
        if name not in units:
            raise SimulationError(
                f"'{name}' is neither a state nor an input of system '{system.name}'",
                remedy=suggestion(name, units),
            )
    angles = {q.name for q in system.states if q.angle}
    signals: dict[str, Signal] = {}
    notes = [*recording.notes]
    for name, unit in units.items():
        where = columns.get(name) or recording.usual(name)
        if not where:
            continue
        column = recording.column(where)
        if name not in columns and not column.unreadable and np.isnan(column.value).all():
            notes.append(f"{name}: the column is empty")
            continue
        try:
            factor = convert(1.0, column.unit, unit) if column.unit else 1.0
        except UnitError as error:
            raise SimulationError(f"{recording.name}: '{where}' as {name}: {error}") from None
        signals[name], repairs = repaired(
            name, column, factor, angle=name in angles, measured=name in system.state_names
        )
        notes += repairs
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
    return Log(path.name, states, inputs, float(longest), tuple(dict.fromkeys(notes)))


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
