"""A closed loop from the tables of a scenario file: the executed law, where it begins, how it runs.

The law is made from [law], [redesign], [tracking] and [safeguard]; [law] external is another
controller, a program that `holdfast run --controller` starts. [starts], [run], [noise] and
[varied.draws] say the rest; what varies from run to run are parameters with ranges.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from holdfast.analysis.online.obstacle_slots import Clearing, check_pose
from holdfast.analysis.simulation.starts import Starts
from holdfast.errors import ScenarioError, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.closed_loop import Alive
from holdfast.host.program import TOGETHER, Programs
from holdfast.maths.catalogue import laws
from holdfast.maths.catalogue.laws.follow_leader import FOLLOWERS
from holdfast.maths.catalogue.signature import accepted_parameters, arguments, wants_law
from holdfast.maths.control.blended_redesign import redesign
from holdfast.maths.control.observer import observe, observe_set
from holdfast.maths.control.parameter_box import parameter_box
from holdfast.maths.control.safety_filter import in_order, limit_rates, over_time, safeguard
from holdfast.maths.control.unmodelled import PREFIX, cancel_unmodelled
from holdfast.maths.control.velocity_tracking import commanded, track_velocity
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import (
    UNWRITTEN,
    Parameter,
    check_unit,
    split,
    to_si,
    warn_of_turns,
)
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System, by_measurements, check_output_units
from holdfast.maths.expressions.parser import parse_condition, parse_number
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.schema.closed_loop import (
    FormationSpec,
    ObserverSpec,
    OutputsSpec,
    RedesignSpec,
    SafeguardSpec,
    ScenarioSpec,
    StartsSpec,
    VariedSpec,
)
from holdfast.scenario.schema.values import Name, Section, Text, at, validated


class ExternalSpec(Section):
    """[law] of another controller, which `holdfast run --controller` starts.

    external: true for the inputs of the system, or the names of what it commands.
    """

    external: Literal[True] | Annotated[list[Name], Field(min_length=1)]
    description: Text = ""


def commander_of(
    file: str, system: System, law: Law | Switching, controller: str
) -> Programmed | None:
    """The controller that hands the law its command; None for a law that needs none.

    controller: the command line that starts it. Raises `ScenarioError` where there is none.
    """
    names = commanded_by_another(law)
    if not names:
        return None
    if not controller:
        raise ScenarioError(
            f"{file}: law: another controller commands {', '.join(names)}",
            remedy="give holdfast run --controller 'COMMAND', in Python with_controller('COMMAND')",
        )
    return Programmed(Programs(controller, system.state_names, names))


def commanded_by_another(law: Law | Switching) -> list[str]:
    """The inputs that another controller commands; obstacles are handed to a law too."""
    return [q.name.removeprefix(COMMAND) for q in law.handed if q.name.startswith(COMMAND)]


class Programmed:
    """Processes as the controller of many runs (`handed.Commander`)."""

    most = TOGETHER

    def __init__(self, programs: Programs) -> None:
        self.programs = programs
        self.begin, self.end = programs.begin, programs.end

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """As `Commander.command`: states (runs, states), alive (runs,), commands (runs, inputs)."""
        measured = states[:, : len(self.programs.states)]  # not what the lag of actuators adds
        return np.array(self.programs.answers(t, measured.tolist(), alive.tolist()))


COMMAND = "command_"
"""How what another controller commands is named."""

Settings = dict[str, Any]
"""Of a safety filter: arguments of `SafetyFilter`."""


def composed_law(
    composer: Composer, spec: ScenarioSpec, system: System, region: Region | None
) -> tuple[Law | Switching, Settings | None]:
    """The law with the redesign, tracking and safety filter that the scenario gives.

    Also the settings by which `SafetyFilter` makes the same of a command; None where something
    else than the filter stands between.
    """
    filtering: Settings = {}
    with at(composer.file, "law"):
        compose = _external if "external" in spec.law else _own
        compose = _certified if "certificate" in spec.law else compose
        law = compose(composer, spec, system, region)
    felt = system.disturbance_names
    if spec.redesign is not None:
        law = _redesigned(composer, spec.redesign, law, region, system)
    if spec.tracking is not None:
        with at(composer.file, "tracking"):
            law = track_velocity(system, law, spec.tracking)
    if spec.observer is not None and any(PREFIX + n in felt for n in system.input_names):
        with at(composer.file, "observer"):
            if not law.handed:
                law = cancel_unmodelled(system, law)
            elif not getattr(spec.safeguard, "disturbance_measured", False):
                raise ScenarioError(
                    "nothing uses its estimate of what is unmodelled",
                    expected="[safeguard] disturbance_measured = true, for a filter of another "
                    "controller",
                )
    without = spec.obstacles is not None and not _counts(spec) and region is None  # most = 0
    if _counts(spec) or (spec.safeguard is not None and not without):
        run = spec.run.read(composer.file, "run", defaults=True)
        law, filtering = _safeguarded(composer, spec, law, region, system, run)
    if spec.observer is not None:
        law, observed = _observed(composer, spec.observer, system, law)
        composer.declare(law.parameters)
        filtering["states"] = tuple(observed.pop("measured", system.state_names))
        filtering |= observed
    direct = spec.redesign is None and spec.tracking is None
    return law, filtering if direct else None


def in_view(law: Law | Switching, region: Region | None) -> Law | Switching:
    """A follower's law with the conditions under which it never loses its leader in `region`."""
    if region is None or not isinstance(law, Law) or law.name not in FOLLOWERS:
        return law
    from holdfast.analysis.safety.gain_conditions import visibility_conditions  # SciPy

    return replace(law, conditions=(*law.conditions, *visibility_conditions(law, region)))


