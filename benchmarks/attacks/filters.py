"""Safety filters over kernels and over regions, in closed loop."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import holdfast as hf
from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from attacks.closed_loop import ADVERSARIES, Runs, command_pool, inspect, run
from attacks.enclosures import NUMBERS, read
from attacks.kernels import smaller
from attacks.oracle import brackets, hull_of, names_at, points, rates_at, worst
from attacks.problems import Problem, drawn, problem, times
from attacks.product import Built
from holdfast.errors import HoldfastError

STARTS = 40
"""Starts of a case; each meets every adversary."""
EXPLORED = 4000
SHARE_OF_CELL = (0.05, 0.1, 0.3, 0.8)
"""A sample is the time in which the fastest state crosses so much of a cell."""


class Setting:
    """Sample time, delay and start of a case, from its number."""

    def __init__(self, p: Problem, seed: int, number: int) -> None:
        g = np.random.default_rng([seed, number, 11])
        self.generator = g
        x = g.uniform(p.low, p.high, (EXPLORED, len(p.low))).T
        self.inside = x[:, worst(p, x) < 0]
        self.duration = p.horizon if p.horizon < 10 else 6.0
        members = [(u, d) for u in points(p.inputs, 2) for d in points(p.disturbances, 2)]
        ones = np.ones(self.inside.shape[1])
        fastest = (
            np.max(
                [
                    np.abs(
                        rates_at(p, self.inside, [v * ones for v in u], [v * ones for v in d])
                    ).max(axis=1)
                    for u, d in members
                ],
                axis=0,
            )
            if self.inside.size
            else np.ones(len(p.low))
        )
        crossing = float(np.min(p.cells / np.maximum(fastest, 1e-9)))
        share = float(g.choice(SHARE_OF_CELL))
        self.sample = max(share * crossing, self.duration / 600)
        self.delay = int(g.choice([0, 0, 0, 1, 2]))
        self.limited = bool(np.random.default_rng([seed, number, 18]).random() < 0.25)


def filter_problem(seed: int, number: int) -> Problem:
    """Kernels in fixed regions and in all schemes, of inputs that can do something."""
    p = problem(seed, number, ("kernel",))
    if p.moves:
        p = replace(p, region=tuple(c for c in p.region if "*t" not in c), horizon=30.0)
    if p.form not in ("modes", "converter"):
        p = replace(p, inputs=times(p.inputs, 1.6))
    p = replace(p, disturbances=times(p.disturbances, 0.6))
    return replace(
        p, options={k: v for k, v in p.options.items() if k in ("refine", "band", "precision")}
    )


def over_kernel(p: Problem, seed: int, number: int) -> dict[str, Any]:
    """A filter over the kernel of a problem, from states deeper than what it says it needs."""
    built = Built(p)
    value = built.solve()
    setting = Setting(p, seed, number)
    if value.report.empty or (p.horizon > 10 and not value.report.converged):
        return {"runs": 0, "why": "no set for ever"}
    at = lambda x: value.at(built.scaled(x.T))  # noqa: E731
    try:
        keep, need = _filter(p, built, value, setting)
    except HoldfastError as error:
        if "shorter sample time" not in str(error):
            raise
        setting.sample, setting.delay = max(setting.sample / 8, setting.duration / 900), 0
        keep, need = _filter(p, built, value, setting)  # the remedy that was given
    shifts = [np.zeros((len(p.low), 1))]
    shifts += [s * c * np.eye(len(p.low))[:, [i]] for i, c in enumerate(p.cells) for s in (-1, 1)]
    lowest = np.min([at(setting.inside + s) for s in shifts], axis=0)
    if _chooses_its_starts(setting, value, keep):
        states = setting.inside.T * np.array(p.scales)
        calm = np.zeros((len(states), len(built.system.inputs)))
        lowest, need = np.array(keep.step_many(states, calm).value), _margin(keep)
        keep.reset()
    deep = setting.inside[:, lowest > need]
    if deep.shape[1] < 3:
        chosen_by = "the filter" if _chooses_its_starts(setting, value, keep) else "the margin"
        return {"runs": 0, "why": f"no state is deep enough for {chosen_by}"}
    chosen = deep[:, setting.generator.integers(deep.shape[1], size=STARTS)]
    starts = np.repeat(chosen, len(ADVERSARIES), axis=1)
    last = min(setting.duration, p.horizon - 2 * setting.sample)
    runs = run(p, keep, starts, setting.sample, last, at, setting.generator, setting.delay)
    anywhere(p, keep, runs, setting.generator)
    return _told(p, runs, starts, setting, value.report.converged)


def _filter(p: Problem, built: Built, value: Any, setting: Setting) -> tuple[Any, float]:
    """The filter over a kernel, and the V that it says a state needs."""
    sample, late = setting.sample * p.clock, setting.delay * setting.sample * p.clock
    rates = None
    if setting.limited:  # by as much as an input can change in a sample, which takes nothing away
        most = np.abs(points(p.inputs, 2)).max(axis=0)
        names = built.system.input_names
        rates = {n: 2.02 * float(b) / sample for n, b in zip(names, most, strict=True)}
    keep = hf.SafetyFilter(built.system, value, sample_time=sample, delay=late, rates=rates)
    return keep, hf.sampled_margin(built.system, value, sample, late)


def _chooses_its_starts(setting: Setting, value: Any, keep: Any) -> bool:
    """Whether the starts are those that the filter calls deep enough: where measurements are late,
    and over a set that has not converged, of which it keeps the part that is kept for ever."""
    asked = setting.delay or not value.report.converged
    return bool(asked and setting.inside.size and _looks_ahead(keep))


def _looks_ahead(keep: Any) -> bool:
    modes = getattr(keep.law, "modes", {"": keep.law}).values()
    return any(mode.safeguard.foresight for mode in modes)


def _margin(keep: Any) -> float:
    return next(float(q.value) for q in keep.law.parameters if q.name == "safety_margin")


def anywhere(p: Problem, keep: Any, runs: Runs, g: np.random.Generator) -> None:
    """Decisions at states of all of the grid, beyond it, and at states that are no number."""
    low, high = np.array(p.low), np.array(p.high)
    x = g.uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (400, len(low)))
    x[::50, 0] = math.nan
    pool = command_pool(p.inputs)
    nominal = pool[g.integers(len(pool), size=len(x))]
    keep.reset()
    decisions = keep.step_many(x * np.array(p.scales), nominal)
    inspect(p, runs, decisions, nominal, np.asarray(decisions.input))
    status = [s.value for s in decisions.status]
    beyond = ((x < low - 1e-9) | (x > high + 1e-9)) & ~np.array(p.angles)
    if any(s != "not a number" for s in status[::50]):
        runs.lies.append("a state that is no number is not named")
    outside = beyond.any(axis=1) & np.isfinite(x).all(axis=1)
    if any(s in ("passed", "changed") for s, o in zip(status, outside, strict=True) if o):
        runs.lies.append("promises something beyond the grid")


def _told(
    p: Problem, runs: Runs, starts: np.ndarray, setting: Setting, converged: bool
) -> dict[str, Any]:
    left = runs.worst > 1e-6
    told: dict[str, Any] = {
        "runs": starts.shape[1],
        "left": int(left.sum()),
        "inputs out": runs.inputs_out,
        "not finite": runs.not_finite,
        "lies": sorted(set(runs.lies)),
        "sample": setting.sample,
        "delay": setting.delay,
    }
    if left.any():
        sure = brackets(p, None, math.inf if converged else p.horizon)
        first = starts[:, left]
        told["kept for sure"] = 0 if sure is None else int(sure.all_inner(first, first).sum())
        told["lost for sure"] = (
            len(first.T) if sure is None else int(sure.none_outer(first, first).sum())
        )
        k = int(np.argmax(np.where(left, runs.worst, -np.inf)))
        told |= {"start": starts[:, k].tolist(), "by": float(runs.worst[k])}
        told["adversary"] = ADVERSARIES[runs.adversary[k]]
    return told


def over_region(p: Problem, seed: int, number: int) -> dict[str, Any]:
    """A filter over the region itself: a run without a doubtful decision does not leave it.

    What a sample costs in any case, one sample's curvature of the inequalities, is not counted.
    """
    p = replace(p, ends="wide")
    built = Built(p)
    setting = Setting(p, seed, number)
    if setting.inside.shape[1] < 3:
        return {"runs": 0, "why": "no state inside"}
    g = setting.generator
    sample = setting.sample * float(g.choice([1, 1, 4]))
    gain = float(g.choice([drawn(g, 0.5, 3), drawn(g, 0.2, 1.5) / sample]))
    pushes = built.system.disturbance_names

    def filter_of(gain: float) -> Any:
        gains = (gain / p.clock, 2 * gain / p.clock)
        time = sample * p.clock
        return hf.SafetyFilter(
            built.system, built.region, gains=gains, worst=pushes, sample_time=time
        )

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            keep = filter_of(gain)
        except HoldfastError as error:
            most = re.search(r"expected at most ([0-9.e+-]+)", str(error))
            if most is None or "between two samples" not in str(error):
                raise
            gain = float(most.group(1)) * p.clock
            keep = filter_of(gain)  # the remedy that was given
    if any("sample" in str(w.message) for w in said):
        return {"runs": 0, "why": "warned of the sample time"}
    rest = keep.step_many(
        built.scaled(setting.inside.T[:400]),
        np.tile(points(p.inputs, 2).mean(axis=0), (min(400, setting.inside.shape[1]), 1)),
    )
    feasible = np.array([s.value in ("passed", "changed") for s in rest.status])
    inside = setting.inside[:, : len(feasible)][:, feasible]
    inside = inside[:, approaches_slowly(p, inside, gain)]
    if inside.shape[1] < 3:
        return {"runs": 0, "why": "no state with an admissible input"}
    starts = np.repeat(
        inside[:, g.integers(inside.shape[1], size=STARTS)], len(ADVERSARIES), axis=1
    )
    bends = curvature(p, starts, sample)
    last = min(setting.duration, 150 * sample)
    runs = run(p, keep, starts, sample, last, lambda x: -worst(p, x), g, slack=bends)
    runs.worst = np.where(runs.infeasible, -1.0, runs.worst - bends)
    return _told(p, runs, starts, setting, False) | {"doubted": int(runs.infeasible.sum())}


def approaches_slowly(p: Problem, x: np.ndarray, gain: float) -> np.ndarray:
    """Where inequalities that no input changes at once fall, c' + gain c <= 0: from there alone a
    condition of order two keeps c <= 0."""
    ones, step = np.ones(x.shape[1]), 1e-6
    fine = np.ones(x.shape[1], bool)
    for text in p.region:
        now = read(text, names_at(p, x, (), ()), NUMBERS) + 0 * x[0]
        rates = []
        for u in points(p.inputs, 2):
            row = []
            for d in points(p.disturbances, 2):
                f = rates_at(p, x, [v * ones for v in u], [v * ones for v in d])
                row.append((read(text, names_at(p, x + step * f, (), ()), NUMBERS) - now) / step)
            rates.append(np.max(row, axis=0))
        at_once = np.ptp(rates, axis=0) > 1e-4
        fine &= at_once | (np.max(rates, axis=0) + gain * now <= 0)
    return fine


def curvature(p: Problem, x: np.ndarray, sample: float) -> float:
    """The most that an inequality may bend within a sample, from differences."""
    ones, most = np.ones(x.shape[1]), 0.0
    low, high = hull_of(p.inputs)
    pushes = points(p.disturbances, 2)
    for u in (low, high):
        for d in pushes:
            f = rates_at(p, x, [v * ones for v in u], [v * ones for v in d])
            for text in p.region:
                c = [
                    read(text, names_at(p, x + k * sample * f, (), ()), NUMBERS) for k in (0, 1, 2)
                ]
                most = max(most, float(np.max(np.abs(c[2] - 2 * c[1] + c[0]))))
            then = rates_at(p, x + sample * f, [v * ones for v in u], [v * ones for v in d])
            most = max(most, float(np.max(np.abs(then - f))) * sample)
    return 4.0 * most + 1e-6


def over_parts(p: Problem, seed: int, number: int) -> dict[str, Any]:
    """A filter over a set put together: a cart whose force is late by a lag."""
    g = np.random.default_rng([seed, number, 16])
    weak, strong, push = drawn(g, 0.6, 1), drawn(g, 0.6, 1), drawn(g, 0, 0.25)
    lag, share = drawn(g, 0.1, 0.4), float(g.choice([1.0, drawn(g, 0.7, 0.95)]))
    sample, delay = float(g.choice([0.01, 0.03])), 0
    v, u, d = hf.symbol("y"), hf.symbol("u0"), hf.symbol("d0")
    cart = hf.System(
        "cart",
        (hf.Quantity("x", "m"), hf.Quantity("y", "m/s")),
        (hf.Quantity("u0", "m/s^2"),),
        {"x": v, "y": u + d},
        disturbances=(hf.Quantity("d0", "m/s^2"),),
        input_bounds=hf.Box((-weak,), (strong,)),
        disturbance_bounds=hf.Box((-push,), (push,)),
        empirical="numbers",
    )
    late = hf.lagged(cart, {"u0": lag})
    x = hf.symbol("x")
    walls = hf.Region(
        "walls",
        cart.states[:1],
        (hf.Inequality("left", -1 - x, "m"), hf.Inequality("right", x - 1, "m")),
        empirical="numbers",
    )
    nodes = int(g.integers(41, 82))

    def put_together(reach: float) -> Any:
        box = {"x": (-reach, reach), "y": (-2.0, 2.0)}
        kind = "discriminating-kernel"
        parts = hf.decompose(late, walls, kind=kind, lag_share=share, box=box)
        return hf.solve_parts(parts, None, nodes=nodes, horizon=20)

    try:
        value = put_together(1.5)
    except HoldfastError as error:
        if "give decompose a box" not in str(error):
            raise
        value = put_together(abs(float(str(error).rsplit(" ", 1)[-1])))  # the remedy that was given
    keep = hf.SafetyFilter(late, value, sample_time=sample)
    q = Problem(
        "kernel",
        "lagged parts",
        ("y", "z + d0", f"(u0 - z)/{lag}"),
        ("abs(x) - 1",),
        ("x",),
        {},
        ["box", [-weak], [strong]],
        ["box", [-push], [push]],
        (False,) * 3,
        (-1.5, -2.0, -weak),
        (1.5, 2.0, strong),
        (41, 41, 41),
        30.0,
        scales=(1.0,) * 3,
    )
    low, high = (-1, -1.6, -weak * share), (1, 1.6, strong * share)
    drawn_states = g.uniform(low, high, (EXPLORED, 3))
    states = drawn_states[value.at(drawn_states) > 0.15][:STARTS]
    if len(states) < 3:
        return {"runs": 0, "why": "no state is deep"}
    starts = np.repeat(states.T, len(ADVERSARIES), axis=1)
    runs = run(
        q,
        keep,
        starts,
        sample,
        min(8.0, 600 * sample),
        lambda y: value.at(np.ascontiguousarray(y.T)),
        g,
        delay,
    )
    left = runs.worst > 1e-6
    return {
        "runs": starts.shape[1],
        "left": int(left.sum()),
        "inputs out": runs.inputs_out,
        "not finite": runs.not_finite,
        "lies": sorted(set(runs.lies)),
        "numbers": (weak, strong, push, lag, share, sample),
    }


FORMS = {"kernel": over_kernel, "region": over_region, "set of parts": over_parts}
SENTENCES = {
    "left": "a filter over a {of} loses what it promised to keep",
    "inputs out": "a filter over a {of} gives an input beyond its bounds",
    "not finite": "a filter over a {of} gives an input that is no number",
    "lies": "a filter over a {of}: its status is not what it did",
}


def form_of(number: int) -> str:
    """Most filters are over kernels."""
    if number % 16 == 15:
        return "set of parts"
    return "region" if number % 3 == 2 else "kernel"


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, seed, number))


def _attempt(seed: int, number: int, outcome: Outcome) -> None:
    p = filter_problem(seed, number)
    of = form_of(number)
    told = FORMS[of](p, seed, number)
    outcome.judged = int(told["runs"] > 0)
    outcome.counts = {"loops": told["runs"], f"over a {of}": told["runs"]}
    if why := told.get("why"):
        outcome.counts[f"nothing to run: {why}"] = 1
    for what, sentence in SENTENCES.items():
        if told.get(what):
            more = ""
            if what == "left" and of == "kernel":
                more = "; " + _whose(told) + (", measured late" if told["delay"] else "")
            outcome.faults.append(
                Fault(sentence.format(of=of) + more, f"{p.form} {p.scheme} {p.options} {told}")
            )


def _whose(told: dict[str, Any]) -> str:
    """Whether the set or the filter is wrong."""
    if told["kept for sure"]:
        return "from states that are surely kept"
    return (
        "from states that are surely lost"
        if told["lost for sure"]
        else "from states between the brackets"
    )


def loses(p: Problem, of: str, what: str, seed: int, number: int) -> bool:
    """Whether the filter of a problem has a fault."""
    try:
        return bool(FORMS[of](p, seed, number).get(what))
    except HoldfastError:
        return False


def shrink(seed: int, number: int, fault: Fault) -> None:
    of = form_of(number)
    p = filter_problem(seed, number)
    what = next(
        (w for w, s in SENTENCES.items() if fault.signature.startswith(s.format(of=of))), None
    )
    if what is None:
        body = f"print(attempt({seed}, {number}).faults)\n"
    else:

        def has(q: Problem) -> bool:
            return loses(q, of, what, seed, number)

        p = writing.shrunk(p, _simpler, has, seconds=40)
        body = f"print(FORMS[{of!r}](problem_of({p.plain()!r}), {seed}, {number}))\n"
    modules = (
        "case",
        "enclosures",
        "problems",
        "oracle",
        "product",
        "writing",
        "kernels",
        "closed_loop",
        "filters",
    )
    fault.text = writing.alone(f"{fault.signature}.\n\n{fault.message}", modules, body)


def _simpler(p: Problem) -> Iterator[Problem]:
    return smaller(p)


KIND = Kind(
    "filters",
    attempt,
    shrink,
    share=3.0,
    seconds=90.0,
    shown=("loops", "over a kernel", "over a region", "over a set of parts"),
)
