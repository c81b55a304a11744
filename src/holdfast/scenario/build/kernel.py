"""Tables of a kernel, a reachable tube or a basin, to systems, regions, grids and options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.reachability.grid import Grid, grid
from holdfast.analysis.safety.safety_filter import LAWFUL, check_pace
from holdfast.errors import ScenarioError, SimulationError, suggestion
from holdfast.execution.simulation.settings import Settings
from holdfast.maths.control.velocity_tracking import track_velocity
from holdfast.maths.definitions.quantity import to_si
from holdfast.maths.definitions.region import Region
from holdfast.maths.expressions.parser import parse_number
from holdfast.scenario.build.composer import Composer, composed_system, plant_of
from holdfast.scenario.files import scenario_title
from holdfast.scenario.schema.kernel import ASKED, CERTIFIED, KernelSpec
from holdfast.scenario.schema.values import arguments_of, at, validated

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
            over = grid(system, **spec.grid.read(file, "grid", {"states": units}))
    asked = spec.march.times
    if isinstance(asked, int) and asked < 1:
        raise ScenarioError(f"{file}: march.times: got {asked}", expected="at least 1")
    options = spec.march.read(file, "march")
    horizon = options.pop("horizon")
    if isinstance(asked, int):
        options["times"] = [*(horizon * k / (asked - 1) for k in range(asked - 1)), horizon]
    if spec.march.inner and not options.setdefault("estimate_error", True):
        raise ScenarioError(
            f"{file}: march.inner: there is no estimate of the error",
            remedy="leave out estimate_error = false",
        )
    if spec.disturbance:
        options["disturbance"] = {
            n: number(v, f"disturbance.{n}") for n, v in spec.disturbance.items()
        }
    promised: dict[str, Any] | None = None
    if spec.promise is not None:
        promised = spec.promise.read(file, "promise", defaults=True)
        held, rate = promised["sample_time"], promised.get("rate")
        with at(file, "promise"):  # now, not after an hour of marching
            if held <= 0:
                raise SimulationError(f"sample_time {held:g} s", expected="above 0")
            if law is not None and rate is not None:
                check_pace(rate, held)
            Settings(promised.get("horizon", horizon), held, record_every=held)
        if spec.promise.margin is not None:
            within = about["goal"] or about["region"]
            assert within is not None
            with at(file, "promise.margin"):
                promised["margin"] = depth_inside(spec.promise.margin, within)
    certificate: dict[str, Any] = {}
    if spec.certificate is not None:
        numbers = (*system.parameters, *(about["region"].parameters if about["region"] else ()))
        parameters = {q.name: q.unit for q in numbers}
        certificate = spec.certificate.read(
            file, "certificate", {"states": units, "parameters": parameters}
        )
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
        "certificate": certificate,
        "figures": spec.figures,
        "held": {n: state(n, v, f"figures.at.{n}") for n, v in spec.figures.at.items()},
        **about,
    }


@dataclass(frozen=True)
class Apart:
    """How a problem is taken apart, and the grid of the parts.

    how: arguments of `hf.decompose`; grid: of `hf.grid`.
    """

    how: Mapping[str, Any]
    grid: Mapping[str, Any]


def _apart(file: str, spec: KernelSpec, units: Mapping[str, str]) -> Apart:
    """[decompose] and [grid]; a relative state has the unit of the first that it is made of."""
    asked = spec.decompose
    assert asked is not None
    relative = dict(units)
    for key, names in (("decompose.cut", asked.cut), ("grid.box", spec.grid.box)):
        for name in names:
            matching = [n for n in units if name == n or name.startswith(f"{n}_")]
            if not matching:
                remedy = suggestion(name, units)
                raise ScenarioError(f"{file}: {key}: unknown name", remedy=remedy)
            relative[name] = units[max(matching, key=len)]
    return Apart(
        how=asked.read(file, "decompose", {"states": relative}),
        grid=spec.grid.read(file, "grid", {"states": relative}),
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
    takes = {name for name, _, _ in arguments_of(ASKED[kind])}
    for key in spec.march.model_fields_set & spec.march.units.keys():
        if key not in takes:
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