def _own(
    composer: Composer, spec: ScenarioSpec, system: System, region: Region | None
) -> Law | Switching:
    law = composer.law(spec.law)
    check_output_units(system, law)
    return by_measurements(system, in_view(law, region))


def _external(
    composer: Composer, spec: ScenarioSpec, system: System, region: Region | None
) -> Law | Switching:
    """The law that another controller hands its command."""
    external = validated(ExternalSpec, dict(spec.law), composer.file, "law").external
    return commanded(system, None if external is True else external)


def _certified(
    composer: Composer, spec: ScenarioSpec, system: System, region: Region | None
) -> Law:
    """The law of a certificate, whose file is given."""
    from holdfast.scenario.certificate import law_of_certificate  # with proofs

    goal = composer.region(spec.goal, "goal") if spec.goal is not None else None
    numbers = {n: float(v) for n, v in spec.disturbance.items() if isinstance(v, (int, float))}
    return law_of_certificate(composer.file, spec.law, system, region, goal, numbers)


def _observed(
    composer: Composer, spec: ObserverSpec, system: System, law: Law | Switching
) -> tuple[Switching, Settings]:
    """The law with the observer, of an estimate or of a guaranteed set, and its arguments."""
    units = {
        "states": {q.name: q.unit for q in system.states},
        "rates": {q.name: over_time(q.unit, 1) for q in system.disturbances},
    }
    arguments = {n: v for n, v in spec.read(composer.file, "observer", units).items() if v != {}}
    with at(composer.file, "observer"):
        if "error_bounds" in arguments:
            return observe_set(system, law, **arguments), arguments
        if "rate_bounds" in arguments:
            raise ScenarioError(
                "rate_bounds without error_bounds", expected="both, for a guaranteed set"
            )
        return observe(system, law, **arguments), arguments


def _safeguarded(
    composer: Composer,
    scenario: ScenarioSpec,
    law: Law | Switching,
    region: Region | None,
    system: System,
    run: Mapping[str, Any],
) -> tuple[Law | Switching, Settings]:
    """The law with the conditions of [obstacles], then those of [region] by [safeguard]."""
    file, spec = composer.file, scenario.safeguard or SafeguardSpec()
    keeps_region = scenario.safeguard is not None and region is not None
    if region is None and not _counts(scenario):
        raise ScenarioError(f"{file}: safeguard: needs a [region]")
    more = None
    if spec.constraints:
        more = composer.region({"constraints": spec.constraints}, "safeguard")
    inequalities = (*region.inequalities,) if region is not None else ()
    inequalities += more.inequalities if more is not None else ()
    numbers = (*system.parameters, *(region.parameters if region is not None else ()))
    rates = {q.name: over_time(q.unit, 1) for q in (*system.inputs, *system.states)}
    settings = spec.read(
        file,
        "safeguard",
        {
            "constraints": {c.name: c.unit for c in inequalities},
            "parameters": {p.name: p.unit for p in numbers},
            "rates": rates,
        },
    )
    limits = settings.pop("rates", None)
    filters: list[Any] = []
    if scenario.obstacles is not None and _counts(scenario):
        from holdfast.scenario.build.moving import composed_clearing  # with polygons

        clearing = composed_clearing(file, scenario.obstacles)
        filters.append(_clear(file, clearing, law, system, run, settings, scenario))
    with at(file, "safeguard"):
        held = None if run["continuous"] else run["sample_time"]
        if keeps_region:
            assert region is not None
            inside = safeguard(system, law, region, sample_time=held, constraints=more, **settings)
            filters.append(inside)
        guarded: Law | Switching = filters[0] if len(filters) == 1 else in_order(filters)
        if keeps_region:
            settings["constraints"] = more
        if _counts(scenario):
            settings["obstacles"] = clearing
        if limits:
            guarded = limit_rates(system, guarded, limits)
            settings["rates"] = limits
    composer.declare(guarded.parameters)
    return guarded, settings


