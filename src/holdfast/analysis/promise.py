"""Does a kernel keep its promise? Random states of it, its law, the trajectories that follow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.comparison import Rate
from holdfast.analysis.given import whole
from holdfast.analysis.places import Places
from holdfast.analysis.result import Result
from holdfast.analysis.safety_law import decided, safety_law, worst_disturbance
from holdfast.analysis.simulate import simulate
from holdfast.analysis.value_function import Array, ValueFunction
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.closed_loop import Outcome, Progress
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.bounds import Ball, Bounds, Box, LinearImage, Product
from holdfast.maths.law import Law
from holdfast.maths.quantity import TIME, symbol
from holdfast.maths.region import Region
from holdfast.maths.switching import Switching
from holdfast.maths.system import System
from holdfast.maths.varied import Varied

DRAWS = 400
"""Batches of states drawn before giving up."""


@dataclass(frozen=True)
class Trials:
    """Runs against one kind of disturbance: `kept` stayed in the region, or, of a basin, reached
    the goal through it; excursion: the largest max_j c_j of any run, in the region's unit (of a
    basin, whose runs go on beyond the goal, not a number)."""

    what: str
    kept: Rate
    excursion: float
    relaxed: int


@dataclass(frozen=True)
class Promise:
    """Closed loops from random states with V > margin, and from states of K with V < -margin.

    law: what steered; inside: against the worst, against random and without disturbances, as far
    as the system has any; outside: against the worst, None where K has no such state.
    """

    law: str
    margin: float
    unit: str
    horizon: float
    sample_time: float
    inside: tuple[Trials, ...]
    outside: Trials | None
    aim: str = "stay"

    @property
    def held(self) -> bool:
        """Whether every run from inside stayed."""
        return all(t.kept.count == t.kept.total for t in self.inside)

    def summary(self) -> dict[str, Any]:
        """For summary.json."""

        def said(t: Trials) -> dict[str, Any]:
            worst = t.excursion if math.isfinite(t.excursion) else None
            more = {"worst_constraint": worst, "runs_relaxed": t.relaxed}
            return {"against": t.what, "runs": t.kept.total, **t.kept.summary(), **more}

        return {
            "law": self.law,
            "margin": self.margin,
            "unit": self.unit,
            "horizon_s": self.horizon,
            "sample_time_s": self.sample_time,
            "held": self.held,
            "inside": [said(t) for t in self.inside],
            "outside": said(self.outside) if self.outside else None,
        }


@checked
def check_promise(
    system: System,
    value: ValueFunction,
    region: Region | None,
    *,
    goal: Region | None = None,
    law: Law | Switching | None = None,
    runs: int = 1000,
    margin: float | None = None,
    horizon: float | None = None,
    sample_time: float = 0.02,
    rate: float = 2.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> Promise:
    """Simulate from `runs` random states of the kernel, and as many of the rest of `region`.

    region: what is kept, None where a goal is reached through anything. law: what the safety law
    leaves alone as far as it can; None: the optimal inputs alone. margin [unit of V]: how far
    inside to start, by default one cell (the largest change of V between neighbours). horizon [s]:
    by default that of the value function, which a kernel that has not converged promises nothing
    beyond. goal: of a capture basin, to be reached.

    Raises `SimulationError` for a value function that promises nothing, or an empty one.
    """
    said = value.dataset.attrs
    if margin is None:
        margin = float(said["cell"])
    longest = float(said["horizon_s"])
    if horizon is None:
        horizon = longest
    if horizon > longest and not said["converged"]:
        raise SimulationError(
            f"a promise for {horizon:g} s of a value function that has not converged",
            expected=f"at most its horizon, {longest:g} s",
        )
    whole("runs: ", runs, 1)
    whole("seed: ", seed, 0)
    known = decided(system, value)
    steered = safety_law(system, value, law, sample_time=sample_time, rate=rate)
    generator = np.random.default_rng(seed)
    if region is None and goal is None:
        raise SimulationError("a promise to stay, and no region", remedy="give the region")
    symbols = [q.symbol for q in system.states]
    margin_of = None if region is None else Evaluator([region.margin], symbols, region.parameters)

    def in_region(states: Array) -> Any:
        return True if margin_of is None else margin_of.values(states)[:, 0] > 0

    numbers = value.values()
    within = Places(lambda k: numbers[k] > 0, numbers.shape)
    inside = _drawn(value, generator, runs, lambda q: value.at(q) > margin, within)
    if inside is None:
        raise SimulationError(
            f"no state of the set is further inside than {margin:g}", remedy="take a finer grid"
        )
    trials = ["worst", "random"] if known.disturbances else ["no"]
    count = len(trials) + 1

    def run(what: str, starts: Array, number: int) -> Trials:
        settings: dict[str, Any] = {
            "horizon": horizon,
            "sample_time": sample_time,
            "record_every": sample_time if goal is not None else horizon,
            "seed": seed,
            "start_outside": True,
            "progress": None if progress is None else lambda f: progress((number + f) / count),
        }
        plant, driven = known, steered
        if what == "worst" and known.disturbances:
            plant, driven = worst_disturbance(system, value, steered)
        elif what == "random":
            settings["disturbance"], settings["varied"] = random_disturbance(known)
        result = simulate(plant, driven, starts=starts, region=region, **settings)
        return _trials(what, result, goal, system)

    found = tuple(run(what, inside, i) for i, what in enumerate(trials))
    lost = None
    beyond = _drawn(
        value,
        generator,
        runs,
        lambda q: (value.at(q) < -margin) & in_region(q),
        Places(lambda k: numbers[k] < -margin, numbers.shape),
    )
    if beyond is not None:
        lost = run("worst" if known.disturbances else "no", beyond, count - 1)
    return Promise(
        law=steered.name,
        margin=margin,
        unit=str(said["value_unit"]),
        horizon=horizon,
        sample_time=sample_time,
        inside=found,
        outside=lost,
        aim="stay" if goal is None else "reach the goal",
    )


def random_disturbance(system: System) -> tuple[dict[str, sp.Expr], Varied]:
    """Disturbances within their bounds that swing at paces and phases drawn for every run."""
    draws: dict[str, tuple[float, float]] = {}

    def swing() -> sp.Expr:
        number = len(draws) // 2
        draws[f"random_pace_{number}"] = (0.0, 3.0)
        draws[f"random_phase_{number}"] = (-np.pi, np.pi)
        return sp.sin(symbol(f"random_pace_{number}") * TIME + symbol(f"random_phase_{number}"))

    def of(bounds: Bounds) -> list[sp.Expr]:
        if isinstance(bounds, Product):
            return [e for part in bounds.parts for e in of(part)]
        if isinstance(bounds, LinearImage):
            return list(bounds.produce(of(bounds.of)))
        if isinstance(bounds, Ball):
            way = [swing() for _ in range(bounds.dimension)]
            size = sp.sqrt(sum(e**2 for e in way) + sp.Float(1e-12))
            return [bounds.radius * e / size for e in way]
        assert isinstance(bounds, Box)
        pairs = zip(bounds.lower, bounds.upper, strict=True)
        return [(a + b) / 2 + (b - a) / 2 * swing() for a, b in pairs]

    assert system.disturbance_bounds is not None
    expressions = dict(zip(system.disturbance_names, of(system.disturbance_bounds), strict=True))
    units = {n: "1/s" if "pace" in n else "rad" for n in draws}
    return expressions, Varied(draws, {}, {}, units)


def _drawn(
    value: ValueFunction, generator: np.random.Generator, count: int, wanted: Any, nodes: Places
) -> Array | None:
    """States around the nodes chosen, uniform in their cells, for which `wanted` holds."""
    if not len(nodes):
        return None
    axes = value.grid.axes
    found: list[Array] = []
    have = 0
    for _ in range(DRAWS):
        picked = nodes.at(generator.choice(len(nodes), 4 * count))
        points = np.stack(
            [
                a.low + a.step * (k + generator.uniform(-0.5, 0.5, len(k)))
                for a, k in zip(axes, picked, strict=True)
            ],
            axis=1,
        )
        with np.errstate(invalid="ignore"):
            points = points[wanted(points)]
        found.append(points)
        have += len(points)
        if have >= count:
            return np.vstack(found)[:count]
    return None


def _trials(what: str, result: Result, goal: Region | None, system: System) -> Trials:
    data = result.dataset
    outcome = data["outcome"].values
    if goal is None:
        kept = ~np.isin(outcome, (Outcome.LEFT, Outcome.DIVERGED))
    else:
        level = Evaluator([goal.worst], [q.symbol for q in system.states], goal.parameters)
        states = data["state"].values
        flat = np.nan_to_num(states.reshape(-1, states.shape[2]), nan=1e9)
        inside = level.values(flat)[:, 0].reshape(states.shape[:2]) <= 0
        first = np.where(inside.any(axis=1), data["time"].values[inside.argmax(axis=1)], np.inf)
        left = np.nan_to_num(data["exit_time"].values, nan=np.inf)
        kept = first <= np.where(outcome == Outcome.STAYED, np.inf, left)
        kept &= np.isfinite(first)
    return Trials(
        {"worst": "the worst disturbance", "random": "random disturbances"}.get(
            what, "no disturbance"
        ),
        Rate(int(kept.sum()), len(kept)),
        float(data["worst_constraint"].max()) if goal is None else math.nan,
        int((data["infeasible"].values > 0).sum()),
    )
