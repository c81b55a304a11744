"""The fit of a log: windows of a length that follows from the model, and what the log shows.

A window and a step are as long as the time constants of the model and the log's periods say. Which
numbers a motion can show at all, and which this log shows, is found from the sensitivities. The
result has numbers with intervals, and what they leave unexplained.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.identification.least_squares import (
    LOOSE,
    DivergenceError,
    Fitted,
    Problem,
    Shooting,
    fitted,
)
from holdfast.analysis.identification.log import (
    MOST_BEYOND,
    Log,
    Windows,
    applied,
    beyond_limits,
    beyond_words,
    commanded_names,
    first_noise,
    period,
    pieces,
    windows_of,
)
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.system import System
from holdfast.maths.identification import MeasuredMotion, measured_motion

IDENTIFIED, WIDE, AT_LIMIT, TIED, UNSEEN, GIVEN = (
    "identified",
    "wide",
    "at its limit",
    "tied",
    "not seen",
    "given",
)
"""What became of a number: its interval is useful; wider than itself; at the limit of its values;
held because the motion shows only a combination; held because this log does not show it; held on
request."""


@dataclass(frozen=True)
class Estimate:
    """A parameter of the system, or a constant disturbance during the log.

    before, value: its number before and now. low, high: its interval, NaN if it was held. status:
    `IDENTIFIED` and so on. why: a sentence. manoeuvre: what would show it, and the interval that
    this would give, "" where none is needed or none was found.
    """

    name: str
    unit: str
    before: float
    value: float
    low: float
    high: float
    status: str
    why: str = ""
    manoeuvre: str = ""

    @property
    def half_width(self) -> float:
        return (self.high - self.low) / 2


@dataclass(frozen=True)
class Unexplained:
    """The rates that the model needs in addition, constant in each short window.

    names: of states. units: of their rates. low, high: the bound on each. value: what each window
    needs, shape (windows, names); by_noise: the deviation that measurement noise alone gives it.
    start: of the windows [s]; length: of each [s]. unjudged: how many others had too few
    measurements to tell.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    value: Array
    by_noise: Array
    start: Array
    length: float
    unjudged: int = 0

    @property
    def noise_share(self) -> tuple[float, ...]:
        """The part of each spread that measurement noise explains, 1 for all of it."""
        spread = self.value.std(axis=0)
        noise = (self.by_noise**2).mean(axis=0) ** 0.5
        return tuple(
            float(min(n / s, 1.0)) if s > 0 else 0.0 for n, s in zip(noise, spread, strict=True)
        )


@dataclass(frozen=True)
class HeldOut:
    """A second log beside the bound on what is unexplained.

    needed: what its windows need. outside: how many of them are outside the bound by more than two
    deviations of the noise; beyond: how many are outside at all. worst: how far the farthest is
    from the middle of the bound, in half-widths, of each state. error: the deviation of the
    prediction over a window for each signal, in that of the noise.
    """

    name: str
    needed: Unexplained
    outside: int
    beyond: int
    worst: tuple[float, ...]
    error: Mapping[str, float]

    @property
    def covered(self) -> bool:
        return self.outside == 0