def _counts(spec: ScenarioSpec) -> bool:
    """Whether the filter counts with obstacles that move."""
    return spec.obstacles is not None and spec.obstacles.most > 0


def _clear(
    file: str,
    clearing: Clearing,
    law: Law | Switching,
    system: System,
    run: Mapping[str, Any],
    settings: Settings,
    scenario: ScenarioSpec,
) -> Law:
    """The law that keeps clear of the obstacles that it is handed."""
    with at(file, "obstacles"):
        if not isinstance(law, Law):
            raise ScenarioError("the law has modes", expected="a law without modes")
        if run["continuous"]:
            raise ScenarioError("obstacles with continuous control", expected="sampled control")
        if scenario.safety is not None:
            raise ScenarioError("obstacles beside [safety]", expected="[safeguard], or none")
        names = {p.name for p in system.parameters}
        uncertain = {n: v for n, v in settings.get("uncertain", {}).items() if n in names}
        held = clearing.of(system)
        if scenario.observer is not None:
            check_pose(held, getattr(scenario.observer, "measured", ()))
        return held.law(
            system, law, gains=settings.get("gains"),
            disturbance_measured=settings.get("disturbance_measured", False),
            worst=settings.get("worst", ()), box=parameter_box(uncertain, system, None),
            scales=settings.get("scales", {}), sample_time=float(run["sample_time"]),
        )  # fmt: skip


def _redesigned(
    composer: Composer,
    spec: RedesignSpec,
    law: Law | Switching,
    region: Region | None,
    system: System,
) -> Switching:
    file = composer.file
    if region is None:
        raise ScenarioError(f"{file}: redesign: needs a [region]")
    if isinstance(law, Switching):
        raise ScenarioError(
            f"{file}: redesign: the law has modes already", expected="a law without modes"
        )
    wanted = [*spec.viable.values(), *([spec.hold] if spec.hold else [])]
    catalogue: dict[str, Any] = {function.__name__: function for function in laws.ALL}
    printable = [w for w in wanted if isinstance(w, str) and w in catalogue]
    printable = [w for w in printable if "as_printed" in arguments(catalogue[w], 1)[0]]
    printed = spec.as_printed
    if isinstance(printed, bool):
        printed = ["redesign", *printable] if printed else []
    for name in printed:
        if name not in (allowed := ["redesign", *printable]):
            raise ScenarioError(
                f"{file}: redesign.as_printed: '{name}' is not a part of this redesign",
                remedy=suggestion(name, allowed),
            )
    built: dict[str, Law] = {}
    unused = set(spec.parameters)
    for name in [w for w in wanted if isinstance(w, str)]:
        if name in built:
            continue
        if name not in catalogue:
            raise ScenarioError(
                f"{file}: redesign: unknown law '{name}'", remedy=suggestion(name, catalogue)
            )
        with at(file, "redesign"):
            leading = (law,) if wants_law(catalogue[name]) else (system,)
            standard = catalogue[name](*leading)
            takes = accepted_parameters(catalogue[name], {p.name: p for p in standard.parameters})
        mine = {k: v for k, v in spec.parameters.items() if k in takes}
        unused -= set(mine)
        table = {"name": name, **mine, **({"as_printed": True} if name in printed else {})}
        built[name] = composer.entry(laws.ALL, table, "redesign.parameters", leading)
    if unused:
        odd = sorted(unused)[0]
        raise ScenarioError(f"{file}: redesign.parameters.{odd}: no viable law has it")

    def of(entry: str | OutputsSpec, key: str) -> Law:
        if isinstance(entry, str):
            return built[entry]
        with at(file, key):
            return composer.outputs_law(key, entry, key, composer.scope())

    viable = {k: of(v, f"redesign.viable.{k}") for k, v in spec.viable.items()}
    hold = of(spec.hold, "redesign.hold") if spec.hold else None
    hold_when = None
    if spec.hold_when is not None:
        with at(file, "redesign.hold_when"):
            hold_when = parse_condition(spec.hold_when, composer.scope())
    goal = None
    if spec.goal is not None:
        goal = {}
        values = {p.symbol: p.value for p in composer.known.values()}
        for name, text in spec.goal.items():
            with at(file, f"redesign.goal.{name}"):
                goal[name] = parse_number(text, composer.scope(), values)
    with at(file, "redesign"):
        return redesign(
            law,
            region,
            viable=viable,
            layers=spec.layers,
            hold=hold,
            hold_when=hold_when,
            goal=goal,
            as_printed="redesign" in printed,
        )


