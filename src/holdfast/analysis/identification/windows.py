"""A log in windows of one length: measurements at their own times, inputs as means over steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.analysis.identification.log import Floats, Log, Signal
from holdfast.errors import SimulationError

Interval = tuple[float, float]
FEWEST = 4
"""Windows that a log must have."""


@dataclass(frozen=True)
class Windows:
    """What was measured and commanded in windows of `steps` steps of `step` seconds each.

    start: shape (windows,) [s]. inputs: shape (windows, steps, inputs), means over the steps. Each
    measurement has its window, the step in which it lies, where in the step (0 to 1), which signal
    it is of, and its value: arrays of one length, in the order of the windows. left_out: seconds
    of the log in no window.
    """

    start: Floats
    step: float
    steps: int
    inputs: Floats
    window: npt.NDArray[np.int64]
    node: npt.NDArray[np.int64]
    share: Floats
    signal: npt.NDArray[np.int64]
    value: Floats
    left_out: float

    @property
    def count(self) -> int:
        return len(self.start)

    @property
    def length(self) -> float:
        """Seconds of a window."""
        return self.step * self.steps

    @property
    def time(self) -> Floats:
        """When each measurement was made [s]."""
        return self.start[self.window] + (self.node + self.share) * self.step


def period(signal: Signal) -> float:
    """The median time between two values."""
    return float(np.median(np.diff(signal.time))) if len(signal.time) > 1 else np.inf


def windows_of(
    log: Log, names: Sequence[str], inputs: Sequence[str], length: float, step: float
) -> Windows:
    """The windows of a log, end to end in each part of it without a gap.

    names: signals of states that are measured, inputs: of commands. length, step: of a window and
    of a step at most [s]. Raises `SimulationError` for fewer than four windows.
    """
    states = [log.states[n] for n in names]
    commands = [log.inputs[n] for n in inputs]
    whole = [(_first_command(commands, a), b) for a, b in pieces([*states, *commands], log.gap)]
    steps = max(int(np.ceil(length / step - 1e-9)), 1)
    width = length / steps
    start = np.concatenate(
        [a + length * np.arange(max(int((b - a) / length + 1e-9), 0)) for a, b in whole]
        or [np.empty(0)]
    )
    if len(start) < FEWEST:
        longest = max((b - a for a, b in whole), default=0.0)
        raise SimulationError(
            f"{log.name} has {len(start)} windows of {length:.3g} s without a gap; "
            f"its longest part that is whole lasts {longest:.3g} s",
            expected=f"at least {FEWEST}",
            remedy="take a shorter window, or a longer gap",
        )
    edges = start[:, None] + width * np.arange(steps + 1)
    held = [np.diff(_integral(signal, edges), axis=1) / width for signal in commands]
    rows = [_placed(s, k, start, length, width, steps) for k, s in enumerate(states)]
    window, node, share, signal, value = (
        np.concatenate(parts) for parts in zip(*rows, strict=True)
    )
    order = np.argsort(window, kind="stable")
    return Windows(
        start=start,
        step=width,
        steps=steps,
        inputs=np.stack(held, axis=2) if held else np.empty((len(start), steps, 0)),
        window=window[order],
        node=node[order],
        share=share[order],
        signal=signal[order],
        value=value[order],
        left_out=span(states) - len(start) * length,
    )


def span(signals: Sequence[Signal]) -> float:
    """Seconds from the first value of all signals to the last."""
    return float(max(s.time[-1] for s in signals) - min(s.time[0] for s in signals))


def pieces(signals: Sequence[Signal], gap: float) -> list[Interval]:
    """The times in which no signal has a gap. Slow signals may pause five of their periods."""
    whole: list[Interval] = [(-np.inf, np.inf)]
    for signal in signals:
        longest = max(gap, 5 * period(signal) if len(signal.time) > 1 else gap)
        breaks = np.flatnonzero(np.diff(signal.time) > longest)
        starts = signal.time[np.concatenate([[0], breaks + 1])]
        ends = signal.time[np.concatenate([breaks, [len(signal.time) - 1]])]
        own = list(zip(starts.tolist(), ends.tolist(), strict=True))
        whole = [(max(a, c), min(b, d)) for a, b in whole for c, d in own if max(a, c) < min(b, d)]
    return whole


def _first_command(commands: Sequence[Signal], time: float) -> float:
    """The first command from that time on, so that steps begin when commands do."""
    if not commands:
        return time
    later = commands[0].time[commands[0].time >= time]
    return float(later[0]) if len(later) else time


def _integral(signal: Signal, at: Floats) -> Floats:
    """The integral of a command that holds until the next one."""
    time = np.append(signal.time, max(signal.time[-1], at.max()) + 1.0)
    total = np.concatenate([[0.0], np.cumsum(np.diff(time) * signal.value)])
    return np.interp(at, time, total)


def _placed(
    signal: Signal, number: int, start: Floats, length: float, width: float, steps: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], Floats, npt.NDArray[np.int64], Floats]:
    """(window, step, where in it, signal, value) of the values that lie in a window."""
    window = np.searchsorted(start, signal.time, side="right") - 1
    inside = (window >= 0) & (signal.time - start[window] < length)
    window = window[inside]
    into = (signal.time[inside] - start[window]) / width
    into = np.where(np.abs(into - np.rint(into)) < 1e-6, np.rint(into), into)  # rounded times
    node = np.minimum(into.astype(np.int64), steps - 1)
    kind = np.full(len(window), number, dtype=np.int64)
    return window.astype(np.int64), node, into - node, kind, signal.value[inside]
