"""The fit of a log: windows of a length that follows from the model, and what the log shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import sympy as sp

from holdfast.analysis.identification import observability
from holdfast.analysis.identification.commands import applied, commanded_names
from holdfast.analysis.identification.identified import UNSEEN
from holdfast.analysis.identification.least_squares import (
    Fitted,
    Problem,
    first_noise,
    fitted,
)
from holdfast.analysis.identification.log import Floats, Log
from holdfast.analysis.identification.shooting import Shooting
from holdfast.analysis.identification.time_scales import lengths
from holdfast.analysis.identification.windows import Windows, windows_of
from holdfast.errors import SimulationError
from holdfast.maths.definitions.system import System
from holdfast.maths.identification.measured_motion import MeasuredMotion, measured_motion

SHORTEST, LEAST_STEPS, FAR = 64, 8, 10.0
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
        """The windows of a log, or of a part of their length."""
        inputs = [q.name for q in motion.inputs]
        names = commanded_names(self.system, log, inputs)
        found = windows_of(log, motion.names, names, self.length / part, self.step)
        return applied(self.system, found, names, inputs)


def first_guess(system: System, name: str) -> float:
    """The number of a parameter, and 0 for a disturbance."""
    return next((float(p.value) for p in system.parameters if p.name == name), 0.0)


def fit_of(
    setting: Setting,
    log: Log,
    whole: MeasuredMotion,
    held: dict[str, tuple[str, str]],
) -> tuple[MeasuredMotion, Fitted, Problem]:
    """The fit of what the log shows; what it does not show is added to `held`.

    Where the first guess is far from the measurements within the windows, a fit of shorter ones
    gives a better guess.
    """
    system = setting.system
    limits = {p.name: p.above for p in system.parameters}
    better: dict[str, float] = {}
    parts = [1]
    windows = setting.cut(log, whole)
    outputs = dict(zip(whole.names, whole.outputs, strict=True))
    while True:
        free = [q.name for q in whole.unknown if q.name not in held]
        fixed = {q.symbol: sp.S.Zero for q in system.disturbances if q.name not in free}
        motion = measured_motion(
            system, whole.names, free, {n: e.xreplace(fixed) for n, e in outputs.items()}
        )
        shooting = Shooting(motion)
        names = [q.name for q in motion.unknown]
        first = np.array([better.get(n, first_guess(system, n)) for n in names])
        lower = np.array([limits.get(n, -math.inf) for n in names])
        problem = Problem(shooting, windows, first, range(len(first)))
        noise = first_noise(windows, len(motion.names))
        start = problem.settle(first, problem.first_local(), 1 / noise[windows.signal])
        whole_numbers = bool(np.isfinite(start.information).all())
        near = whole_numbers and float(np.median(np.abs(start.residual * start.weight))) < FAR
        if not near and not better and parts[-1] < SHORTEST and windows.steps >= 2 * LEAST_STEPS:
            parts.append(4 * parts[-1])
            windows = setting.cut(log, whole, parts[-1])
            continue
        if not whole_numbers:
            raise SimulationError(
                f"the model diverges within {windows.length:.3g} s from its first numbers",
                remedy="begin with better ones, or take a shorter window",
            )
        scale = np.where(first == 0, _sizes(start), np.abs(first))
        dropped = observability.not_seen(start.information, scale, names, observability.HOPELESS)
        if not dropped:
            found = fitted(problem, first, lower)
            better = dict(zip(names, found.shared.tolist(), strict=True))
            if len(parts) > 1:
                parts.pop()
                windows = setting.cut(log, whole, parts[-1])
                continue
            dropped = observability.not_seen(
                problem.information_without_noise(found),
                np.maximum(scale, np.abs(found.shared)),
                names,
                observability.VAGUE,
            )
            if not dropped:
                return motion, found, problem
        held |= dict.fromkeys(dropped, (UNSEEN, "this log does not show it"))


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
