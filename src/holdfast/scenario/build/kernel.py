"""Tables of a kernel, a reachable tube or a basin, to systems, regions, grids and options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.reachability.grid import Grid, grid
from holdfast.analysis.reachability.problem import Marching
from holdfast.analysis.safety.safety_filter import LAWFUL, check_pace
from holdfast.errors import ScenarioError, SimulationError, suggestion
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.control.velocity_tracking import track_velocity
from holdfast.maths.definitions.quantity import to_si
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.parser import parse_number
from holdfast.scenario.build.composer import Composer, composed_system, plant_of
from holdfast.scenario.files import scenario_title
from holdfast.scenario.schema.kernel import CERTIFIED, KernelSpec, MarchSpec
from holdfast.scenario.schema.values import at, validated

NEEDS = {
    "capture-basin": ("goal",),
    "backward-reachable-tube": ("goal",),
    "backward-reachable-at": ("goal",),
    "forward-reachable-set": ("origin",),
}
"""The tables that a problem is about; the others are about [region]."""


def kernel_parts(file: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a kernel's scenario; `ScenarioError` with the key for what is wrong."""
    spec = validated(KernelSpec, data, file)
    kind = spec.scenario.kind
    _check_tables(file, kind, spec)
    composer = Composer(file)
    system = plant_of(composer, composed_system(composer, spec.system), spec.system)
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

    apart: Apart | None = None
    over: Grid | None = None
    with at(file, "grid"):
        if spec.decompose is not None:
            apart = _apart(file, spec, units)
        else:
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
    allowed = [n for n in Marching.__dataclass_fields__ if n != "cluster"] + ["start_time"]
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
        if (setting := getattr(spec.march, key)) is not None:
            options[key] = setting
    promised: dict[str, Any] | None = None
    if spec.promise is not None:
        p = spec.promise
        promised = {"runs": p.runs, "seed": p.seed, "rate": p.rate}
        held = promised["sample_time"] = seconds(p.sample_time, "promise.sample_time")
        with at(file, "promise"):  # now, not after an hour of marching
            if held <= 0:
                raise SimulationError(f"sample_time {held:g} s", expected="above 0")
            if law is not None and p.rate is not None:
                check_pace(p.rate, held)
        if p.horizon is not None:
            promised["horizon"] = seconds(p.horizon, "promise.horizon")
        with at(file, "promise"):
            Settings(promised.get("horizon", horizon), held, record_every=held)
        if p.margin is not None:
            within = about["goal"] or about["region"]
            assert within is not None
            with at(file, "promise.margin"):
                promised["margin"] = depth_inside(p.margin, within)
    for name in spec.figures.plane or ():
        state(name, 0.0, "figures.plane")
    for name in spec.figures.inputs:
        if name not in system.input_names:
            raise ScenarioError(
                f"{file}: figures.inputs: unknown name '{name}'",
                remedy=suggestion(name, system.input_names),
            )
    if spec.figures.inputs and kind not in LAWFUL:
        raise ScenarioError(f"{file}: figures.inputs: a {kind} has no optimal inputs")
    return {
        "name": scenario_title(file).strip(".") or "scenario",
        "title": spec.scenario.title,
        "kind": kind,
        "description": spec.scenario.description,
        "source": spec.scenario.source,
        "system": system,
        "law": law,
        **({"grid": over} if apart is None else {"apart": apart}),
        "horizon": horizon,
        "forever": spec.march.forever,
        "inner": spec.march.inner,
        "options": options,
        "promised": promised,
        "certificate": _certificate(file, spec, system, about["region"]),
        "figures": spec.figures,
        "held": {n: state(n, v, f"figures.at.{n}") for n, v in spec.figures.at.items()},
        **about,
    }


@dataclass(frozen=True)
class Apart:
    """How a problem is taken apart, and the grid of the parts."""

    cut: Mapping[str, tuple[float, float] | None]
    lag_share: float | None
    box: Mapping[str, tuple[float, float]]
    nodes: int | Mapping[str, int]
    ends: Mapping[str, str]


def _apart(file: str, spec: KernelSpec, units: Mapping[str, str]) -> Apart:
    """[decompose] and [grid]; a relative state has the unit of the first that it is made of."""
    asked = spec.decompose
    assert asked is not None

    def number(name: str, value: object, key: str) -> float:
        with at(file, key):
            matching = [n for n in units if name == n or name.startswith(f"{n}_")]
            if not matching:
                raise ScenarioError("unknown name", remedy=suggestion(name, units))
            return to_si(value, units[max(matching, key=len)])

    def interval(name: str, ends: Sequence[object], key: str) -> tuple[float, float]:
        low, high = (number(name, e, f"{key}.{name}") for e in ends)
        return low, high

    return Apart(
        cut={
            n: None if ends == "kept" else interval(n, ends, "decompose.cut")
            for n, ends in asked.cut.items()
        },
        lag_share=asked.lag_share,
        box={n: interval(n, ends, "grid.box") for n, ends in spec.grid.box.items()},
        nodes=spec.grid.nodes,
        ends=spec.grid.ends,
    )


def _certificate(
    file: str, spec: KernelSpec, system: System, region: Region | None
) -> dict[str, Any]:
    """The arguments of `hf.certify` that [certificate] has, in SI units."""
    asked = spec.certificate
    if asked is None:
        return {}

    def number(key: str, value: object, of: Mapping[str, str], name: str) -> float:
        with at(file, f"certificate.{key}"):
            if name not in of:
                raise ScenarioError(f"unknown name '{name}'", remedy=suggestion(name, of))
            return to_si(value, of[name])

    arguments: dict[str, Any] = {
        n: number(n, time, {n: "s"}, n)
        for n in ("sample_time", "horizon", "delay")
        if (time := getattr(asked, n)) is not None
    }
    states = {q.name: q.unit for q in system.states}
    numbers = (*system.parameters, *(region.parameters if region is not None else ()))
    parameters = {q.name: q.unit for q in numbers}
    if asked.uncertain is not None:
        arguments["uncertain"] = {
            n: tuple(number("uncertain", end, parameters, n) for end in ends)
            for n, ends in asked.uncertain.items()
        }
    if asked.errors is not None:
        arguments["errors"] = {n: number("errors", e, states, n) for n, e in asked.errors.items()}
    counts = {n: getattr(asked, n) for n in ("cells", "inputs", "halvings")}
    return arguments | {n: count for n, count in counts.items() if count is not None}


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
    for key, used in (("arrival_steps", "capture-basin"), ("disturbances", "reachable")):
        if getattr(spec.march, key) is not None and used not in kind:
            raise ScenarioError(f"{file}: march.{key}: a {kind} does not use it")
    if kind not in LAWFUL:
        for key in ("promise", "law"):
            if getattr(spec, key) is not None:
                raise ScenarioError(f"{file}: {key}: a {kind} has no closed-loop promise")
    if spec.certificate is not None and (kind not in CERTIFIED or spec.decompose is not None):
        raise ScenarioError(f"{file}: certificate: a {kind} is not certified as a whole")
    if spec.law is not None and spec.promise is None:
        raise ScenarioError(f"{file}: law: used by [promise] only, and there is no [promise]")
    if spec.tracking is not None and spec.law is None:
        raise ScenarioError(f"{file}: tracking: there is no [law]")
