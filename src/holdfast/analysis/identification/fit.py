"""The fit of a log: windows of a length that follows from the model, and what the log shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from holdfast.analysis.identification import observability
from holdfast.analysis.identification.commands import (
    MOST_BEYOND,
    applied,
    beyond_limits,
    beyond_words,
    commanded_names,
)
from holdfast.analysis.identification.identified import UNSEEN
from holdfast.analysis.identification.least_squares import (
    LOOSE,
    DivergenceError,
    Fitted,
    Problem,
    fitted,
)
from holdfast.analysis.identification.log import Floats, Log
from holdfast.analysis.identification.noise import first_noise
from holdfast.analysis.identification.shooting import Shooting
from holdfast.analysis.identification.time_scales import lengths
from holdfast.analysis.identification.windows import Windows, windows_of
from holdfast.errors import SimulationError
from holdfast.maths.definitions.system import System
from holdfast.maths.identification.measured_motion import MeasuredMotion, measured_motion

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
        found = windows_of(log, motion.names, names, length, self.step)
        return applied(self.system, found, names, inputs)

    def beyond_limits(self, log: Log, motion: MeasuredMotion) -> tuple[str, ...]:
        """A sentence for each actuator that is commanded beyond its limits.

        Raises `SimulationError` where one is for most of the log.
        """
        names = commanded_names(self.system, log, [q.name for q in motion.inputs])
        commanded = windows_of(log, motion.names, names, self.length, self.step)
        shares = beyond_limits(self.system, commanded, names)
        told = beyond_words(shares)
        for sentence, share in zip(told, shares.values(), strict=True):
            if share > MOST_BEYOND:
                raise SimulationError(
                    f"{log.name}: {sentence}",
                    remedy="give the limits of the vehicle of the log, or the unit of its commands",
                )
        return told


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
                found = _fit_of(setting, log, whole, dict(held), part, guess, better=True)
            else:
                return _fit_of(setting, log, whole, held, part, guess)
        except DivergenceError:
            if setting.window is not None or not guess:
                raise
            return _fit_of(setting, log, whole, held, 4 * part, guess)
        names = [q.name for q in found[0].unknown]
        guess = dict(zip(names, found[1].shared.tolist(), strict=True))
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
        dropped = observability.not_seen(start.information, scale, names, observability.HOPELESS)
        if not dropped:
            found = fitted(problem, first, lower, loose=SHORT_LOOSE if better else LOOSE)
            if better:
                return motion, found, problem
            dropped = observability.not_seen(
                problem.information_without_noise(found),
                np.maximum(scale, np.abs(found.shared)),
                names,
                observability.VAGUE,
            )
            if not dropped:
                return motion, found, problem
            guess = {**guess, **dict(zip(names, found.shared.tolist(), strict=True))}
        held |= dict.fromkeys(dropped, (UNSEEN, "this log does not show it"))


def _problem(
    setting: Setting,
    log: Log,
    whole: MeasuredMotion,
    held: Mapping[str, tuple[str, str]],
    part: int,
    guess: Mapping[str, float],
) -> tuple[Problem, Floats, Floats]:
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


def _begun(problem: Problem, first: Floats) -> Fitted:
    """The first guess, with the first states that fit it best."""
    windows = problem.windows
    noise = first_noise(windows, len(problem.shooting.motion.names))
    return problem.settle(first, problem.first_local(), 1 / noise[windows.signal])


def _sizes(start: Fitted) -> Floats:
    """Sizes of numbers without a first guess: a hundred deviations, since 0 is no measure."""
    strength = np.sqrt(np.maximum(np.diag(start.information), 0.0))
    return np.where(strength > 0, 100 / np.maximum(strength, 1e-300), 1.0)


def spread_of(fit: Fitted, windows: Windows) -> Floats:
    """The deviation of each shared number: of independent noise or of windows, the larger."""
    if not fit.shared.size:
        return np.empty(0)
    covariance = np.linalg.pinv(fit.information, hermitian=True)
    pull = np.zeros((windows.count, len(fit.shared)))
    np.add.at(pull, windows.window, fit.slopes * (fit.weight * fit.residual)[:, None])
    free = max(windows.count - len(fit.shared), 1)
    robust = covariance @ (pull.T @ pull) @ covariance * windows.count / free
    return np.sqrt(np.maximum(np.diag(covariance), np.diag(robust)))
