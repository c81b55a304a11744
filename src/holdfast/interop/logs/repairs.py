"""The faults of a signal, repaired and counted: what is no number, times out of order, spikes."""

from __future__ import annotations

import numpy as np

from holdfast.analysis.identification.log import Floats, Signal
from holdfast.errors import SimulationError
from holdfast.interop.logs.recording import Column

SPIKE = 10.0
"""Deviations by which a single value must be off to be left out."""

AROUND = 15
"""Values to either side that say what is usual."""

STUCK = 50
"""Equal values in a row that are worth a sentence, where the signal moves otherwise."""


def repaired(
    name: str, column: Column, factor: float, *, angle: bool, measured: bool
) -> tuple[Signal, list[str]]:
    """The signal of a column, and a sentence for each repair.

    factor: to SI units. angle: jumps by a turn are taken out. measured: single values far off their
    neighbours are left out (a command may jump). Raises `SimulationError` for fewer than two
    values, for a column of which most is not numbers, and for an angle that seems to be in degrees.
    """
    told = [f"{name}: {fault}" for fault in column.faults]
    time, value = column.time, column.value * factor
    there = ~np.isnan(column.value)
    finite = there & np.isfinite(value) & np.isfinite(time)
    if lost := int((there & ~finite).sum()):
        told.append(f"{name}: {lost} values without a number or a time left out")
    if finite.sum() < 2:
        raise SimulationError(f"the log has {int(finite.sum())} values of {name}", expected="many")
    if finite.sum() < 0.5 * there.sum():
        raise SimulationError(f"most values of {name} are not finite numbers")
    time, value = time[finite], value[finite]
    time, value = _in_order(name, time, value, told)
    if angle:
        _check_degrees(name, value, factor)
        value = np.unwrap(value)
    if measured:
        time, value = _without_spikes(name, time, value, told)
    _say_stuck(name, time, value, told, measured)
    return Signal(time, value), told


def _in_order(name: str, time: Floats, value: Floats, told: list[str]) -> tuple[Floats, Floats]:
    back = int((np.diff(time) < 0).sum())
    if back:
        told.append(f"{name}: time goes back {back} times, sorted")
        order = np.argsort(time, kind="stable")
        time, value = time[order], value[order]
    fresh = np.append(True, np.diff(time) > 0)
    if twice := int((~fresh).sum()):
        told.append(f"{name}: {twice} values at a time that another has left out")
    return time[fresh], value[fresh]


def _check_degrees(name: str, value: Floats, factor: float) -> None:
    """An angle that jumps by about 360 is not in radians."""
    jumps = np.abs(np.diff(value))
    if factor == 1.0 and ((jumps > 300) & (jumps < 361)).any():
        raise SimulationError(
            f"{name} jumps by 360: it seems to be in degrees", remedy=f'say so: "{name} [deg]"'
        )


def _without_spikes(
    name: str, time: Floats, value: Floats, told: list[str]
) -> tuple[Floats, Floats]:
    """Without single values far from the line between their neighbours (a Hampel filter of it)."""
    if len(value) < 2 * AROUND + 3:
        return time, value
    share = (time[1:-1] - time[:-2]) / (time[2:] - time[:-2])
    off = np.abs(value[1:-1] - (1 - share) * value[:-2] - share * value[2:])
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(off, AROUND, "reflect"), 2 * AROUND + 1
    )
    usual = np.maximum(np.median(windows, axis=1), np.median(off))
    peak = off >= np.maximum(np.append(off[1:], 0), np.append(0, off[:-1]))
    there_and_back = np.abs(value[2:] - value[:-2]) < 0.5 * off  # unlike a step
    spike = peak & there_and_back & (off > SPIKE * 1.4826 * usual) & (off > 1e-6 * np.ptp(value))
    if not spike.any():
        return time, value
    told.append(f"{name}: {int(spike.sum())} single values far off left out")
    kept = np.ones(len(value), dtype=bool)
    kept[1:-1] = ~spike
    return time[kept], value[kept]


def _say_stuck(name: str, time: Floats, value: Floats, told: list[str], measured: bool) -> None:
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
        told.append(f"{name}: does not change for {lasts:.3g} s from {begin:.3g} s on; kept")
