"""Scenario files: one TOML file, one experiment. Reads, checks, composes and runs it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.simulate import simulate
from holdfast.analysis.simulation.starts import Starts
from holdfast.arguments import checked
from holdfast.errors import ScenarioError, suggestion
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import to_si
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.parser import parse_expression, parse_number
from holdfast.planning.course import Course
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.build.law_chain import composed_law
from holdfast.scenario.build.system import composed_system
from holdfast.scenario.build.varied import drawn_names, drawn_ranges
from holdfast.scenario.files import overridden, read_tables, scenario_title
from holdfast.scenario.formation import composed_formation, is_formation
from holdfast.scenario.kernel import KernelScenario, composed_kernel, is_kernel
from holdfast.scenario.kernel_reference import check_kernels
from holdfast.scenario.overrides import check_overrides
from holdfast.scenario.safety_filter import Safety, composed_safety
from holdfast.scenario.schema.closed_loop import FiguresSpec, Header, RunSpec, ScenarioSpec
from holdfast.scenario.schema.formation import FormationFigures, FormationHeader, FormationSpec
from holdfast.scenario.validation import at, validated


@dataclass(frozen=True)
class Scenario:
    """A composed scenario, ready to run; `law` is the one before [safety], which `kept` adds."""

    name: str
    file: str
    text: str
    title: str
    kind: str
    description: str
    source: str
    system: System
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
    course: Course | None = None

    @property
    def runs(self) -> int:
        """How many runs there are: one from every start, or one at every vertex of [varied]."""
        return self.starts.count * len(self.varied.corners)

    def kept(self, progress: Progress | None = None) -> Scenario:
        """This scenario with the law kept in the kernel of [safety], which is computed."""
        if self.safety is None:
            return self
        with at(self.file, "safety"):
            timing = {n: float(self.settings[n]) for n in ("horizon", "sample_time", "delay")}
            law = self.safety.kept(
                self.system, self.law, **timing, region=self.region, progress=progress
            )
        return replace(self, law=law, safety=None)

    def run(self, progress: Progress | None = None, part: range | None = None) -> Result:
        """Simulate every start of the scenario; the kernel of [safety] is computed before.

        part: of all runs those to simulate; every run is the same in any part.
        """
        law = self.kept(progress).law
        with at(self.file, "run"):
            return simulate(
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
                },
                progress=progress,
                **self.settings,
            )


@checked
def load_scenario(
    name: str, overrides: Iterable[str] = (), runs: int | None = None, seed: int | None = None
) -> Scenario | KernelScenario:
    """The scenario of that name or file, with `key=value` overrides.

    `runs` sets how many starts are used: the given states first, then random ones; of a kernel,
    how many states of it its promise is tried from. Raises `ScenarioError` naming the file, the
    key, what was got and what is allowed.
    """
    changes = list(overrides)

    def compose(changes: Sequence[str]) -> list[Scenario | KernelScenario]:
        return [scenario_of(*read_tables(name, changes), runs, seed)]

    (loaded,) = made = compose(changes)
    check_overrides(changes, made, compose)
    return loaded


def scenario_of(
    shown: str, text: str, data: dict[str, Any], runs: int | None = None, seed: int | None = None
) -> Scenario | KernelScenario:
    """The scenario of tables that are not checked yet; `shown` is its name or file."""
    if is_formation(data):
        if runs is not None:
            raise ScenarioError(f"--runs: {shown} has one start", remedy="leave it out")
        text, data = _seeded(text, data, seed)
        return _formation(shown, text, validated(FormationSpec, data, shown))
    if is_kernel(shown, data):
        more = {"runs": runs, "seed": seed}
        given = {k: v for k, v in more.items() if v is not None}
        if given and "promise" not in data:
            raise ScenarioError(f"--{min(given)}: {shown} has no [promise]", remedy="leave it out")
        return composed_kernel(
            shown, *overridden(text, data, [f"promise.{k}={v}" for k, v in given.items()])
        )
    text, data = _seeded(text, data, seed)
    check_kernels(shown, data)
    return composed(shown, text, validated(ScenarioSpec, data, shown), runs)


def _seeded(text: str, data: dict[str, Any], seed: int | None) -> tuple[str, dict[str, Any]]:
    return overridden(text, data, [] if seed is None else [f"run.seed={seed}"])


def composed(shown: str, text: str, spec: ScenarioSpec, runs: int | None = None) -> Scenario:
    """The scenario of tables that are checked already; `shown` is its name or file."""
    if runs is not None:
        if runs < 1:
            raise ScenarioError(f"--runs is {runs}", expected="at least 1")
        given = spec.starts.states[:runs]
        starts = spec.starts.model_copy(update={"states": given, "random": runs - len(given)})
        spec = spec.model_copy(update={"starts": starts})
        text += f"# runs: {runs}\n"
    return _composed(shown, text, spec)


def _about(file: str, text: str, header: Header | FormationHeader) -> dict[str, Any]:
    """What every scenario says of itself."""
    return {
        "name": scenario_title(file).strip(".") or "scenario",
        "file": file,
        "text": text,
        "title": header.title,
        "kind": header.kind,
        "description": header.description,
        "source": header.source,
    }


def _formation(file: str, text: str, spec: FormationSpec) -> Scenario:
    parts = composed_formation(file, spec)
    units = {q.name: q.unit for q in parts.system.states}
    return Scenario(
        **_about(file, text, spec.scenario),
        system=parts.system,
        law=parts.law,
        region=parts.region,
        goal=parts.goal,
        starts=parts.starts,
        settings=_settings(spec, units, file),
        disturbance={},
        plant={},
        varied=Varied(),
        reference={},
        plane=("xL", "yL"),
        figures=spec.figures,
        start_outside=False,
        course=parts.course,
    )


def _composed(file: str, text: str, spec: ScenarioSpec) -> Scenario:
    composer = Composer(file)
    system = composed_system(composer, spec.system)
    composer.drawn = drawn_names(composer, system, spec.varied)
    region = composer.region(spec.region, "region") if spec.region is not None else None
    law = composed_law(composer, spec, system, region)  # may use the region's parameters
    goal = composer.region(spec.goal, "goal") if spec.goal is not None else None
    draws = drawn_ranges(composer, spec.varied)
    values = {p.symbol: p.value for p in composer.known.values()}
    names = {n: e for n, e in composer.scope().items() if n not in system.state_names}
    timeless = {n: e for n, e in names.items() if n != "t"}

    def number(expression: object, key: str) -> float:
        with at(file, key):
            return parse_number(expression, timeless, values)

    def expressions(table: Mapping[str, object], key: str) -> dict[str, sp.Expr]:
        return {k: _parsed(file, f"{key}.{k}", v, timeless) for k, v in table.items()}

    with at(file, "varied"):
        varied = Varied(
            draws,
            expressions(spec.varied.values, "varied.values"),
            expressions(spec.varied.plant, "varied.plant"),
            {name: composer.known[name].unit for name in draws},
            spec.varied.of_vertices,
        )
    units = {q.name: q.unit for q in system.states}
    return Scenario(
        **_about(file, text, spec.scenario),
        system=system,
        law=law,
        region=region,
        goal=goal,
        starts=_starts(spec, units, file),
        settings=_settings(spec, units, file),
        disturbance={
            key: _parsed(file, f"disturbance.{key}", value, names)
            for key, value in spec.disturbance.items()
        },
        plant={
            key: _si(file, f"plant.{key}", value, {p.name: p.unit for p in system.parameters}, key)
            for key, value in spec.plant.items()
        },
        varied=varied,
        reference={
            _known(file, f"reference.{k}", k, units): number(v, f"reference.{k}")
            for k, v in spec.reference.items()
        },
        plane=_plane(file, spec.figures.plane, system),
        figures=spec.figures,
        start_outside=spec.starts.start_outside,
        safety=composed_safety(file, spec, system),
    )


def _plane(file: str, wanted: tuple[str, str] | None, system: System) -> tuple[str, str] | None:
    """The two states that the paths are drawn in; None for a system with one state."""
    if wanted is not None:
        for name in wanted:
            _known(file, "figures.plane", name, system.state_names)
        return wanted
    names = system.state_names
    if {"x", "y"} <= set(names):
        return ("x", "y")
    return (names[0], names[1]) if len(names) > 1 else None


def _parsed(file: str, key: str, value: object, names: Mapping[str, sp.Expr]) -> sp.Expr:
    with at(file, key):
        return parse_expression(value, names)


def _known(file: str, key: str, name: str, known: Iterable[str]) -> str:
    if name not in (choices := list(known)):
        raise ScenarioError(f"{file}: {key}: unknown name", remedy=suggestion(name, choices))
    return name


def _si(file: str, key: str, value: object, units: Mapping[str, str], name: str) -> float:
    _known(file, key, name, units)
    with at(file, key):
        return to_si(value, units[name])


def _starts(spec: ScenarioSpec, units: Mapping[str, str], file: str) -> Starts:
    given = spec.starts
    box = dict(given.box)
    if given.every is not None:
        box = dict.fromkeys(units, given.every) | box
    return Starts(
        states=[
            {k: _si(file, f"starts.states.{i}.{k}", v, units, k) for k, v in state.items()}
            for i, state in enumerate(given.states)
        ],
        random=given.random,
        active=[tuple(names) for names in given.active],
        box={
            k: (
                _si(file, f"starts.box.{k}", low, units, k),
                _si(file, f"starts.box.{k}", high, units, k),
            )
            for k, (low, high) in box.items()
        },
    )


def _settings(
    spec: ScenarioSpec | FormationSpec, units: Mapping[str, str], file: str
) -> dict[str, Any]:
    run: RunSpec = spec.run
    times = dict.fromkeys(("horizon", "sample_time", "record_every", "delay"), "s")
    settings: dict[str, Any] = {n: _si(file, f"run.{n}", getattr(run, n), times, n) for n in times}
    for name in (
        "substeps",
        "stepper",
        "absolute",
        "relative",
        "tolerance",
        "switch_limit",
        "seed",
        "continuous",
    ):
        settings[name] = getattr(run, name)
    for kind in ("uniform", "normal"):
        settings[f"noise_{kind}"] = {
            k: _si(file, f"noise.{kind}.{k}", v, units, k)
            for k, v in getattr(spec.noise, kind).items()
        }
    return settings
