"""What is simulated, and its plant and law printed for any array library."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
import sympy as sp

import holdfast as hf

SAMPLE_TIME = 0.02
"""Seconds between control samples, and the Runge-Kutta step."""

BOX = {"x": (-2.0, -0.4), "y": (-1.0, 1.0), "psi": (-0.5, 0.5)}
"""Where the runs start, at rest."""

Columns = Sequence[Any]
Array = np.ndarray
Timed = tuple[float, Array]
"""Seconds taken, and the final states with shape (runs, states)."""


@dataclass(frozen=True)
class Task:
    """How many runs of how many seconds."""

    runs: int
    seconds: float

    @property
    def steps(self) -> int:
        return round(self.seconds / SAMPLE_TIME)


@dataclass
class Contender:
    """A row of the table: `prepare` compiles, `run` is timed and must give `expected`."""

    name: str
    control: str
    run: Callable[[], Timed]
    expected: Callable[[], Array]
    tolerance: float
    runs: int
    prepare: Callable[[], object] = lambda: None
    compile_s: float = 0.0
    difference: float = math.nan
    times: list[float] = field(default_factory=list)


@cache
def vehicle_and_law() -> tuple[hf.System, hf.Law]:
    """The inspection vehicle under the plain dipolar law."""
    vehicle = hf.systems.marine_vehicle("videoray_pro_iii", thrust_limit=5.0)
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    return vehicle, law


def draw_starts(runs: int, generator: np.random.Generator) -> Array:
    """Uniform in the box, at rest."""
    starts = np.zeros((runs, 6))
    low, high = zip(*BOX.values(), strict=True)
    starts[:, :3] = generator.uniform(low, high, (runs, 3))
    return starts


@cache
def starts_of(task: Task) -> Array:
    """The starts of every run of the plain law."""
    return draw_starts(task.runs, np.random.default_rng(0))


def starts_inside(task: Task, region: hf.Region) -> Array:
    """Starts drawn from the same box, those outside the region rejected."""
    states = [hf.symbol(q.name) for q in vehicle_and_law()[0].states]
    worst = printed(states, [region.worst], region.parameters, array_functions(np), "numpy")
    found, generator = np.empty((0, 6)), np.random.default_rng(0)
    while len(found) < task.runs:
        drawn = draw_starts(task.runs, generator)
        found = np.vstack((found, drawn[worst(*drawn.T)[0] <= 0.0]))
    return found[: task.runs]


def holdfast(task: Task, system: Any, law: Any, starts: Array, **settings: Any) -> Timed:
    """One `hf.simulate`: the seconds of the simulation alone, and the final states."""
    result = hf.simulate(
        system, law, starts=starts, horizon=task.seconds, sample_time=SAMPLE_TIME, substeps=1,
        record_every=task.seconds, seed=0, **settings,
    )  # fmt: skip
    return result.dataset.attrs["wall_time_s"], result.dataset["state"].values[:, -1]


def plain(task: Task, continuous: bool) -> Timed:
    """holdfast under the plain law, its input held over a sample or continuous."""
    return holdfast(task, *vehicle_and_law(), starts_of(task), continuous=continuous)


@cache
def final_states(task: Task, continuous: bool) -> Array:
    """What every peer must reproduce."""
    return plain(task, continuous)[1]


def printed(
    arguments: Sequence[sp.Symbol],
    results: Sequence[sp.Expr],
    parameters: Sequence[hf.Parameter],
    own: Mapping[str, Callable[..., Any]],
    module: str,
) -> Callable[..., Any]:
    """A function of `arguments` for `module`; parameters become numbers, disturbances zero."""
    values = {p.symbol: p.value for p in parameters}
    values |= {d.symbol: 0 for d in vehicle_and_law()[0].disturbances}
    numeric = [e.subs(values) for e in results]
    return sp.lambdify(arguments, numeric, modules=[dict(own), module], cse=True)


def closed_loop(
    own: Mapping[str, Callable[..., Any]], module: str
) -> tuple[Callable[[Columns], Columns], Callable[[Columns, Columns], Columns]]:
    """control(q), saturated, and rates(q, u) of the plain law for `module`."""
    system, law = vehicle_and_law()
    parameters = (*system.parameters, *law.parameters)
    q, u = ([s.symbol for s in group] for group in (system.states, system.inputs))
    assert system.input_bounds is not None
    commanded = printed(q, [law.outputs[n] for n in system.input_names], parameters, own, module)
    saturated = printed(u, system.input_bounds.saturate(u), parameters, own, module)
    rates = printed(q + u, list(system.rates.values()), parameters, own, module)
    return lambda x: saturated(*commanded(*x)), lambda x, w: rates(*x, *w)


def array_functions(xp: ModuleType) -> dict[str, Callable[..., Any]]:
    """The functions of `holdfast.maths.expressions.functions` for a module like NumPy."""
    return {
        "sgn": lambda x: xp.where(x >= 0, 1.0, -1.0),
        "wrap": lambda x: x - 2 * math.pi * xp.ceil((x - math.pi) / (2 * math.pi)),
        "select": lambda x, a, b: xp.where(x >= 0, a, b),
        "magnitude": xp.abs,
        "least": lambda a, b: xp.where(b < a, b, a),
        "greatest": lambda a, b: xp.where(b > a, b, a),
        "angle": lambda y, x, guard: xp.arctan2(y, x),
        "length": lambda x, y, guard: xp.sqrt(x * x + y * y),
    }


SCALAR_FUNCTIONS: dict[str, Callable[..., float]] = {
    "sgn": lambda x: 1.0 if x >= 0 else -1.0,
    "wrap": lambda x: x - 2 * math.pi * math.ceil((x - math.pi) / (2 * math.pi)),
    "select": lambda x, a, b: a if x >= 0 else b,
    "magnitude": abs,
    "least": lambda a, b: b if b < a else a,
    "greatest": lambda a, b: b if b > a else a,
    "angle": lambda y, x, guard: math.atan2(y, x),
    "length": lambda x, y, guard: math.sqrt(x * x + y * y),
}
"""The same for one float, which is faster than NumPy on one float."""
