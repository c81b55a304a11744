"""Parameters of a system from a log of its motion: with intervals, and what they leave out.

What the model leaves unexplained is a disturbance set: rates within bounds. Remarks say why numbers
may be wrong although their intervals are narrow, which numbers cannot be, and which manoeuvre would
show what the log does not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp
from scipy.stats import t as student

from holdfast.analysis.identification.fit import (
    AT_LIMIT,
    GIVEN,
    IDENTIFIED,
    TIED,
    UNSEEN,
    WIDE,
    Estimate,
    HeldOut,
    Identified,
    Setting,
    Unexplained,
    deviations,
    first_guess,
    fit_of,
    spread_of,
    ties,
    to_hold,
)
from holdfast.analysis.identification.least_squares import Fitted, Problem, Shooting, fitted
from holdfast.analysis.identification.log import FEWEST, HUBER, Log, Windows, applied, first_noise
from holdfast.arguments import checked
from holdfast.errors import SimulationError, check_name
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.execution.trajectories import Trajectories
from holdfast.maths.control.unmodelled import PREFIX, add_unmodelled
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.extension import per_second
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.numeric import evaluated
from holdfast.maths.expressions.traversal import derivatives, symbols_of
from holdfast.maths.identification import MeasuredMotion, measured_motion

NOISY, EXPLAINED, SMALL_BOX = 3.0, 0.5, 20
"""The residuals of a signal in parts of the noise between neighbours, the part of what is left
unexplained that noise has to explain, and the windows of a log, from which nothing is said."""


def refuse_no_commands(motion: MeasuredMotion, windows: Windows) -> None:
    """Raises `SimulationError` where all commands are 0: nothing tells force from inertia."""
    if motion.inputs and len(_absent(motion, windows)) == len(motion.inputs):
        raise SimulationError(
            f"{', '.join(q.name for q in motion.inputs)} are 0 throughout the log",
            expected="the commands that moved the vehicle",
        )


def refuse_other_way(before: System, after: System, motion: MeasuredMotion) -> None:
    """Raises `SimulationError` where an input moves a state the other way than before, at rest.

    The inertia that fits has another sign then: no vehicle has it.
    """
    states = [q.name for q in motion.states]
    inputs = [q.symbol for q in motion.inputs]
    symbols = [q.symbol for q in (*after.states, *after.inputs, *after.disturbances)]
    slopes = [derivatives(after.rates[name], inputs) for name in states]
    flat = [slope[s] for slope in slopes for s in inputs]
    if not flat:
        return
    at = np.zeros((1, len(symbols)))
    old, new = (
        Evaluator(flat, symbols, s.parameters).values(at).reshape(len(states), -1)
        for s in (before, after)
    )
    size = np.abs(old).max(axis=0, initial=0.0)
    for i, j in zip(*np.nonzero((old * new < 0) & (np.abs(old) > 0.1 * size)), strict=True):
        raise SimulationError(
            f"the numbers that fit make {motion.inputs[j].name} move {states[i]} the other way: "
            f"{new[i, j]:.3g} {motion.states[i].unit}/s for 1 {motion.inputs[j].unit}, "
            f"not {old[i, j]:.3g}",
            expected="commands in the sign, the unit and at the time in which they acted",
        )


def remarks(
    motion: MeasuredMotion,
    windows: Windows,
    fit: Fitted,
    estimates: Mapping[str, Estimate],
    bound: Unexplained,
) -> tuple[str, ...]:
    """What a reader of the intervals has to know beside them."""
    sentences: list[str] = []
    if not fit.settled:
        sentences.append("the fit did not settle: begin with better numbers, or estimate fewer")
    sentences += _absent(motion, windows)
    sentences += _noisy(motion.names, windows, fit.noise)
    for e in estimates.values():
        if e.status == IDENTIFIED and e.before * e.value < 0 and e.low * e.high > 0:
            sentences.append(f"{e.name} has the other sign than before")
    shares = zip(bound.names, bound.noise_share, strict=True)
    if more := [n for n, share in shares if share < EXPLAINED]:
        sentences.append(
            f"noise is less than half of what is left unexplained of {', '.join(more)}: the model "
            "lacks something (an effect, a delay, a unit), which intervals do not count"
        )
    if windows.count < SMALL_BOX:
        sentences.append(f"intervals and bound are those of {windows.count} windows only")
    return tuple(sentences)


def _absent(motion: MeasuredMotion, windows: Windows) -> list[str]:
    size = np.abs(windows.inputs).max(axis=(0, 1), initial=0.0)
    least = 1e-9 * size.max(initial=0.0)  # what an allocation rounds
    absent = zip(motion.inputs, size, strict=True)
    return [f"{q.name} is 0 throughout" for q, most in absent if most <= least]


def _noisy(names: Sequence[str], windows: Windows, noise: Array) -> list[str]:
    usual = first_noise(windows, len(names))
    return [
        f"{n} is {float(f'{now / before:.2g}'):g} times as far from the model as its values from "
        "their neighbours: its unit, its time or the model is wrong"
        for n, now, before in zip(names, noise, usual, strict=True)
        if now > NOISY * before
    ]


SHORTER = (8, 4, 2, 1)
"""Parts of a window over which what is unexplained is constant, the shortest first."""

DOUBT = 2.0
"""Deviations of the noise by which what a window needs may lie beyond the bound."""

JUDGED = 0.5
"""The part of the windows that has to have enough measurements."""

MOST_NOISE = 0.5
"""The part of its spread that noise may give what is unexplained, for a shorter window."""


def pushed_motion(
    system: System, motion: MeasuredMotion, chosen: Sequence[str] | None
) -> MeasuredMotion:
    """The motion with unknown parts of rates: those of `chosen` states.

    By default of the states whose rates have an input or a parameter; of all where there is none.
    """
    states = [q.name for q in motion.states]
    if chosen is None:
        movers = {q.symbol for q in motion.inputs}
        movers |= {p.symbol for p in system.parameters}
        chosen = [n for n in states if symbols_of([system.rates[n]]) & movers] or states
    if missing := [n for n in chosen if n not in states]:
        raise SimulationError(
            f"the log says nothing of '{missing[0]}'", expected="some of " + ", ".join(states)
        )
    free = Box((-1.0,) * len(chosen), (1.0,) * len(chosen))
    pushed = add_unmodelled(system, chosen, free)
    present = {q.name for q in motion.unknown}
    disturbances = [n for n in system.disturbance_names if n in present]
    outputs = dict(zip(motion.names, motion.outputs, strict=True))
    return measured_motion(
        pushed, motion.names, [*(PREFIX + n for n in chosen), *disturbances], outputs
    )


def needed(
    shooting: Shooting,
    system: System,
    windows: Sequence[Windows],
    noise: Array,
    still: Mapping[str, float],
    log: str,
) -> Unexplained:
    """What the windows need, for the shortest ones in which noise is not most of it.

    windows: of one log, the shortest first. still: the constant disturbances of the log. Raises
    `SimulationError` where half of the windows have too few measurements to tell.

    noise: of each signal, shape (signals,).
    """
    motion = shooting.motion
    local = [k for k, q in enumerate(motion.unknown) if q.name.startswith(PREFIX)]
    values = np.array([still.get(q.name, 0.0) for q in motion.unknown])
    names = tuple(motion.unknown[k].name.removeprefix(PREFIX) for k in local)
    units = {q.name: per_second(q.unit) for q in system.states}
    unexplained = None
    for some in windows:
        problem = Problem(shooting, some, values, (), local)
        fit: Fitted = fitted(problem, np.empty(0), np.empty(0), noise=noise)
        shown = problem.determined(fit)
        if shown.sum() < max(FEWEST, JUDGED * len(shown)):
            continue
        n = shooting.states
        unexplained = Unexplained(
            names,
            tuple(units[name] for name in names),
            (),
            (),
            fit.local[shown, n:],
            np.sqrt(np.einsum("wii->wi", fit.spread)[shown, n:]),
            some.start[shown],
            some.length,
            int((~shown).sum()),
        )
        if max(unexplained.noise_share, default=0.0) <= MOST_NOISE:
            break
    if unexplained is None:
        raise SimulationError(
            f"{log}: the measurements of a window of {windows[-1].length:.3g} s do not show what "
            "the model leaves unexplained",
            remedy="take longer windows, or a log with more measurements",
        )
    return unexplained


def bounded(unexplained: Unexplained, widen: float) -> Unexplained:
    """The box around all that was needed, each half-width `widen` times as large."""
    least, most = unexplained.value.min(axis=0), unexplained.value.max(axis=0)
    middle, half = (least + most) / 2, (most - least) / 2 * widen
    return replace(
        unexplained, low=tuple((middle - half).tolist()), high=tuple((middle + half).tolist())
    )


def compared(
    name: str, second: Unexplained, bound: Unexplained, error: Mapping[str, float]
) -> HeldOut:
    """A second log beside the bound of the first."""
    low, high = np.array(bound.low), np.array(bound.high)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-300)
    distance = np.abs(second.value - middle)
    away = distance / half
    surely = (distance - DOUBT * second.by_noise) / half
    return HeldOut(
        name,
        second,
        int((surely > 1.0).any(axis=1).sum()),
        int((away > 1.0).any(axis=1).sum()),
        tuple(away.max(axis=0).tolist()),
        dict(error),
    )


STRENGTH = 0.6
"""The part of its limit that an input has in a manoeuvre."""

MOST_USEFUL = 1.0
"""The half-width, in parts of the number, below which a manoeuvre is worth saying."""


@dataclass(frozen=True)
class Manoeuvre:
    """Inputs over steps, shape (steps, inputs), and what they are in words."""

    words: str
    inputs: Array


def advised(
    system: System,
    whole: MeasuredMotion,
    windows: Windows,
    fit: Fitted,
    estimates: Mapping[str, Estimate],
    quantile: float,
) -> dict[str, Estimate]:
    """The estimates, those that are not seen or wide with the manoeuvre that would show them.

    Of steps, steps about a held input, and steps from rest, as long as the log and from rest: the
    one after which the log and it together give the narrowest interval, by the information that the
    model predicts.
    """
    weak = [e for e in estimates.values() if e.status in (WIDE, UNSEEN)]
    if not weak or not whole.inputs:
        return dict(estimates)
    names = [q.name for q in whole.unknown if estimates[q.name].status not in (TIED, "given")]
    outputs = dict(zip(whole.names, whole.outputs, strict=True))
    motion = measured_motion(system, whole.names, names, outputs)
    shooting = Shooting(motion)
    values = np.array([estimates[q.name].value for q in motion.unknown])
    problem = Problem(shooting, windows, values, range(len(values)))
    information = problem.settle(values, problem.first_local(), fit.weight).information
    best: dict[str, tuple[float, str]] = {}
    trials = list(_manoeuvres(system, motion, windows))
    planned = _planned(system, motion, windows, trials)
    paths = trajectories(motion, planned, values, windows.step)
    for trial, inputs, path in zip(trials, planned, paths, strict=True):
        added = _information(shooting, windows, fit, values, inputs, path)
        if added is None:
            continue
        spread = deviations(information + added)
        for k, q in enumerate(motion.unknown):
            if float(spread[k]) < best.get(q.name, (math.inf, ""))[0]:
                best[q.name] = float(spread[k]), trial.words
    return {n: _with_advice(e, best, quantile, windows) for n, e in estimates.items()}


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


def _manoeuvres(system: System, motion: MeasuredMotion, windows: Windows) -> Iterator[Manoeuvre]:
    """Steps of each input, alone or about another one that is held."""
    names = [q.name for q in motion.inputs]
    units = [q.unit for q in motion.inputs]
    most = _amplitudes(system, names, windows)
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


def _amplitudes(system: System, names: list[str], windows: Windows) -> list[float]:
    """A part of what each input can be; of the largest that the log has where it has no limit."""
    bounds = system.input_bounds.ranges() if system.input_bounds else [()] * len(system.input_names)
    ranges = dict(zip(system.input_names, bounds, strict=True))
    values = {p.symbol: p.value for p in system.parameters}
    amplitudes = []
    for k, name in enumerate(names):
        ends = evaluated(ranges[name], values)
        limit = min((abs(e) for e in ends), default=math.inf)
        used = float(np.abs(windows.inputs[:, :, k]).max(initial=0.0))
        amplitudes.append(STRENGTH * limit if math.isfinite(limit) and limit > 0 else used or 1.0)
    return amplitudes


def _planned(
    system: System, motion: MeasuredMotion, windows: Windows, trials: Sequence[Manoeuvre]
) -> Array:
    """The inputs that each manoeuvre gives within the limits, shape (manoeuvres, steps, inputs)."""
    names = [q.name for q in motion.inputs]
    inputs = np.stack([trial.inputs for trial in trials])
    if len(names) < len(system.input_names):
        return inputs
    shape = (-1, windows.steps, len(names))
    limited = applied(
        system, replace(windows, inputs=inputs.reshape(shape)), system.input_names, names
    )
    return limited.inputs.reshape(inputs.shape)


def _information(
    shooting: Shooting, windows: Windows, fit: Fitted, values: Array, inputs: Array, path: Array
) -> Array | None:
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
    predicted, _, _ = problem.predict(values, path[:-1:steps])
    problem.windows = replace(planned, value=predicted.value)
    settled = problem.settle(values, path[:-1:steps], weight)
    return settled.information if np.isfinite(settled.slopes).all() else None


def trajectories(motion: MeasuredMotion, inputs: Array, values: Array, step: float) -> Array:
    """States from rest at the nodes of steps with these inputs.

    inputs: shape (manoeuvres, steps, inputs). Shape (manoeuvres, steps + 1, states).
    """
    x, u, v = ([q.symbol for q in g] for g in (motion.states, motion.inputs, motion.unknown))
    paths = Trajectories(list(motion.rates), x, u, v, motion.parameters)
    first = np.zeros((len(inputs), len(x)))
    with np.errstate(over="ignore", invalid="ignore"):
        nodes, _ = paths.nodes(first, inputs, np.tile(values, (len(inputs), 1)), step)
    return nodes.transpose(2, 0, 1)


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

    log: a `Log`, read from a file or made by hand. estimate: parameters, by default all that the
    measurements depend on; hold: those that keep their numbers. Of numbers that are seen only in
    combination the first declared is held; a number that the log does not show is held. Both are
    said, with the manoeuvre that would show it. outputs: what a signal measures where it is not the
    state of its name, such as {"u": u + Vx*cos(psi) + Vy*sin(psi)} for a speed over ground.

    What is left unexplained is a bound on additional rates, constant in windows, of the states
    whose rates have inputs or parameters: the box of what the windows needed. unexplained_rates:
    other states in their place. widen: how many times as large the box is made. held_out: a second
    log, for which the same is computed and compared; the parameters do not see it. level: of the
    intervals. window [s]: by default three times the slowest time constant of the model, within a
    thirtieth of the log.

    Raises `SimulationError` for a log that is too short or lacks signals, unknown names, arguments
    out of range, and a model that diverges; `DefinitionError` for outputs that are not declared.

    >>> drag = hf.Parameter("drag", "1/s", value=0.5)
    >>> sled = replace(cart, parameters=(drag,), rates={"x": v, "v": "a - drag*v"})
    >>> times = np.arange(0.0, 20.0, 0.1)
    >>> speed = 2.5 * (1 - np.exp(-0.2 * times)) + 0.01 * np.sin(40 * times)
    >>> pushed = {"a": hf.Signal(times, np.full(200, 0.5))}
    >>> log = hf.Log("push", {"v": hf.Signal(times, speed)}, pushed, gap=1.0)
    >>> round(hf.identify(sled, log).parameters[0].value, 3)
    0.2
    """
    _check(level, window, widen, log)
    estimate, hold, unexplained_rates = map(tuple, (estimate, hold, unexplained_rates))
    named = list(log.states)
    chosen = _wanted(system, estimate, hold)
    whole = measured_motion(system, named, [*chosen, *system.disturbance_names], outputs)
    setting = Setting(system, whole, window, log)
    pushed_motion(system, whole, unexplained_rates or None)
    if held_out and (missing := [n for n in named if n not in held_out.states]):
        raise SimulationError(
            f"{held_out.name} has no signal '{missing[0]}'", expected=", ".join(named)
        )
    beyond = setting.beyond_limits(log, whole)
    refuse_no_commands(whole, setting.cut(log, whole))
    first = np.array([first_guess(system, q.name) for q in whole.unknown])
    held = dict.fromkeys(hold, (GIVEN, "held on request"))
    groups = ties(whole, first)
    order = [q.name for q in whole.unknown]
    held |= {n: (TIED, why) for n, why in to_hold(groups, order).items()}
    motion, fit, problem = fit_of(setting, log, whole, held, beyond)
    windows = problem.windows
    if windows.length < setting.length * (1 - 1e-9):
        setting = replace(setting, window=windows.length)
    spread, count = spread_of(fit, windows), windows.count
    quantile = float(student.ppf((1 + level) / 2, max(count - len(motion.unknown), 1)))
    places = {q.name: k for k, q in enumerate(motion.unknown)}
    best = {n: float(fit.shared[k]) for n, k in places.items()}
    numbers = tuple(replace(p, value=best.get(p.name, p.value)) for p in system.parameters)
    identified = replace(system, parameters=numbers)
    refuse_other_way(system, identified, motion)
    still = {n: best.get(n, 0.0) for n in system.disturbance_names}
    estimated = {
        q.name: _estimate(q, first_guess(system, q.name), best, places, spread, quantile, held)
        for q in (*system.parameters, *system.disturbances)
        if q.name in order or q.name in hold
    }
    bound, second = _left(
        identified, setting, whole, log, held_out, fit.noise, still, unexplained_rates, widen
    )
    estimates = advised(identified, whole, windows, fit, estimated, quantile)
    measured = _shown(problem, fit)
    return Identified(
        system=identified,
        log=log.name,
        parameters=tuple(estimates[p.name] for p in system.parameters if p.name in estimates),
        disturbances=tuple(estimates[q.name] for q in system.disturbances if q.name in estimates),
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
        remarks=remarks(motion, windows, fit, estimates, bound),
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
    names = [p.name for p in system.parameters]
    for name in (*estimate, *hold):
        check_name(
            name, names, SimulationError, f"system '{system.name}' has no parameter '{name}'"
        )
    if both := set(estimate) & set(hold):
        raise SimulationError(f"'{min(both)}' is to be estimated and to be held")
    return [n for n in (estimate or names) if n not in hold]


def _estimate(
    q: object,
    before: float,
    best: Mapping[str, float],
    places: Mapping[str, int],
    spread: Array,
    quantile: float,
    held: Mapping[str, tuple[str, str]],
) -> Estimate:
    name, unit = q.name, q.unit  # type: ignore[attr-defined]
    if name not in best:
        status, why = held.get(name, (UNSEEN, "no measurement depends on it"))
        return Estimate(name, unit, before, before, math.nan, math.nan, status, why)
    value, half = best[name], quantile * float(spread[places[name]])
    status, why = IDENTIFIED, ""
    if isinstance(q, Parameter) and half >= abs(value):
        status, why = WIDE, "its interval is wider than itself"
    if isinstance(q, Parameter) and value <= q.above + 1e-9 * abs(before):
        status, why = AT_LIMIT, f"the log wants {q.above:g} or less"
    return Estimate(name, unit, before, value, value - half, value + half, status, why)


def _left(
    system: System,
    setting: Setting,
    whole: MeasuredMotion,
    log: Log,
    held_out: Log | None,
    noise: Array,
    still: Mapping[str, float],
    chosen: Sequence[str],
    widen: float,
) -> tuple[Unexplained, HeldOut | None]:
    """The bound on what is unexplained, and what a second log says of it."""
    motion = pushed_motion(system, whole, chosen or None)
    shooting = Shooting(motion)
    parts = [p for p in SHORTER if setting.length / p >= 8 * setting.step] or [1]
    cuts = [setting.cut(log, motion, p) for p in parts]
    unexplained = needed(shooting, system, cuts, noise, still, log.name)
    bound = bounded(unexplained, widen)
    if held_out is None:
        return bound, None
    part = next(p for p, cut in zip(parts, cuts, strict=True) if cut.length == unexplained.length)
    moved, error = _still(system, setting, whole, held_out, noise)
    windows = [setting.cut(held_out, motion, part)]
    again = needed(shooting, system, windows, noise, moved, held_out.name)
    return bound, compared(held_out.name, again, bound, error)


def _still(
    system: System, setting: Setting, whole: MeasuredMotion, log: Log, noise: Array
) -> tuple[dict[str, float], dict[str, float]]:
    """The constant disturbances of a second log, and its errors of prediction over a window."""
    here = [q.name for q in whole.unknown if q.name in system.disturbance_names]
    outputs = dict(zip(whole.names, whole.outputs, strict=True))
    motion = measured_motion(system, whole.names, here, outputs)
    windows = setting.cut(log, motion)
    shooting = Shooting(motion)
    zero = np.zeros(len(here))
    problem = Problem(shooting, windows, zero, range(len(here)))
    fit = fitted(problem, zero, np.full(len(here), -np.inf), noise=noise)
    rms = {
        n: float(np.sqrt(np.mean(fit.residual[windows.signal == k] ** 2)) / noise[k])
        for k, n in enumerate(whole.names)
        if (windows.signal == k).any()
    }
    return dict(zip(here, fit.shared.tolist(), strict=True)), rms


def _shown(problem: Problem, fit: Fitted) -> dict[str, tuple[Array, Array, Array]]:
    """(time, measured, predicted) of each signal."""
    w = problem.windows
    names = problem.shooting.motion.names
    return {
        n: (w.time[of], w.value[of], w.value[of] - fit.residual[of])
        for k, n in enumerate(names)
        if (of := w.signal == k).any()
    }
