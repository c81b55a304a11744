"""Scenario files that ask for a kernel, a reachable set or a basin: composed, solved, tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.reachability import sets as problems
from holdfast.analysis.reachability.grid import Grid, grid
from holdfast.analysis.reachability.memory_estimate import check_trials
from holdfast.analysis.reachability.options import Marching
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import KEPT, check_pace
from holdfast.analysis.safety.validation import check_promise
from holdfast.analysis.safety.verdict import Promise
from holdfast.errors import ScenarioError, SimulationError, suggestion
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.control.velocity_tracking import track_velocity
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import to_si
from holdfast.maths.expressions.parser import parse_number
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.build.system import composed_system
from holdfast.scenario.files import scenario_title
from holdfast.scenario.schema.kernel import KINDS, KernelSpec, MarchSpec, SetFiguresSpec
from holdfast.scenario.validation import at, validated

CLOSED_LOOP, FORMATION = "closed-loop", "formation"

NEEDS = {
    "capture-basin": ("goal",),
    "backward-reachable-set": ("goal",),
    "forward-reachable-set": ("origin",),
}
"""The tables that a problem is about; the others are about [region]."""


@dataclass(frozen=True)
class KernelResult:
    """The value function, and whether its promise was kept, where it was tried.

    trouble: why it could not be tried, where it could not.
    """

    value: ValueFunction
    promise: Promise | None
    trouble: str = ""

    def answers(self, scenario: KernelScenario) -> bool:
        """Whether the set asked for was found: one that lasts is there once the march converged.

        A kernel of which nothing is left stays empty.
        """
        said = self.value.dataset.attrs
        gone = said["empty"] and scenario.kind.endswith("kernel")
        return not scenario.forever or bool(said["converged"] or gone)

    def summary(self) -> dict[str, Any]:
        """For summary.json."""
        tried = {"promise": self.promise.summary()} if self.promise else {}
        return {**self.value.summary(), **tried}


@dataclass(frozen=True)
class KernelScenario:
    """A composed scenario whose answer is a value function."""

    name: str
    file: str
    text: str
    title: str
    kind: str
    description: str
    source: str
    system: System
    region: Region | None
    goal: Region | None
    origin: Region | None
    law: Law | Switching | None
    grid: Grid
    horizon: float
    forever: bool
    inner: bool
    options: Mapping[str, Any]
    promised: Mapping[str, Any] | None
    figures: SetFiguresSpec
    held: Mapping[str, float]

    @property
    def about(self) -> Region:
        """What the march begins with."""
        found = self.goal or self.origin or self.region
        assert found is not None
        return found

    def solve(self, progress: Progress | None = None) -> ValueFunction:
        """The value function alone."""
        function: Callable[..., ValueFunction] = getattr(problems, self.kind.replace("-", "_"))
        about: tuple[Region | None, ...] = (self.about,)
        if self.kind == "capture-basin":
            about = (self.goal, self.region)
        with at(self.file, "march"):
            value = function(
                self.system, *about, self.grid, self.horizon, progress=progress, **self.options
            )
            if self.inner:
                value = value.inner()
        value.dataset.attrs.update(title=self.title, scenario=self.name, scenario_text=self.text)
        return value

    def run(self, progress: Progress | None = None) -> KernelResult:
        """The value function, and its promise tried in closed loop."""
        if self.promised is not None:
            with at(self.file, "promise"):  # before a march that may take long
                check_trials(self.promised["runs"], len(self.system.states))
        share = 1.0 if self.promised is None else 0.6

        def first(fraction: float) -> None:
            if progress is not None:
                progress(share * fraction)

        def second(fraction: float) -> None:
            if progress is not None:
                progress(share + (1 - share) * fraction)

        value = self.solve(first)
        if self.promised is None or value.values().max() <= 0:
            return KernelResult(value, None)
        try:
            with at(self.file, "promise"):
                tried = check_promise(
                    self.system,
                    value,
                    self.region,
                    goal=self.goal,
                    law=self.law,
                    progress=second,
                    **self.promised,
                )
        except ScenarioError as error:  # the march was long: its value is not thrown away
            return KernelResult(value, None, str(error))
        return KernelResult(value, tried)


def is_kernel(file: str, data: Mapping[str, Any]) -> bool:
    """Whether the tables ask for a set of states; `ScenarioError` for a kind that there is not."""
    header = data.get("scenario")
    kind = header.get("kind", CLOSED_LOOP) if isinstance(header, Mapping) else CLOSED_LOOP
    known = (CLOSED_LOOP, FORMATION, *KINDS)
    if isinstance(kind, str) and kind not in known:
        raise ScenarioError(f"{file}: scenario.kind: got '{kind}'", remedy=suggestion(kind, known))
    return kind in KINDS


def composed_kernel(file: str, text: str, data: Mapping[str, Any]) -> KernelScenario:
    """The scenario of these tables; `ScenarioError` with the key for what is wrong with them."""
    spec = validated(KernelSpec, data, file)
    kind = spec.scenario.kind
    _check_tables(file, kind, spec)
    composer = Composer(file)
    system = composed_system(composer, spec.system)
    units = {q.name: q.unit for q in system.states}

    def region(table: dict[str, Any] | None, key: str) -> Region | None:
        return composer.region(table, key) if table is not None else None

    about = {key: region(getattr(spec, key), key) for key in ("region", "goal", "origin")}
    law = composer.law(spec.law) if spec.law is not None else None
    if law is not None and spec.tracking is not None:
        with at(file, "tracking"):
            law = track_velocity(system, law, spec.tracking)
    values = {p.symbol: p.value for p in composer.known.values()}

    def seconds(value: object, key: str) -> float:
        with at(file, key):
            return to_si(value, "s")

    def number(value: object, key: str) -> float:
        with at(file, key):
            names = {n: e for n, e in composer.scope().items() if n not in units and n != "t"}
            return parse_number(value, names, values)

    def state(name: str, value: object, key: str) -> float:
        with at(file, key):
            if name not in units:
                raise ScenarioError("unknown name", remedy=suggestion(name, units))
            return to_si(value, units[name])

    with at(file, "grid"):
        over = grid(
            system,
            {
                n: (state(n, a, f"grid.box.{n}"), state(n, b, f"grid.box.{n}"))
                for n, (a, b) in spec.grid.box.items()
            },
            spec.grid.nodes,
            spec.grid.ends,
        )
    horizon = seconds(spec.march.horizon, "march.horizon")
    options = {**(spec.march.model_extra or {})}
    allowed = [*Marching.__dataclass_fields__, "start_time"]
    for key in options:
        if key not in allowed:
            raise ScenarioError(
                f"{file}: march.{key}: unknown key",
                remedy=suggestion(key, [*MarchSpec.model_fields, *allowed]),
            )
    if spec.march.inner and not options.setdefault("estimate_error", True):
        raise ScenarioError(
            f"{file}: march.inner: there is no estimate of the error",
            remedy="leave out estimate_error = false",
        )
    if spec.disturbance:
        options["disturbance"] = {
            n: number(v, f"disturbance.{n}") for n, v in spec.disturbance.items()
        }
    asked = spec.march.times
    if isinstance(asked, int):
        if asked < 1:
            raise ScenarioError(f"{file}: march.times: got {asked}", expected="at least 1")
        options["times"] = [*(horizon * k / (asked - 1) for k in range(asked - 1)), horizon]
    elif asked is not None:
        options["times"] = [seconds(v, "march.times") for v in asked]
    for key in ("arrival_steps", "disturbances"):
        if (given := getattr(spec.march, key)) is not None:
            options[key] = given
    promised: dict[str, Any] | None = None
    if spec.promise is not None:
        p = spec.promise
        promised = {"runs": p.runs, "seed": p.seed, "rate": p.rate}
        held = promised["sample_time"] = seconds(p.sample_time, "promise.sample_time")
        with at(file, "promise"):  # now, not after an hour of marching
            if held <= 0:
                raise SimulationError(f"sample_time {held:g} s", expected="above 0")
            if law is not None:
                check_pace(p.rate, held)
        if p.horizon is not None:
            promised["horizon"] = seconds(p.horizon, "promise.horizon")
        with at(file, "promise"):
            Settings(promised.get("horizon", horizon), held, record_every=held)
        if p.margin is not None:
            found = about["goal"] or about["region"]
            assert found is not None
            with at(file, "promise.margin"):
                promised["margin"] = depth_inside(p.margin, found)
    for name in spec.figures.plane or ():
        state(name, 0.0, "figures.plane")
    for name in spec.figures.inputs:
        if name not in system.input_names:
            raise ScenarioError(
                f"{file}: figures.inputs: unknown name '{name}'",
                remedy=suggestion(name, system.input_names),
            )
    if spec.figures.inputs and kind not in KEPT:
        raise ScenarioError(f"{file}: figures.inputs: a {kind} says nothing of optimal inputs")
    return KernelScenario(
        name=scenario_title(file).strip(".") or "scenario",
        file=file,
        text=text,
        title=spec.scenario.title,
        kind=kind,
        description=spec.scenario.description,
        source=spec.scenario.source,
        system=system,
        law=law,
        grid=over,
        horizon=horizon,
        forever=spec.march.forever,
        inner=spec.march.inner,
        options=options,
        promised=promised,
        figures=spec.figures,
        held={n: state(n, v, f"figures.at.{n}") for n, v in spec.figures.at.items()},
        **about,
    )


def depth_inside(value: object, region: Region) -> float:
    """A depth inside a region, in the unit of its margin; a unit is refused where that has none."""
    unit = region.margin_unit
    if isinstance(value, str) and unit == "1" and {c.unit for c in region.inequalities} != {"1"}:
        how = "by their scales" if len(region.units) < 2 else "in " + " and ".join(region.units)
        raise SimulationError(
            f"'{value}' inside region '{region.name}', whose constraints are measured {how}",
            expected="a number: 0.5 is half of every scale",
            remedy='give each constraint a scale, such as scale = "5 cm"',
        )
    return to_si(value, unit)


def _check_tables(file: str, kind: str, spec: KernelSpec) -> None:
    """Refuse a table that is missing, or that the question does not use."""
    needed = NEEDS.get(kind, ("region",))
    allowed = (*needed, *(("region",) if kind == "capture-basin" else ()))
    for key in ("region", "goal", "origin"):
        there = getattr(spec, key) is not None
        if key in needed and not there:
            raise ScenarioError(f"{file}: {key}: missing table", remedy=f"a {kind} needs it")
        if there and key not in allowed:
            raise ScenarioError(f"{file}: {key}: a {kind} does not use it", remedy="leave it out")
    for key, used in (("arrival_steps", "capture-basin"), ("disturbances", "reachable-set")):
        if getattr(spec.march, key) is not None and not kind.endswith(used):
            raise ScenarioError(f"{file}: march.{key}: a {kind} does not use it")
    if kind not in KEPT:
        for key in ("promise", "law"):
            if getattr(spec, key) is not None:
                raise ScenarioError(f"{file}: {key}: a {kind} promises nothing to a law")
    if spec.law is not None and spec.promise is None:
        raise ScenarioError(f"{file}: law: without [promise] it is not used")
    if spec.tracking is not None and spec.law is None:
        raise ScenarioError(f"{file}: tracking: there is no [law]")