@dataclass(frozen=True)
class Identified:
    """A system with the numbers of its log.

    system: with the estimated parameters. parameters, disturbances: what became of each number.
    unexplained: the bound on what the model leaves out. held_out: the second log, if there is one.
    noise: the deviation of each signal. outliers: the share of measurements with less weight.
    window, step, windows: lengths [s] and number. level: of the intervals. ties: a sentence for
    each combination that the motion shows only together. repairs: of the log. remarks: why the
    numbers may be wrong although their intervals are narrow.
    """

    system: System
    log: str
    parameters: tuple[Estimate, ...]
    disturbances: tuple[Estimate, ...]
    unexplained: Unexplained
    held_out: HeldOut | None
    noise: Mapping[str, float]
    outliers: float
    window: float
    step: float
    windows: int
    left_out: float
    level: float
    ties: tuple[str, ...]
    repairs: tuple[str, ...]
    remarks: tuple[str, ...]
    measured: Mapping[str, Any]
    """For the figure: per signal (time, measured, predicted)."""

    @property
    def values(self) -> dict[str, float]:
        """The estimated parameters by name."""
        return {e.name: e.value for e in self.parameters if not math.isnan(e.low)}

    @property
    def verdict(self) -> str:
        """Whether the bound holds on a second log, in one sentence."""
        if self.held_out is None:
            return "no second log: the bound is that of the log itself"
        second = self.held_out
        count = len(second.needed.start)
        if second.covered:
            less = f", {second.beyond} of them but for noise" if second.beyond else ""
            if second.needed.unjudged:
                less += f"; {second.needed.unjudged} others have too few measurements"
            return f"{second.name}: all {count} windows are within the bound{less}"
        worst = max(second.worst)
        name = self.unexplained.names[second.worst.index(worst)]
        return (
            f"{second.name}: {second.outside} of {count} windows are NOT within the bound; "
            f"the rate of {name} needs {worst:.2g} times its half-width"
        )

    def summary(self) -> dict[str, Any]:
        """Plain data; NaN appears as None."""

        def plain(value: float) -> float | None:
            return value if math.isfinite(value) else None

        def entry(e: Estimate) -> dict[str, Any]:
            return {
                "unit": e.unit,
                "before": plain(e.before),
                "value": plain(e.value),
                "low": plain(e.low),
                "high": plain(e.high),
                "status": e.status,
                "why": e.why,
                "manoeuvre": e.manoeuvre,
            }

        left = self.unexplained
        second = self.held_out
        return {
            "log": self.log,
            "repairs": list(self.repairs),
            "remarks": list(self.remarks),
            "level": self.level,
            "parameters": {e.name: entry(e) for e in self.parameters},
            "disturbances": {e.name: entry(e) for e in self.disturbances},
            "ties": list(self.ties),
            "unexplained": {
                n: {"unit": u, "low": a, "high": b, "noise_share": s}
                for n, u, a, b, s in zip(
                    left.names, left.units, left.low, left.high, left.noise_share, strict=True
                )
            },
            "unexplained_window": left.length,
            "unexplained_windows": len(left.start),
            "noise": dict(self.noise),
            "outliers": self.outliers,
            "window": self.window,
            "windows": self.windows,
            "seconds_left_out": self.left_out,
            "verdict": self.verdict,
            "held_out": None
            if second is None
            else {
                "log": second.name,
                "covered": second.covered,
                "windows": len(second.needed.start),
                "outside": second.outside,
                "beyond": second.beyond,
                "worst": dict(zip(left.names, second.worst, strict=True)),
                "error": dict(second.error),
            },
        }


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
    commands = [log.inputs[q.name] for q in motion.inputs if q.name in log.inputs]
    finest = min(period(s) for s in [*signals, *commands])
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
    computed = Evaluator(motion.sensitivities, motion.columns, motion.parameters).values(points)
    slopes = computed[:, n : n + n * n].reshape(count, n, n)
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


SINGULAR, HOPELESS, VAGUE = 1e-7, 30.0, 0.5
"""A singular value, in parts of the largest, that counts as none; relative deviations that count as
not seen, before the fit and after it."""

_POINTS = 400


def ties(motion: MeasuredMotion, values: Array) -> list[tuple[str, ...]]:
    """Groups of numbers that the rates show only in combination, however the vehicle moves.

    The null space of df/dv at these values, at random states and inputs (local structural
    identifiability with every state measured). Each group is a combination; a log of fewer states
    may tie more.

    values: shape (unknown,).
    """
    if not len(values):
        return []
    generator = np.random.default_rng(0)
    n = len(motion.states)
    compute = Evaluator(motion.sensitivities, motion.columns, motion.parameters)
    some = generator.uniform(-1, 1, size=(_POINTS, len(motion.columns)))
    scale = np.where(values == 0, 1.0, np.abs(values))
    some[:, some.shape[1] - len(values) :] = values
    slopes = compute.values(some)[:, n + n * n :].reshape(-1, len(values)) * scale
    slopes = slopes[np.isfinite(slopes).all(axis=1)]
    norm = np.linalg.norm(slopes, axis=0)
    seen = norm > 0
    _, singular, right = np.linalg.svd(slopes / np.where(seen, norm, 1.0), full_matrices=False)
    null = right[singular < SINGULAR * singular[0]]
    names = [q.name for q in motion.unknown]
    return [tuple(names[k] for k in np.flatnonzero(np.abs(row) > 1e-6)) for row in _sparse(null)]


def _sparse(rows: Array) -> Array:
    """Rows that span the same space with as few entries as elimination gives."""
    rows = rows.copy()
    done = 0
    for column in range(rows.shape[1]):
        if done == len(rows):
            break
        best = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[best, column]) < 1e-6:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    rows[np.abs(rows) < 1e-6] = 0
    return rows


def to_hold(groups: Sequence[tuple[str, ...]], order: Sequence[str]) -> dict[str, str]:
    """For each group the first of its numbers in `order` that is not held yet, and why."""
    held: dict[str, str] = {}
    for group in groups:
        free = [n for n in order if n in group and n not in held]
        others = [n for n in group if n != free[0]]
        why = "no motion shows it" if not others else f"only seen together with {', '.join(others)}"
        held[free[0]] = why
    return held


