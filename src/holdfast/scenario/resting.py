"""Where the vehicle of closed loops can rest in their steady disturbance, said beforehand.

A field over the states is steady as a number is: the vehicle feels its value where it rests.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from holdfast.analysis.safety.equilibria import SEARCHES, RestingState, Search
from holdfast.errors import DefinitionError, ScenarioError
from holdfast.execution.arrays import Array
from holdfast.maths.definitions.quantity import TIME, symbol

if TYPE_CHECKING:
    from holdfast.scenario.kinds.closed_loop import Scenario

DRAWS = 180
"""Currents of drawn values that are tried: every two degrees of a direction."""


@dataclass(frozen=True)
class Resting:
    """The best place at rest in every disturbance that was tried.

    drawn: whether the disturbances are draws of [varied], with the seed and evenly spaced.
    """

    title: str
    scenario: str
    found: tuple[RestingState, ...]
    drawn: bool
    units: Mapping[str, str]

    @property
    def worst(self) -> RestingState:
        """The one with the least margin, those without an equilibrium first."""
        return min(self.found, key=lambda f: (f.exists, f.margin))

    def summary(self) -> dict[str, Any]:
        """What rest.json says."""
        return {
            "scenario": self.scenario,
            "tried": len(self.found),
            "at_rest": sum(f.exists for f in self.found),
            "places": [_place(f) for f in self.found],
        }

    @property
    def answered(self) -> bool:
        """Whether there is a place at rest in any of them."""
        return any(f.exists for f in self.found)


def _place(best: RestingState) -> dict[str, Any]:
    return {n: v for n, v in asdict(best).items() if n != "current_names"} | {"exists": best.exists}


def no_rest(scenario: Scenario) -> str:
    """A sentence where the given disturbance leaves no place at rest in the region, else "".

    Nothing is said without a steady disturbance, where it is drawn for every run, and of a region
    that the system's states do not determine. Usually a place is found at once; the best one is
    searched only where none is.
    """
    steady = _constant(scenario)
    if steady is None or not (any(steady.values()) or _field(scenario)):
        return ""
    try:
        search = _search(scenario)
    except DefinitionError:  # rates or a region without a place at rest: of time, of other states
        return ""
    if search.surely_held(steady):
        return ""
    best = search.solve(steady, [])
    return "" if best.exists else sentence(best, scenario)


def resting_places(scenario: Scenario, draws: int = DRAWS) -> Resting:
    """The best place at rest in the disturbance of a scenario, or in `draws` of those drawn.

    Raises `ScenarioError` for closed loops without a region, or in a disturbance that varies with
    time, and as `hf.resting_state`.
    """
    if scenario.region is None:
        raise ScenarioError(f"{scenario.file}: no region, so no place at rest in one")
    steady = _constant(scenario)
    drawn = steady is None
    tried = _drawn(scenario, draws) if steady is None else [steady]
    search = _search(scenario, _moving(scenario) if drawn else ())
    places: list[RestingState] = []
    last: list[Array] = []
    for disturbance in tried:
        best = search.solve(disturbance, last)
        places.append(best)
        if best.exists:
            last = [np.array([*best.state.values(), *best.inputs.values(), best.margin])]
    return Resting(scenario.title, scenario.name, tuple(places), drawn, _units(scenario))


def sentence(best: RestingState, scenario: Scenario) -> str:
    """Why no place of the region can be held, and where the best one is."""
    assert scenario.region is not None
    return (
        f"no place in '{scenario.region.name}' can be held in {best.words(_units(scenario))}: "
        f"{best.missing}; at best the system keeps moving in the region"
    )


def _units(scenario: Scenario) -> dict[str, str]:
    plant = scenario.system
    return {q.name: q.unit for q in (*plant.states, *plant.inputs, *plant.disturbances)}


def _search(scenario: Scenario, drawn: Sequence[sp.Symbol] = ()) -> Search:
    assert scenario.region is not None
    numbers = {s: sp.Float(v) for s, v in _numbers(scenario).items() if s not in drawn}
    field = {n: e.xreplace(numbers) for n, e in _field(scenario).items()}
    return Search(scenario.system, scenario.region, _box(scenario), SEARCHES, 0, field, drawn)


def _field(scenario: Scenario) -> dict[str, sp.Expr]:
    """The disturbances that depend on the state of the plant."""
    states = _states(scenario)
    return {n: e for n, e in scenario.disturbance.items() if e.free_symbols & states}


def _states(scenario: Scenario) -> set[sp.Basic]:
    return {q.symbol for q in scenario.system.states}


def _moving(scenario: Scenario) -> list[sp.Symbol]:
    """What is drawn for every run and moves the disturbance."""
    used = _used(scenario.disturbance.values())
    draws = scenario.varied.draws.items()
    return [symbol(n) for n, (low, high) in draws if low < high and symbol(n) in used]


def _box(scenario: Scenario) -> dict[str, tuple[float, float]]:
    """Where the runs start; a state that starts with one value is searched as usual."""
    box: dict[str, tuple[float, float]] = {}
    for name in scenario.system.state_names:
        ends = [s.get(name, 0.0) for s in scenario.starts.states]
        ends += list(scenario.starts.box.get(name, ()))
        if ends and min(ends) < max(ends):
            box[name] = (min(ends), max(ends))
    return box


def _constant(scenario: Scenario) -> dict[str, float] | None:
    """The disturbance as numbers (0: a field); None where there is none, or it varies with time or
    between runs."""
    if scenario.region is None or not scenario.system.disturbances:
        return None
    numbers = _numbers(scenario)
    draws = scenario.varied.draws
    fixed = [n for n, (low, high) in draws.items() if low == high]
    varied = {symbol(n) for n in scenario.varied.names if n not in fixed}
    used = _used(scenario.disturbance.values())
    if (
        varied & (used | _own(scenario))
        or scenario.varied.plant
        or not used <= set(numbers) | _states(scenario)
    ):
        return None
    return _values(scenario, numbers)


def _used(expressions: Iterable[sp.Expr]) -> set[sp.Basic]:
    return {s for e in expressions for s in e.free_symbols}


def _own(scenario: Scenario) -> set[sp.Basic]:
    """The symbols of the system and the region."""
    region = scenario.region.inequalities if scenario.region is not None else ()
    return _used([*scenario.system.rates.values(), *(c.expression for c in region)])


def _numbers(scenario: Scenario) -> dict[sp.Basic, float]:
    region = scenario.region.parameters if scenario.region is not None else ()
    parameters = (*scenario.system.parameters, *scenario.law.parameters, *region)
    lowest = {symbol(n): low for n, (low, _) in scenario.varied.draws.items()}
    return {p.symbol: p.value for p in parameters} | lowest


def _values(scenario: Scenario, numbers: Mapping[sp.Basic, float]) -> dict[str, float]:
    still = {n: e for n, e in scenario.disturbance.items() if n not in _field(scenario)}
    by_name = {n: float(e.subs(numbers)) for n, e in still.items()}
    return {n: by_name.get(n, 0.0) for n in scenario.system.disturbance_names}


def _drawn(scenario: Scenario, count: int) -> Sequence[dict[str, float]]:
    """Disturbances of draws: one direction evenly, more numbers at random."""
    varied, moving = scenario.varied, _moving(scenario)
    used = _used(scenario.disturbance.values()) - _states(scenario)
    numbers = _numbers(scenario)
    if TIME in used or not used <= set(numbers) or varied.values or varied.plant or not moving:
        raise ScenarioError(
            f"{scenario.file}: its disturbance is not constant in a run",
            expected="numbers, or expressions of states, parameters and draws of [varied]",
        )
    if _own(scenario) & {symbol(n) for n, (low, high) in varied.draws.items() if low < high}:
        raise ScenarioError(f"{scenario.file}: the system or its region is drawn for every run")
    if len(moving) == 1:
        shares = (np.arange(count) / count)[:, None]
    else:
        shares = np.random.default_rng(scenario.seed).random((count, len(moving)))
    ends = np.array([varied.draws[str(s)] for s in moving])
    rows = ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])
    drawn = [dict(zip(moving, map(float, row), strict=True)) for row in rows]
    return [
        {**_values(scenario, numbers | draw), **{str(s): v for s, v in draw.items()}}
        for draw in drawn
    ]