def drawn_names(composer: Composer, system: System, spec: VariedSpec) -> dict[str, Parameter]:
    """The drawn names as parameters, for laws and goals whose expressions use them."""
    moving = {q.name for q in (*system.states, *system.inputs, *system.disturbances)}
    parameters = {}
    for name, draw in spec.ranges.items():
        with at(composer.file, f"varied.draws.{name}"):
            if name in moving:
                raise ScenarioError(
                    f"'{name}' is a state, an input or a disturbance", expected="a parameter"
                )
            check_unit(draw.unit or "1")
            unit = draw.unit or UNWRITTEN
            parameters[name] = Parameter(name, unit, "drawn for every run", value=0.0)
    return parameters


def drawn_ranges(composer: Composer, spec: VariedSpec) -> dict[str, tuple[float, float]]:
    """The ranges in SI units; names that are not yet declared are declared."""
    ranges = {}
    for name, draw in spec.ranges.items():
        with at(composer.file, f"varied.draws.{name}"):
            unit = composer.known.get(name, composer.drawn[name]).unit
            if draw.unit is not None and draw.unit != unit:
                raise ScenarioError(f"'{name}' has the unit {unit}", expected=f"unit = '{unit}'")
            low, high = draw.range
            ranges[name] = (to_si(low, unit), to_si(high, unit))
            composer.declare((composer.drawn[name],))
    return ranges


def known_name(file: str, key: str, name: str, names: Iterable[str]) -> str:
    if name not in (choices := list(names)):
        raise ScenarioError(f"{file}: {key}: unknown name", remedy=suggestion(name, choices))
    return name


def in_si(file: str, key: str, value: object, units: Mapping[str, str], name: str) -> float:
    known_name(file, key, name, units)
    with at(file, key):
        return to_si(value, units[name])


def _warn_of_degrees(table: StartsSpec, units: Mapping[str, str], file: str) -> None:
    """Warn of starts of angles without a unit that are more than a turn."""
    states, box = (getattr(table, name) for name in ("states", "box"))
    written = [
        (f"states.{k}.{n}", n, v) for k, state in enumerate(states) for n, v in state.items()
    ]
    written += [(f"box.{n}", n, end) for n, ends in box.items() for end in ends]
    written += [("every", n, end) for n in units if n not in box for end in table.every or ()]
    furthest: dict[str, tuple[float, str]] = {}
    for key, name, value in written:
        parts = split(value) if isinstance(value, str) else (float(value), "")
        if units.get(name) == "rad" and parts is not None and not parts[1]:
            furthest[name] = max(furthest.get(name, (0.0, "")), (parts[0], key), key=_size)
    for name, (number, key) in furthest.items():
        what = f"{file}: starts.{key}: '{name}' without a unit"
        warn_of_turns(what, number, f'"{number:g} deg"')


def _size(entry: tuple[float, str]) -> float:
    return abs(entry[0])


def starts_of(table: StartsSpec, units: Mapping[str, str], file: str) -> Starts:
    """[starts]; `every` is the interval of the states that its box leaves out."""
    _warn_of_degrees(table, units, file)
    arguments = table.read(file, "starts", {"states": units})
    box = arguments.setdefault("box", {})
    if table.every is not None:
        for n in [n for n in units if n not in box]:
            box[n] = tuple(in_si(file, f"starts.box.{n}", end, units, n) for end in table.every)
    return Starts(**arguments)


def settings_of(
    spec: ScenarioSpec | FormationSpec, units: Mapping[str, str], file: str
) -> dict[str, Any]:
    """[run] and [noise]."""
    noise = {
        f"noise_{kind}": {
            n: in_si(file, f"noise.{kind}.{n}", size, units, n)
            for n, size in getattr(spec.noise, kind).items()
        }
        for kind in ("uniform", "normal")
    }
    run = spec.run.read(file, "run", defaults=True)
    return {**run, "stepper": spec.run.stepper, **noise}
