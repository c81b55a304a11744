"""A log of a vehicle's motion: its signals, their noise, its inputs, and windows of one length.

In a window measurements have their own times, and inputs are means over steps. An input is a
command within the limits of its actuator. Of each signal the noise is estimated, and outliers have
less weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array, Wholes
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.system import System


@dataclass(frozen=True)
class Signal:
    """One measured or commanded quantity at its own times.

    time: shape (n,) [s], strictly increasing. value: shape (n,), finite, in SI units (rad, m/s, N).
    An angle is continuous: it does not jump by a turn.

    >>> speed = hf.Signal(np.array([0.0, 0.1]), np.array([0.5, 0.48]))
    """

    time: Array
    value: Array


@dataclass(frozen=True)
class Log:
    """What was measured of the states, and what was commanded.

    name: shown in reports, such as the file's name. states, inputs: signals by the names of a
    system; a state that was not measured is left out. A command holds until the next one. gap: the
    longest time between two values of a signal that counts as whole [s]; a longer one splits
    the log. repairs: a sentence for each repair that was made in reading, with its count.

    >>> times = np.arange(0.0, 2.0, 0.1)
    >>> log = hf.Log("dive.csv", {"x": hf.Signal(times, np.sin(times))}, {}, gap=0.5)
    """

    name: str
    states: Mapping[str, Signal]
    inputs: Mapping[str, Signal]
    gap: float
    repairs: tuple[str, ...] = ()


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

    start: Array
    step: float
    steps: int
    inputs: Array
    window: Wholes
    node: Wholes
    share: Array
    signal: Wholes
    value: Array
    left_out: float

    @property
    def count(self) -> int:
        return len(self.start)

    @property
    def length(self) -> float:
        """Seconds of a window."""
        return self.step * self.steps

    @property
    def time(self) -> Array:
        """When each measurement was made [s], shape (measurements,)."""
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
        spans = list(zip(starts.tolist(), ends.tolist(), strict=True))
        whole = [
            (max(a, c), min(b, d)) for a, b in whole for c, d in spans if max(a, c) < min(b, d)
        ]
    return whole


def _first_command(commands: Sequence[Signal], time: float) -> float:
    """The first command from that time on, so that steps begin when commands do."""
    if not commands:
        return time
    later = commands[0].time[commands[0].time >= time]
    return float(later[0]) if len(later) else time


def _integral(signal: Signal, at: Array) -> Array:
    """The integral of a command that holds until the next one."""
    time = np.append(signal.time, max(signal.time[-1], at.max()) + 1.0)
    total = np.concatenate([[0.0], np.cumsum(np.diff(time) * signal.value)])
    return np.interp(at, time, total)


def _placed(
    signal: Signal, number: int, start: Array, length: float, width: float, steps: int
) -> tuple[Wholes, Wholes, Array, Wholes, Array]:
    """(window, step, where in it, signal, value) of the values that lie in a window."""
    window = np.searchsorted(start, signal.time, side="right") - 1
    inside = (window >= 0) & (signal.time - start[window] < length)
    window = window[inside]
    into = (signal.time[inside] - start[window]) / width
    into = np.where(np.abs(into - np.rint(into)) < 1e-6, np.rint(into), into)  # rounded times
    node = np.minimum(into.astype(np.int64), steps - 1)
    kind = np.full(len(window), number, dtype=np.int64)
    return window.astype(np.int64), node, into - node, kind, signal.value[inside]


HUBER = 2.5
"""Deviations beyond which a residual counts linearly."""

_SMALLEST = 1e-9
"""Noise at least, as a part of the range of a signal."""


def huber_weights(ratio: Array) -> Array:
    """Square roots of Huber's weights of residuals in deviations, both of the shape
    (measurements,)."""
    return np.sqrt(np.minimum(1.0, HUBER / np.maximum(np.abs(ratio), 1e-300)))


def deviations(w: Windows, residual: Array, signals: int, fitted_numbers: int) -> Array:
    """The noise of each signal, from the median of its residuals, for the numbers fitted. residual:
    shape (measurements,). The noise has the shape (signals,)."""
    free = max(1 - fitted_numbers / len(w.value), 0.1)
    each = [1.4826 * float(np.median(np.abs(residual[w.signal == k]))) for k in range(signals)]
    return np.array(each) / np.sqrt(free)


def first_noise(w: Windows, signals: int) -> Array:
    """The noise of each signal, from its second differences within windows, shape (signals,)."""
    noise = []
    for k in range(signals):
        of = w.signal == k
        bend = np.diff(w.value[of], 2)
        within = w.window[of][2:] == w.window[of][:-2]
        some = bend[within] if within.any() else np.zeros(1)
        noise.append(1.4826 * float(np.median(np.abs(some))) / np.sqrt(6))
    return np.maximum(np.array(noise), least_noise(w, signals))


def least_noise(w: Windows, signals: int) -> Array:
    """What the noise of each signal is taken to be at least, shape (signals,)."""
    spans = [
        np.ptp(w.value[w.signal == k]) if (w.signal == k).any() else 0.0 for k in range(signals)
    ]
    return np.maximum(_SMALLEST * np.array(spans), 1e-300)


NOTICED = 0.01
"""The share of a log, and of a command, from which what is beyond a limit is said."""

MOST_BEYOND = 0.5
"""The share of a log from which the limits are not those of its vehicle."""


def commanded_names(system: System, log: Log, needed: Sequence[str]) -> tuple[str, ...]:
    """The signals that give the inputs: all inputs, all actuators, or those that are needed.

    Raises `SimulationError` where the log has none of these.
    """
    for names in (system.input_names, system.actuators, tuple(needed)):
        if names and all(n in log.inputs for n in names):
            return tuple(names)
    if not needed:
        return ()
    missing = [n for n in needed if n not in log.inputs]
    also = f", or of {', '.join(system.actuators)}" if system.actuators else ""
    raise SimulationError(
        f"{log.name} has no signal of {', '.join(missing)}",
        expected=f"signals of {', '.join(needed)}{also}",
    )


def applied(
    system: System, windows: Windows, names: Sequence[str], needed: Sequence[str]
) -> Windows:
    """The windows with the inputs that the actuators produce within their limits.

    names: what the windows have (`commanded_names`); needed: the inputs that they get.
    """
    symbols = [symbol(n) for n in names]
    wishes = _wishes(system, names)
    if wishes is None:
        return windows
    inputs = dict(zip(system.input_names, system.produced(system.limited(wishes)), strict=True))
    compute = Evaluator([inputs[n] for n in needed], symbols, system.parameters)
    flat = np.ascontiguousarray(windows.inputs.reshape(-1, len(names)))
    shape = (*windows.inputs.shape[:2], len(needed))
    return replace(windows, inputs=compute.values(flat).reshape(shape))


def beyond_limits(system: System, windows: Windows, names: Sequence[str]) -> dict[str, float]:
    """The share of the log in which each actuator is commanded beyond its limits, if it ever is.

    windows: with the commands, before they are limited.
    """
    wishes = _wishes(system, names)
    if wishes is None:
        return {}
    values = [*wishes, *system.limited(wishes)]
    compute = Evaluator(values, [symbol(n) for n in names], system.parameters)
    wished, limited = np.hsplit(compute.values(windows.inputs.reshape(-1, len(names))), 2)
    shares = np.mean(np.abs(wished - limited) > NOTICED * np.abs(wished), axis=0)
    pairs = zip(system.actuators or system.input_names, shares.tolist(), strict=True)
    return {name: share for name, share in pairs if share > NOTICED}


def beyond_words(shares: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence for each actuator that is commanded beyond its limits."""
    return tuple(
        f"{name} is commanded beyond its limits in {100 * share:.0f} % of the log, "
        "and the model counts with the limits"
        for name, share in shares.items()
    )


def _wishes(system: System, names: Sequence[str]) -> list[sp.Expr] | None:
    """The actuator values that are asked for; None where only some inputs are known."""
    symbols = [symbol(n) for n in names]
    if tuple(names) == system.input_names:
        return system.allocated(symbols)
    return list(symbols) if tuple(names) == system.actuators else None