def not_seen(information: Array, scale: Array, names: Sequence[str], vague: float) -> list[str]:
    """Numbers of which the deviation is more than `vague` sizes, the vaguest first. information:
    shape (numbers, numbers). scale: shape (numbers,)."""
    left = list(range(len(names)))
    dropped: list[str] = []
    while left:
        part = information[np.ix_(left, left)] * np.outer(scale[left], scale[left])
        value, vector = np.linalg.eigh(part)
        if value[0] > 1 / vague**2:
            break
        worst = left[int(np.argmax(np.abs(vector[:, 0])))]
        dropped.append(names[worst])
        left.remove(worst)
    return dropped


def deviations(information: Array) -> Array:
    """The deviation of each number for this information; infinite where there is none. information:
    shape (numbers, numbers). The deviations have the shape (numbers,)."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    both = np.outer(scale, scale)
    value, vector = np.linalg.eigh(information / both)
    if value[0] < 1e-12 * value[-1]:
        inverse = np.where(value > 1e-12 * value[-1], 1 / np.maximum(value, 1e-300), np.inf)
        with np.errstate(invalid="ignore"):
            variance = np.nansum(vector**2 * inverse, axis=1)
    else:
        variance = (vector**2 / value).sum(axis=1)
    return np.asarray(np.sqrt(variance) / scale)


SHORTEST, LEAST_STEPS, FAR = 64, 8, 3.0
"""Parts of a window at most for a better first guess, steps of it at least, and the median
distance from the measurements, in deviations, for which it is sought."""


@dataclass(frozen=True)
class Setting:
    """The system, and the lengths of windows and steps, which all logs share."""

    system: System
    motion: MeasuredMotion
    window: float | None
    log: Log

    def __post_init__(self) -> None:
        length, step = lengths(self.system, self.motion, self.log, self.window)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "step", step)

    length: float = math.nan
    step: float = math.nan

    def cut(self, log: Log, motion: MeasuredMotion, part: int = 1) -> Windows:
        """The windows of a log, or of a part of their length, in whole steps."""
        length = self.step * max(round(self.length / part / self.step), 1)
        inputs = [q.name for q in motion.inputs]
        names = commanded_names(self.system, log, inputs)
        windows = windows_of(log, motion.names, names, length, self.step)
        return applied(self.system, windows, names, inputs)

    def beyond_limits(self, log: Log, motion: MeasuredMotion) -> tuple[str, ...]:
        """A sentence for each actuator that is commanded beyond its limits.

        Raises `SimulationError` where one is for most of the log.
        """
        names = commanded_names(self.system, log, [q.name for q in motion.inputs])
        commanded = windows_of(log, motion.names, names, self.length, self.step)
        shares = beyond_limits(self.system, commanded, names)
        sentences = beyond_words(shares)
        for sentence, share in zip(sentences, shares.values(), strict=True):
            if share > MOST_BEYOND:
                raise SimulationError(
                    f"{log.name}: {sentence}",
                    remedy="give the limits of the vehicle of the log, or the unit of its commands",
                )
        return sentences


SHORT_LOOSE = 3.0
"""The same as `LOOSE` in a fit of shorter windows, which is only to give a better guess."""


def first_guess(system: System, name: str) -> float:
    """The number of a parameter, and 0 for a disturbance."""
    return next((float(p.value) for p in system.parameters if p.name == name), 0.0)


Found = tuple[MeasuredMotion, Fitted, Problem]


def fit_of(
    setting: Setting,
    log: Log,
    whole: MeasuredMotion,
    held: dict[str, tuple[str, str]],
    beyond: Sequence[str] = (),
) -> Found:
    """The fit of what the log shows; what it does not show is added to `held`.

    beyond: sentences on commands beyond the limits, for a refusal.

    Where the first guess is far from the measurements within the windows, a fit of shorter ones
    gives a better guess. Where the model diverges in windows of the length that follows from its
    time constants, those of a quarter are taken, and so on. Raises `DivergenceError` where it
    diverges in all of them, or in windows of a length that was given.
    """
    try:
        return _in_turn(setting, log, whole, held)
    except DivergenceError as error:
        if beyond:
            raise DivergenceError(f"{error.cause}; {beyond[0]}", remedy=error.remedy) from None
        raise


def _in_turn(
    setting: Setting, log: Log, whole: MeasuredMotion, held: dict[str, tuple[str, str]]
) -> Found:
    """The fits of windows of growing length, each from the numbers of the one before."""
    part = _near(setting, log, whole, held)
    guess: dict[str, float] = {}
    while True:
        try:
            if part > 1:
                fit = _fit_of(setting, log, whole, dict(held), part, guess, better=True)
            else:
                return _fit_of(setting, log, whole, held, part, guess)
        except DivergenceError:
            if setting.window is not None or not guess:
                raise
            return _fit_of(setting, log, whole, held, 4 * part, guess)
        names = [q.name for q in fit[0].unknown]
        guess = dict(zip(names, fit[1].shared.tolist(), strict=True))
        part //= 4


def _near(
    setting: Setting, log: Log, whole: MeasuredMotion, held: Mapping[str, tuple[str, str]]
) -> int:
    """The part of the length of windows in which the first guess is near the measurements."""
    part = 1
    while True:
        problem, first, _ = _problem(setting, log, whole, held, part, {})
        windows = problem.windows
        start = _begun(problem, first)
        whole_numbers = bool(np.isfinite(start.information).all())
        near = whole_numbers and float(np.median(np.abs(start.residual * start.weight))) < FAR
        if near or part == SHORTEST or windows.steps < 2 * LEAST_STEPS:
            return part
        part *= 4


def _fit_of(
    setting: Setting,
    log: Log,
    whole: MeasuredMotion,
    held: dict[str, tuple[str, str]],
    part: int,
    guess: Mapping[str, float],
    *,
    better: bool = False,
) -> Found:
    """The fit of windows of a part of the length, of the numbers that they show.

    better: a better guess is all that it is for.
    """
    while True:
        problem, first, lower = _problem(setting, log, whole, held, part, guess)
        motion, names = problem.shooting.motion, [q.name for q in problem.shooting.motion.unknown]
        start = _begun(problem, first)
        if not np.isfinite(start.information).all():
            raise DivergenceError(
                f"the model diverges within {problem.windows.length:.3g} s from its first numbers",
                remedy="begin with better ones, or take a shorter window",
            )
        scale = np.where(first == 0, _sizes(start), np.abs(first))
        dropped = not_seen(start.information, scale, names, HOPELESS)
        if not dropped:
            fit = fitted(problem, first, lower, loose=SHORT_LOOSE if better else LOOSE)
            if better:
                return motion, fit, problem
            dropped = not_seen(
                problem.information_without_noise(fit),
                np.maximum(scale, np.abs(fit.shared)),
                names,
                VAGUE,
            )
            if not dropped:
                return motion, fit, problem
            guess = {**guess, **dict(zip(names, fit.shared.tolist(), strict=True))}
        held |= dict.fromkeys(dropped, (UNSEEN, "this log does not show it"))


def _problem(
    setting: Setting,
    log: Log,
    whole: MeasuredMotion,
    held: Mapping[str, tuple[str, str]],
    part: int,
    guess: Mapping[str, float],
) -> tuple[Problem, Array, Array]:
    """What is fitted, with the first guess and the lower limit of each number."""
    system = setting.system
    free = [q.name for q in whole.unknown if q.name not in held]
    fixed = {q.symbol: sp.S.Zero for q in system.disturbances if q.name not in free}
    outputs = zip(whole.names, whole.outputs, strict=True)
    motion = measured_motion(system, whole.names, free, {n: e.xreplace(fixed) for n, e in outputs})
    names = [q.name for q in motion.unknown]
    first = np.array([guess.get(n, first_guess(system, n)) for n in names])
    limits = {p.name: p.above for p in system.parameters}
    lower = np.array([limits.get(n, -math.inf) for n in names])
    windows = setting.cut(log, whole, part)
    return Problem(Shooting(motion), windows, first, range(len(first))), first, lower


def _begun(problem: Problem, first: Array) -> Fitted:
    """The first guess, with the first states that fit it best."""
    windows = problem.windows
    noise = first_noise(windows, len(problem.shooting.motion.names))
    return problem.settle(first, problem.first_local(), 1 / noise[windows.signal])


def _sizes(start: Fitted) -> Array:
    """Sizes of numbers without a first guess: a hundred deviations, since 0 is no measure."""
    strength = np.sqrt(np.maximum(np.diag(start.information), 0.0))
    return np.where(strength > 0, 100 / np.maximum(strength, 1e-300), 1.0)


def spread_of(fit: Fitted, windows: Windows) -> Array:
    """The deviation of each shared number: of independent noise or of windows, the larger: shape
    (shared numbers,)."""
    if not fit.shared.size:
        return np.empty(0)
    covariance = np.linalg.pinv(fit.information, hermitian=True)
    pull = np.zeros((windows.count, len(fit.shared)))
    np.add.at(pull, windows.window, fit.slopes * (fit.weight * fit.residual)[:, None])
    free = max(windows.count - len(fit.shared), 1)
    robust = covariance @ (pull.T @ pull) @ covariance * windows.count / free
    return np.sqrt(np.maximum(np.diag(covariance), np.diag(robust)))
