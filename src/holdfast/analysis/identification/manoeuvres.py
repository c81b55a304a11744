"""Which manoeuvre would show a number that a log does not show."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.analysis.identification.commands import applied
from holdfast.analysis.identification.identified import TIED, UNSEEN, WIDE, Estimate
from holdfast.analysis.identification.least_squares import Fitted, Problem
from holdfast.analysis.identification.log import Floats
from holdfast.analysis.identification.observability import deviations
from holdfast.analysis.identification.shooting import Shooting
from holdfast.analysis.identification.windows import Windows
from holdfast.execution.trajectories import Trajectories
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.numeric import evaluated
from holdfast.maths.identification.measured_motion import MeasuredMotion, measured_motion

STRENGTH = 0.6
"""The part of its limit that an input has in a manoeuvre."""

MOST_USEFUL = 1.0
"""The half-width, in parts of the number, below which a manoeuvre is worth saying."""


@dataclass(frozen=True)
class Manoeuvre:
    """Inputs over steps, shape (steps, inputs), and what they are in words."""

    words: str
    inputs: Floats


def advised(
    own: System,
    whole: MeasuredMotion,
    windows: Windows,
    fit: Fitted,
    told: Mapping[str, Estimate],
    quantile: float,
) -> dict[str, Estimate]:
    """The estimates, those that are not seen or wide with the manoeuvre that would show them.

    Of steps, steps about a held input, and steps from rest, as long as the log and from rest: the
    one after which the log and it together give the narrowest interval, by the information that the
    model predicts.
    """
    weak = [e for e in told.values() if e.status in (WIDE, UNSEEN)]
    if not weak or not whole.inputs:
        return dict(told)
    kept = [q.name for q in whole.unknown if told[q.name].status not in (TIED, "given")]
    outputs = dict(zip(whole.names, whole.outputs, strict=True))
    motion = measured_motion(own, whole.names, kept, outputs)
    shooting = Shooting(motion)
    values = np.array([told[q.name].value for q in motion.unknown])
    problem = Problem(shooting, windows, values, range(len(values)))
    known = problem.settle(values, problem.first_local(), fit.weight).information
    best: dict[str, tuple[float, str]] = {}
    trials = list(_manoeuvres(own, motion, windows))
    planned = _planned(own, motion, windows, trials)
    paths = trajectories(motion, planned, values, windows.step)
    for trial, inputs, path in zip(trials, planned, paths, strict=True):
        added = _information(shooting, windows, fit, values, inputs, path)
        if added is None:
            continue
        found = deviations(known + added)
        for k, q in enumerate(motion.unknown):
            if float(found[k]) < best.get(q.name, (math.inf, ""))[0]:
                best[q.name] = float(found[k]), trial.words
    return {n: _with_advice(e, best, quantile, windows) for n, e in told.items()}


def _with_advice(
    e: Estimate, best: Mapping[str, tuple[float, str]], quantile: float, windows: Windows
) -> Estimate:
    if e.status not in (WIDE, UNSEEN) or e.name not in best:
        return e
    deviation, words = best[e.name]
    size = max(abs(e.value), abs(e.before))
    part = quantile * deviation / size if size else math.inf
    seconds = windows.count * windows.length
    if not part < MOST_USEFUL:
        return replace(e, manoeuvre=f"none of those tried for {seconds:.3g} s would show it")
    return replace(
        e, manoeuvre=f"{words} for {seconds:.3g} s would give it within {100 * part:.2g} %"
    )


def _manoeuvres(own: System, motion: MeasuredMotion, windows: Windows) -> Iterator[Manoeuvre]:
    """Steps of each input, alone or about another one that is held."""
    names = [q.name for q in motion.inputs]
    units = [q.unit for q in motion.inputs]
    most = _amplitudes(own, names, windows)
    steps = windows.count * windows.steps
    for k, half in itertools.product(range(len(names)), (1.0, 0.3)):
        every = max(round(half * windows.steps), 1)
        square = np.where((np.arange(steps) // every) % 2 == 0, 1.0, -1.0)
        seconds = f"every {every * windows.step:.3g} s"
        of = f"{names[k]} of {most[k]:.3g} {units[k]}"
        for words, wave in (
            (f"steps of {of} to either side {seconds}", square),
            (f"{of} on and off {seconds}", (square + 1) / 2),
        ):
            inputs = np.zeros((steps, len(names)))
            inputs[:, k] = most[k] * wave
            yield Manoeuvre(words, inputs)
            for other in range(len(names)):
                if other != k:
                    both = inputs.copy()
                    both[:, other] = most[other]
                    held = f"{names[other]} held at {most[other]:.3g} {units[other]}"
                    yield Manoeuvre(f"{words}, {held},", both)


def _amplitudes(own: System, names: list[str], windows: Windows) -> list[float]:
    """A part of what each input can be; of the largest that the log has where it has no limit."""
    bounds = own.input_bounds.ranges() if own.input_bounds else [()] * len(own.input_names)
    ranges = dict(zip(own.input_names, bounds, strict=True))
    values = {p.symbol: p.value for p in own.parameters}
    found = []
    for k, name in enumerate(names):
        ends = evaluated(ranges[name], values)
        limit = min((abs(e) for e in ends), default=math.inf)
        used = float(np.abs(windows.inputs[:, :, k]).max(initial=0.0))
        found.append(STRENGTH * limit if math.isfinite(limit) and limit > 0 else used or 1.0)
    return found


def _planned(
    own: System, motion: MeasuredMotion, windows: Windows, trials: Sequence[Manoeuvre]
) -> Floats:
    """The inputs that each manoeuvre gives within the limits, shape (manoeuvres, steps, inputs)."""
    names = [q.name for q in motion.inputs]
    inputs = np.stack([trial.inputs for trial in trials])
    if len(names) < len(own.input_names):
        return inputs
    shape = (-1, windows.steps, len(names))
    limited = applied(own, replace(windows, inputs=inputs.reshape(shape)), own.input_names, names)
    return limited.inputs.reshape(inputs.shape)


def _information(
    shooting: Shooting, windows: Windows, fit: Fitted, values: Floats, inputs: Floats, path: Floats
) -> Floats | None:
    """What a manoeuvre would show, with the noise and the rate of measurements.

    inputs, path: of each step, and the states at each node.
    """
    if not np.isfinite(path).all():
        return None
    motion = shooting.motion
    count, steps, signals = windows.count, windows.steps, len(motion.names)
    rows = np.arange(count * steps * signals)
    window, rest = np.divmod(rows, steps * signals)
    node, signal = np.divmod(rest, signals)
    planned = replace(
        windows, inputs=inputs.reshape(count, steps, -1), window=window, node=node,
        share=np.zeros(len(rows)), signal=signal, value=np.zeros(len(rows)),
    )  # fmt: skip
    per_step = np.bincount(windows.signal, minlength=signals) / (count * steps)
    weight = (np.sqrt(per_step) / fit.noise)[signal]
    problem = Problem(shooting, planned, values, range(len(values)))
    found, _, _ = problem.predict(values, path[:-1:steps])
    problem.windows = replace(planned, value=found.value)
    settled = problem.settle(values, path[:-1:steps], weight)
    return settled.information if np.isfinite(settled.slopes).all() else None


def trajectories(motion: MeasuredMotion, inputs: Floats, values: Floats, step: float) -> Floats:
    """States from rest at the nodes of steps with these inputs.

    inputs: shape (manoeuvres, steps, inputs). Shape (manoeuvres, steps + 1, states).
    """
    x, u, v = ([q.symbol for q in g] for g in (motion.states, motion.inputs, motion.unknown))
    paths = Trajectories(list(motion.rates), x, u, v, motion.parameters)
    first = np.zeros((len(inputs), len(x)))
    with np.errstate(over="ignore", invalid="ignore"):
        nodes, _ = paths.nodes(first, inputs, np.tile(values, (len(inputs), 1)), step)
    return nodes.transpose(2, 0, 1)
