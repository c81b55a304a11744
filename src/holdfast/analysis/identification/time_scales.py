"""How long a window and a step are, from the time constants of the model and the log's periods."""

from __future__ import annotations

import numpy as np

from holdfast.analysis.identification.log import Log
from holdfast.analysis.identification.windows import period, pieces
from holdfast.errors import SimulationError
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.definitions.system import System
from holdfast.maths.identification.measured_motion import MeasuredMotion

SLOWEST, FASTEST = 3.0, 0.25
"""A window in slowest time constants; a step in fastest ones, at most."""

LEAST_VALUES, LEAST_WINDOWS, MOST_STEPS = 20, 30, 400
"""Values of a signal in a window, windows of a log, and steps of a window."""

LEAST_GIVEN, MOST = 5, 5e6
"""Values of a signal in a window that is given, at least, and steps of a log, at most."""


def lengths(
    system: System, motion: MeasuredMotion, log: Log, window: float | None
) -> tuple[float, float]:
    """Seconds of a window, and of one of its steps."""
    signals = [log.states[n] for n in motion.names]
    values = max(period(s) for s in signals)
    if not np.isfinite(values):
        raise SimulationError(f"{log.name} has fewer than two values of a signal")
    fast, slow = _time_constants(system, motion, log)
    whole = sum(b - a for a, b in pieces(signals, log.gap))
    if window is not None and window < LEAST_GIVEN * values:
        raise SimulationError(
            f"window is {window:g} s, and a signal has a value every {values:.3g} s",
            expected=f"at least {LEAST_GIVEN} values in a window",
        )
    if window is None:
        wanted = SLOWEST * slow if np.isfinite(slow) else 50 * values
        window = max(min(wanted, whole / LEAST_WINDOWS), LEAST_VALUES * values)
    given = [log.inputs[q.name] for q in motion.inputs if q.name in log.inputs]
    finest = min(period(s) for s in [*signals, *given])
    most = min(max(finest, window / MOST_STEPS), FASTEST * fast, window / 8)
    # steps that divide the period of the commands, or are several: a command changes between steps
    step = (
        finest * max(np.floor(most / finest), 1.0)
        if most >= finest
        else finest / np.ceil(finest / most)
    )
    if not whole / step <= MOST:
        raise SimulationError(
            f"{log.name} needs {whole / step:.2g} steps of {step:.2g} s",
            expected=f"at most {MOST:.0e}: units and values that the vehicle can have",
        )
    return float(step * max(round(window / step), 1)), float(step)


def _time_constants(system: System, motion: MeasuredMotion, log: Log) -> tuple[float, float]:
    """The fastest and the slowest, of the rates linearised at measured states (medians)."""
    values = {p.name: float(p.value) for p in system.parameters}
    n = len(motion.states)
    count = 50
    signals = [log.states[name] for name in motion.names]
    times = np.linspace(max(s.time[0] for s in signals), min(s.time[-1] for s in signals), count)
    points = np.zeros((count, len(motion.columns)))
    for k, q in enumerate(motion.states):
        if q.name in log.states:
            signal = log.states[q.name]
            points[:, k] = np.interp(times, signal.time, signal.value)
    for k, q in enumerate(motion.unknown):
        points[:, len(motion.columns) - len(motion.unknown) + k] = values.get(q.name, 0.0)
    found = Evaluator(motion.sensitivities, motion.columns, motion.parameters).values(points)
    slopes = found[:, n : n + n * n].reshape(count, n, n)
    slopes = slopes[np.isfinite(slopes).all(axis=(1, 2))]
    if not len(slopes):
        return np.inf, np.inf
    decay = -np.linalg.eigvals(slopes).real
    largest = decay.max(axis=1)
    real = np.where(decay > 1e-6 * np.maximum(largest, 1e-300)[:, None], decay, np.inf)
    with np.errstate(divide="ignore"):
        slow = 1 / real.min(axis=1)
        fast = 1 / np.maximum(largest, 0)
    slow = slow[slow > 0]
    return float(np.median(fast)), float(np.median(slow)) if len(slow) else np.inf
