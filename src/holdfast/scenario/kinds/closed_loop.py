"""Closed loops from many starts: composed from the tables of a file, simulated, drawn.

[kernels] has tables that alter a named kernel, which has to be one that the file uses.

Where the vehicle can rest in a steady disturbance is said beforehand. A field over the states is
steady as a number is: the vehicle feels its value where it rests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import sympy as sp

from holdfast.analysis.safety.equilibria import SEARCHES, RestingState, Search
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.simulate import simulate
from holdfast.analysis.simulation.starts import Starts
from holdfast.arguments import Seconds, checked
from holdfast.errors import DefinitionError, ScenarioError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import SettingsOptions
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, symbol
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System, check_disturbance_units
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.parser import parse_expression, parse_formula, parse_number
from holdfast.scenario.build.closed_loop import (
    commanded_by_another,
    commander_of,
    composed_law,
    drawn_names,
    drawn_ranges,
    in_si,
    known_name,
    settings_of,
    starts_of,
)
from holdfast.scenario.build.composer import Composer, composed_system, plant_of
from holdfast.scenario.files import overridden, scenario_title
from holdfast.scenario.kinds.base import Bar, Composed, Kind
from holdfast.scenario.schema.closed_loop import (
    FiguresSpec,
    FormationFigures,
    FormationHeader,
    Header,
    ScenarioSpec,
)
from holdfast.scenario.schema.values import at, validated

if TYPE_CHECKING:
    from holdfast.analysis.online.safety_filter import SafetyFilter
    from holdfast.analysis.simulation.law_comparison import Entry
    from holdfast.execution.simulation.closed_loop import Commander
    from holdfast.scenario.build.moving import Surroundings
    from holdfast.scenario.kernel_reference import Safety


def check_kernels(file: str, data: Mapping[str, Any]) -> None:
    """Refuse [kernels] of a name that no key `kernel` of the file uses: it would have no effect."""
    named = set(_named(data))
    for name in _altered(data):
        if name not in named:
            raise ScenarioError(
                f"{file}: kernels.{name}: no [safety] or [compare] names this kernel",
                remedy=suggestion(name, named),
            )


def _named(data: Mapping[str, Any]) -> Iterator[str]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _named(value)
        elif key == "kernel" and isinstance(value, str):
            yield value


def _altered(data: Mapping[str, Any]) -> Iterator[str]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from (value if key == "kernels" else _altered(value))


class RunSettings(SettingsOptions, total=False):
    """The settings of [run]."""

    horizon: Seconds
    stepper: str


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Composed):
    """A composed scenario, ready to run; `law` is the one before [safety], which `kept` adds.

    system: what moves. model: what the law is made for, the same but for the lag of actuators.
    """

    name: str
    file: str
    text: str
    title: str
    kind: str
    description: str
    source: str
    system: System
    model: System
    law: Law | Switching
    region: Region | None
    goal: Region | None
    starts: Starts
    settings: Mapping[str, Any]
    disturbance: Mapping[str, sp.Expr]
    plant: Mapping[str, float]
    varied: Varied
    reference: Mapping[str, float]
    plane: tuple[str, str] | None
    figures: FiguresSpec | FormationFigures
    start_outside: bool
    safety: Safety | None = None
    controller: str = ""
    filtering: Mapping[str, Any] | None = None
    surroundings: Surroundings | None = None
    remark: str | None = None

    @property
    def runs(self) -> int:
        """The number of runs: one from every start, or one at every vertex of [varied]."""
        return self.starts.count * self.varied.turns

    def kept(self, progress: Progress | None = None) -> Scenario:
        """This scenario with the law kept in the kernel of [safety], which is computed."""
        if self.safety is None:
            return self
        with at(self.file, "safety"):
            timing = {n: float(self.settings[n]) for n in ("horizon", "sample_time", "delay")}
            law = self.safety.kept(
                self.model, self.law, **timing, region=self.region, progress=progress
            )
        return replace(self, law=law, safety=None)

    @checked
    def run(self, progress: Progress | None = None, part: range | None = None) -> Result:
        """Simulate every start of the scenario; the kernel of [safety] is computed before.

        part: of all runs those to simulate; every run is the same in any part.
        """
        commander: Commander | None = None
        commander = commander_of(self.file, self.model, self.law, self.controller)
        law, around = self.kept(progress).law, self.surroundings
        sample_time = float(self.settings["sample_time"])
        if around is not None:
            around.check(self.file, float(self.settings["horizon"]), sample_time)
            commander = around.commander(self.model, law, commander)
        with at(self.file, "run", self.text):
            result = simulate(
                self.system,
                law,
                starts=self.starts,
                part=part,
                region=self.region,
                goal=self.goal,
                disturbance=self.disturbance,
                plant=self.plant,
                varied=self.varied,
                reference=self.reference,
                start_outside=self.start_outside,
                attributes={
                    "title": self.title,
                    "scenario": self.name,
                    "kind": self.kind,
                    "scenario_text": self.text,
                    **({"controller": self.controller} if self.controller else {}),
                    **({"no_rest": self.remark} if self.remark is not None else {}),
                },
                progress=progress,
                command=commander,
                **self.settings,
            )
        return result if around is None else around.judged(result, sample_time)

    def beforehand(self) -> Scenario:
        """The same, with a sentence where its disturbance leaves no place at rest in the region."""
        return replace(self, remark=no_rest(self))

    def with_controller(self, line: str) -> Scenario:
        if not commanded_by_another(self.law):
            super().with_controller(line)
        return replace(self, controller=line)

    def safety_filter(self, progress: Progress | None = None) -> SafetyFilter:
        """The filter of [safeguard] or [safety], with [observer], around the command of another.

        The kernel is computed.
        """
        settings, safety = self.filtering, self.safety
        commanded = commanded_by_another(self.law)
        if settings is None or not commanded:
            return super().safety_filter(progress)
        from holdfast.analysis.online.safety_filter import SafetyFilter

        if missing := [n for n in self.model.input_names if n not in commanded]:
            raise ScenarioError(
                f"{self.file}: law.external: the other controller does not command "
                + ", ".join(missing),
                expected="external = true for a filter by itself",
            )
        drawn = {*self.varied.draws, *self.varied.values}
        if varied := sorted(drawn & {p.name for p in self.law.parameters}):
            raise ScenarioError(
                f"{self.file}: varied: '{varied[0]}' of the filter differs from run to run",
                remedy="leave it out, with --set varied=",
            )
        timing: dict[str, Any] = {"sample_time": float(self.settings["sample_time"])}
        if safety is None:
            keep = [] if "constraints" not in settings or self.region is None else [self.region]
            if not keep and "obstacles" not in settings:
                raise ScenarioError(
                    f"{self.file}: nothing keeps the command of the other controller",
                    expected="[safeguard], [safety] or [obstacles]",
                )
            with at(self.file, "safeguard"):
                return SafetyFilter(self.model, keep[0] if keep else (), **settings, **timing)
        if safety.alone or safety.tracking is not None:
            raise ScenarioError(
                f"{self.file}: safety.alone: the kernel replaces the command of the other "
                "controller",
                expected="alone = false",
            )
        with at(self.file, "safety"):
            value = safety.kernel.tried(safety.value(self.model, self.region, progress))
            timing["delay"] = float(self.settings["delay"])
            return SafetyFilter(self.model, value, **safety.settings, **settings, **timing)

    def on_device(self, device: str) -> Scenario:
        return self.with_settings(device=device)

    def with_settings(self, **settings: Unpack[RunSettings]) -> Scenario:
        """The same with other settings of [run]."""
        return replace(self, settings={**self.settings, **settings})

    def drawn(self, answer: Result, folder: Path, bar: Bar | None) -> list[Path]:
        """The figures of a result: paths in the plane, histories of one run."""
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.histories import histories_figure
        from holdfast.presentation.figures.paths import paths_figure

        chosen = self.figures
        assert isinstance(chosen, FiguresSpec)
        run = min(chosen.history, answer.arrays.sizes["run"] - 1)  # --runs may leave fewer
        files = []
        if self.plane is not None:
            plane = paths_figure(answer, self.plane, chosen.highlight, chosen.cones, run)
            files += style.write(plane, folder, "paths")
        return files + style.write(histories_figure(answer, run), folder, "histories")

    def report(self, answer: Result, files: Sequence[Path]) -> str:
        from holdfast.presentation.text.runs import summary_text

        return summary_text(answer, list(files))

    def complaints(self, answer: Result) -> list[str]:
        counts = answer.outcomes
        limit = self.settings["switch_limit"]
        said = {
            "diverged": "diverged, with results up to there",
            "chattered": f"chattered: more than {limit} changes of mode within a second; what "
            "happens then depends on the sample time",
            "left grid": "left the grid or the cells of the law, which says nothing there",
        }
        return [f"{_runs(counts[n])} {words}" for n, words in said.items() if counts[n]]

    def interactive(self, answer: Result) -> dict[str, Any] | None:
        from holdfast.presentation.html.interactive import paths_data

        return paths_data(answer, self.plane)

    @property
    def independent_runs(self) -> int:
        return self.runs

    @property
    def seed(self) -> int:
        return int(self.settings["seed"])

    def tally(self, part: range | None, threads: int) -> dict[str, Entry]:
        from holdfast.analysis.simulation.law_comparison import tally_of

        every = self.settings["horizon"]
        if self.surroundings is not None:  # which are judged where the runs are recorded
            every = self.settings["record_every"]
        ends = self.with_settings(threads=threads, record_every=every)
        return tally_of(ends.run(part=part))

    @property
    def given(self) -> Mapping[str, Any]:
        return self.disturbance


def _runs(count: int) -> str:
    return f"{count} run" + ("s" if count != 1 else "")


def _compose(
    file: str, text: str, data: dict[str, Any], runs: int | None, seed: int | None
) -> Scenario:
    text, data = seeded(text, data, seed)
    check_kernels(file, data)
    return composed(file, text, validated(ScenarioSpec, data, file), runs)


def seeded(text: str, data: dict[str, Any], seed: int | None) -> tuple[str, dict[str, Any]]:
    return overridden(text, data, [] if seed is None else [f"run.seed={seed}"])


def composed(shown: str, text: str, spec: ScenarioSpec, runs: int | None = None) -> Scenario:
    """The scenario of tables that are checked already; `shown` is its name or file."""
    if runs is not None and runs < 1:
        raise ScenarioError(f"--runs is {runs}", expected="at least 1")
    scenario = _composed(shown, text if runs is None else text + f"# runs: {runs}\n", spec)
    history = spec.figures.history
    most = max(scenario.runs, (runs or 0) * scenario.varied.turns)
    if history >= most:
        raise ScenarioError(
            f"{shown}: figures.history: there is no run {history}", expected=f"0 to {most - 1}"
        )
    if runs is None:
        return scenario
    states = scenario.starts.states[:runs]
    starts = replace(scenario.starts, states=states, random=runs - len(states))
    return replace(scenario, starts=starts)


def about(file: str, text: str, header: Header | FormationHeader) -> dict[str, Any]:
    """The attributes that every scenario writes."""
    return {
        "name": scenario_title(file).strip(".") or "scenario",
        "file": file,
        "text": text,
        "title": header.title,
        "kind": header.kind,
        "description": header.description,
        "source": header.source,
    }


def _composed(file: str, text: str, spec: ScenarioSpec) -> Scenario:
    composer = Composer(file)
    system = composed_system(composer, spec.system)
    composer.drawn = drawn_names(composer, system, spec.varied)
    region = composer.region(spec.region, "region") if spec.region is not None else None
    law, filtering = composed_law(composer, spec, system, region)  # may use the region's parameters
    goal = composer.region(spec.goal, "goal") if spec.goal is not None else None
    plant = plant_of(composer, system, spec.system)
    draws = drawn_ranges(composer, spec.varied)
    values = {p.symbol: p.value for p in composer.known.values()}
    names = {n: e for n, e in composer.scope().items() if n not in plant.state_names}
    timeless = {n: e for n, e in names.items() if n != "t"}
    of_state = {q.name: q.symbol for q in plant.states}

    def number(expression: object, key: str) -> float:
        with at(file, key):
            return parse_number(expression, timeless, values)

    def expressions(
        table: Mapping[str, object],
        key: str,
        parse: Callable[[object, Mapping[str, sp.Expr]], sp.Expr] = parse_formula,
        names: Mapping[str, sp.Expr] = timeless,
    ) -> dict[str, sp.Expr]:
        parsed = {}
        for name, text in table.items():
            with at(file, f"{key}.{name}"):
                parsed[name] = parse(text, names)
        return parsed

    with at(file, "varied"):
        varied = Varied(
            draws,
            expressions(spec.varied.values, "varied.values"),
            expressions(spec.varied.plant, "varied.plant"),
            {name: composer.known[name].unit for name in draws},
            spec.varied.of_vertices,
        )
    units = {q.name: q.unit for q in plant.states}
    disturbance = expressions(spec.disturbance, "disturbance", parse_expression, names | of_state)
    with at(file, "disturbance"):
        check_disturbance_units(plant, disturbance, tuple(composer.known.values()))
    return Scenario(
        **about(file, text, spec.scenario),
        system=plant,
        model=system,
        law=law,
        region=region,
        goal=goal,
        starts=starts_of(spec.starts, units, file),
        settings=settings_of(spec, units, file),
        disturbance=disturbance,
        plant={
            key: in_si(file, f"plant.{key}", value, {p.name: p.unit for p in plant.parameters}, key)
            for key, value in spec.plant.items()
        },
        varied=varied,
        reference={
            known_name(file, f"reference.{k}", k, units): number(v, f"reference.{k}")
            for k, v in spec.reference.items()
        },
        plane=_plane(file, spec.figures.plane, system),
        figures=spec.figures,
        start_outside=spec.starts.start_outside,
        safety=_safety(file, spec, system),
        filtering=filtering,
        surroundings=_surroundings(file, spec, system, timeless, values, draws),
    )


def _safety(file: str, spec: ScenarioSpec, system: System) -> Safety | None:
    if spec.safety is None:
        return None
    from holdfast.scenario.kernel_reference import composed_safety  # with value functions

    return composed_safety(file, spec, system)


def _surroundings(
    file: str,
    spec: ScenarioSpec,
    system: System,
    names: Mapping[str, sp.Expr],
    values: Mapping[sp.Symbol, float],
    drawn: Mapping[str, tuple[float, float]],
) -> Surroundings | None:
    if spec.obstacles is None:
        return None
    from holdfast.scenario.build.moving import Surroundings, composed_clearing, composed_moving

    numbers = {s: v for s, v in values.items() if str(s) in names and str(s) not in drawn}
    clearing = composed_clearing(file, spec.obstacles)
    moving = composed_moving(file, spec.obstacles.moving, numbers)
    return Surroundings(clearing.parts, clearing.of(system), moving)


def _plane(file: str, wanted: tuple[str, str] | None, system: System) -> tuple[str, str] | None:
    """The two states that the paths are drawn in; None for a system with one state."""
    if wanted is not None:
        for name in wanted:
            known_name(file, "figures.plane", name, system.state_names)
        return wanted
    names = system.state_names
    if {"x", "y"} <= set(names):
        return ("x", "y")
    return (names[0], names[1]) if len(names) > 1 else None


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


KINDS = (Kind("closed-loop", _compose),)
