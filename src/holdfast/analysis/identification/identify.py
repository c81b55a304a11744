"""Parameters of a system from a log of its motion: with intervals, and what they leave out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy as sp
from scipy.stats import t as student

from holdfast.analysis.identification import manoeuvres, observability, unexplained
from holdfast.analysis.identification.fit import Setting, first_guess, fit_of, spread_of
from holdfast.analysis.identification.identified import (
    AT_LIMIT,
    GIVEN,
    IDENTIFIED,
    TIED,
    UNSEEN,
    WIDE,
    Estimate,
    HeldOut,
    Identified,
    Unexplained,
)
from holdfast.analysis.identification.least_squares import (
    Fitted,
    Problem,
    fitted,
)
from holdfast.analysis.identification.log import Floats, Log
from holdfast.analysis.identification.noise import HUBER
from holdfast.analysis.identification.remarks import (
    refuse_no_commands,
    refuse_other_way,
    remarks,
)
from holdfast.analysis.identification.shooting import Shooting
from holdfast.arguments import checked
from holdfast.errors import SimulationError, suggestion
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.system import System
from holdfast.maths.identification.measured_motion import MeasuredMotion, measured_motion


@checked
def identify(
    system: System,
    log: Log,
    *,
    held_out: Log | None = None,
    estimate: Sequence[str] = (),
    hold: Sequence[str] = (),
    outputs: Mapping[str, sp.Expr] | None = None,
    unexplained_rates: Sequence[str] = (),
    level: float = 0.95,
    window: float | None = None,
    widen: float = 1.5,
) -> Identified:
    """Parameters p and constant disturbances d of a system from a log, with intervals.

        minimise  sum_k rho((y_k - h(x(t_k), d)) / sigma),    xdot = f(x, u, d; p)

    over p, d and the first states of short windows (multiple shooting, H. G. Bock, 1981), with
    Huber's rho and the noise sigma of each signal estimated. The model's own numbers are the
    first guess. The interval of a number is that of Student's t for the larger of two deviations:
    for independent noise, and for errors that are alike within a window (cluster-robust,
    K.-Y. Liang and S. L. Zeger, 1986).

    estimate: parameters, by default all that the measurements depend on; hold: those that keep
    their numbers. Of numbers that are seen only in combination the first declared is held; a number
    that the log does not show is held. Both are said, with the manoeuvre that would show it.
    outputs: what a signal measures where it is not the state of its name, such as
    {"u": u + Vx*cos(psi) + Vy*sin(psi)} for a speed over ground.

    What is left unexplained is a bound on additional rates, constant in windows, of the states
    whose rates have inputs or parameters (`unexplained_rates`: others): the box of what the windows
    needed, `widen` times as large. held_out: a second log, for which the same is computed and
    compared; the parameters do not see it. level: of the intervals. window [s]: by default three
    times the slowest time constant of the model, within a thirtieth of the log.

    Raises `SimulationError` for a log that is too short or lacks signals, unknown names, arguments
    out of range, and a model that diverges; `DefinitionError` for outputs that are not declared.
    """
    _check(level, window, widen, log)
    estimate, hold, unexplained_rates = map(tuple, (estimate, hold, unexplained_rates))
    named = list(log.states)
    chosen = _wanted(system, estimate, hold)
    whole = measured_motion(system, named, [*chosen, *system.disturbance_names], outputs)
    setting = Setting(system, whole, window, log)
    unexplained.pushed_motion(system, whole, unexplained_rates or None)
    if held_out and (missing := [n for n in named if n not in held_out.states]):
        raise SimulationError(
            f"{held_out.name} has no signal '{missing[0]}'", expected=", ".join(named)
        )
    beyond = setting.beyond_limits(log, whole)
    refuse_no_commands(whole, setting.cut(log, whole))
    first = np.array([first_guess(system, q.name) for q in whole.unknown])
    held = dict.fromkeys(hold, (GIVEN, "held on request"))
    groups = observability.ties(whole, first)
    order = [q.name for q in whole.unknown]
    held |= {n: (TIED, why) for n, why in observability.to_hold(groups, order).items()}
    motion, fit, problem = fit_of(setting, log, whole, held, beyond)
    windows = problem.windows
    if windows.length < setting.length * (1 - 1e-9):
        setting = replace(setting, window=windows.length)
    spread, count = spread_of(fit, windows), windows.count
    quantile = float(student.ppf((1 + level) / 2, max(count - len(motion.unknown), 1)))
    found = {q.name: k for k, q in enumerate(motion.unknown)}
    best = {n: float(fit.shared[k]) for n, k in found.items()}
    numbers = tuple(replace(p, value=best.get(p.name, p.value)) for p in system.parameters)
    own = replace(system, parameters=numbers)
    refuse_other_way(system, own, motion)
    still = {n: best.get(n, 0.0) for n in system.disturbance_names}
    told = {
        q.name: _estimate(q, first_guess(system, q.name), best, found, spread, quantile, held)
        for q in (*system.parameters, *system.disturbances)
        if q.name in order or q.name in hold
    }
    bound, second = _left(
        own, setting, whole, log, held_out, fit.noise, still, unexplained_rates, widen
    )
    advised = manoeuvres.advised(own, whole, windows, fit, told, quantile)
    measured = _shown(problem, fit)
    return Identified(
        system=own,
        log=log.name,
        parameters=tuple(advised[p.name] for p in system.parameters if p.name in advised),
        disturbances=tuple(advised[q.name] for q in system.disturbances if q.name in advised),
        unexplained=bound,
        held_out=second,
        noise=dict(zip(whole.names, fit.noise.tolist(), strict=True)),
        outliers=float(np.mean(np.abs(fit.residual) > HUBER * fit.noise[windows.signal])),
        window=windows.length,
        step=windows.step,
        windows=count,
        left_out=windows.left_out,
        level=level,
        ties=tuple(f"only a combination of {', '.join(g)} is seen" for g in groups if len(g) > 1),
        repairs=(*log.repairs, *beyond),
        remarks=remarks(motion, windows, fit, advised, bound),
        measured=measured,
    )


def _check(level: float, window: float | None, widen: float, log: Log) -> None:
    if not 0 < level < 1:
        raise SimulationError(
            f"level is {level}", expected="a number between 0 and 1, such as 0.95"
        )
    if window is not None and not (math.isfinite(window) and window > 0):
        raise SimulationError(f"window is {window}", expected="seconds, above 0")
    if not (math.isfinite(widen) and widen >= 1):
        raise SimulationError(f"widen is {widen}", expected="a number of at least 1")
    if not log.states:
        raise SimulationError(f"{log.name} has no signal of a state")


def _wanted(system: System, estimate: Sequence[str], hold: Sequence[str]) -> list[str]:
    """The parameters that are estimated if the log shows them."""
    known = [p.name for p in system.parameters]
    for name in (*estimate, *hold):
        if name not in known:
            raise SimulationError(
                f"system '{system.name}' has no parameter '{name}'", remedy=suggestion(name, known)
            )
    if both := set(estimate) & set(hold):
        raise SimulationError(f"'{min(both)}' is to be estimated and to be held")
    return [n for n in (estimate or known) if n not in hold]


def _estimate(
    q: object,
    before: float,
    best: Mapping[str, float],
    found: Mapping[str, int],
    spread: Floats,
    quantile: float,
    held: Mapping[str, tuple[str, str]],
) -> Estimate:
    name, unit = q.name, q.unit  # type: ignore[attr-defined]
    if name not in best:
        status, why = held.get(name, (UNSEEN, "no measurement depends on it"))
        return Estimate(name, unit, before, before, math.nan, math.nan, status, why)
    value, half = best[name], quantile * float(spread[found[name]])
    status, why = IDENTIFIED, ""
    if isinstance(q, Parameter) and half >= abs(value):
        status, why = WIDE, "its interval is wider than itself"
    if isinstance(q, Parameter) and value <= q.above + 1e-9 * abs(before):
        status, why = AT_LIMIT, f"the log wants {q.above:g} or less"
    return Estimate(name, unit, before, value, value - half, value + half, status, why)


def _left(
    own: System,
    setting: Setting,
    whole: MeasuredMotion,
    log: Log,
    held_out: Log | None,
    noise: Floats,
    still: Mapping[str, float],
    chosen: Sequence[str],
    widen: float,
) -> tuple[Unexplained, HeldOut | None]:
    """The bound on what is unexplained, and what a second log says of it."""
    motion = unexplained.pushed_motion(own, whole, chosen or None)
    shooting = Shooting(motion)
    parts = [p for p in unexplained.SHORTER if setting.length / p >= 8 * setting.step] or [1]
    cuts = [setting.cut(log, motion, p) for p in parts]
    found = unexplained.needed(shooting, own, cuts, noise, still, log.name)
    bound = unexplained.bounded(found, widen)
    if held_out is None:
        return bound, None
    part = next(p for p, cut in zip(parts, cuts, strict=True) if cut.length == found.length)
    moved, error = _still(own, setting, whole, held_out, noise)
    windows = [setting.cut(held_out, motion, part)]
    again = unexplained.needed(shooting, own, windows, noise, moved, held_out.name)
    return bound, unexplained.compared(held_out.name, again, bound, error)


def _still(
    own: System, setting: Setting, whole: MeasuredMotion, log: Log, noise: Floats
) -> tuple[dict[str, float], dict[str, float]]:
    """The constant disturbances of a second log, and its errors of prediction over a window."""
    here = [q.name for q in whole.unknown if q.name in own.disturbance_names]
    outputs = dict(zip(whole.names, whole.outputs, strict=True))
    motion = measured_motion(own, whole.names, here, outputs)
    windows = setting.cut(log, motion)
    shooting = Shooting(motion)
    zero = np.zeros(len(here))
    problem = Problem(shooting, windows, zero, range(len(here)))
    found = fitted(problem, zero, np.full(len(here), -np.inf), noise=noise)
    rms = {
        n: float(np.sqrt(np.mean(found.residual[windows.signal == k] ** 2)) / noise[k])
        for k, n in enumerate(whole.names)
        if (windows.signal == k).any()
    }
    return dict(zip(here, found.shared.tolist(), strict=True)), rms


def _shown(problem: Problem, fit: Fitted) -> dict[str, tuple[Floats, Floats, Floats]]:
    """(time, measured, predicted) of each signal."""
    w = problem.windows
    names = problem.shooting.motion.names
    return {
        n: (w.time[of], w.value[of], w.value[of] - fit.residual[of])
        for k, n in enumerate(names)
        if (of := w.signal == k).any()
    }
