"""Tables of a scenario file to systems, laws and regions: a catalogue entry, or expressions.

A catalogue entry takes the values of the table that names it. A system written by expressions may
have a flat output (z1, zn); a region has polygons, amounts of its inequalities that count as 1, and
shapes that figures draw.

The states of [system] are selected, promoted or disturbed, and actuators may lag.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial, reduce
from typing import Any, TypeVar

import sympy as sp

from holdfast.arguments import by_present_names, for_user
from holdfast.errors import DefinitionError, ExpressionError, ScenarioError, suggestion
from holdfast.maths.catalogue import laws, regions, systems
from holdfast.maths.catalogue.signature import (
    accepted_parameters,
    arguments,
    leading_argument,
    wants_law,
)
from holdfast.maths.catalogue.vehicles import of_vehicle
from holdfast.maths.control.unmodelled import add_unmodelled
from holdfast.maths.definitions import region
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.extension import (
    actuator_units,
    both,
    dynamic_extension,
    input_limits,
    lagged,
    panning,
    per_second,
    promote,
    steady_bounds,
    subsystem,
)
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import (
    TIME,
    TIME_IN_MODE,
    Parameter,
    Quantity,
    check_unit,
    in_base_units,
    is_unit,
    split,
    symbol,
    to_si,
)
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.definitions.system import FlatOutput, Measurement, PfaffianRow, System
from holdfast.maths.expressions.parser import parse_condition, parse_formula
from holdfast.maths.nonholonomic.structure import kinematic_system
from holdfast.scenario.glossary import meant
from holdfast.scenario.schema.closed_loop import (
    SHAPES,
    BoundedSpec,
    InequalitySpec,
    LawSpec,
    ObstaclesSpec,
    OutputsSpec,
    RegionSpec,
    ShapeSpec,
    SystemSpec,
    ViewSpec,
)
from holdfast.scenario.schema.values import ParameterSpec, Section, Value, at, validated

T = TypeVar("T")


def catalogue_entry(
    file: str,
    declared: Mapping[str, Parameter],
    catalogue: Sequence[Callable[..., Any]],
    table: Mapping[str, Any],
    key: str,
    system: System | None,
    leading: Sequence[object] | None = None,
) -> Any:
    """The catalogue entry that the table names, built with the table's parameters.

    Arguments that are not numbers (a vehicle, a dimension, a list of poles) are passed as they
    are. A parameter `declared` elsewhere keeps its value unless given. `leading` holds what the
    entry is built on, by default the system if it takes one. Raises `ScenarioError`.
    """
    by_name = {function.__name__: function for function in catalogue}
    name = table["name"]
    if not isinstance(name, str) or name not in by_name:
        raise ScenarioError(
            f"{file}: {key}.name: unknown name {name!r}",
            remedy=meant(str(name), by_name),
        )
    function = by_name[name]
    with at(file, key):
        settings = by_present_names(
            function, {k: v for k, v in table.items() if k != "name"}, f"{file}: {key}: the key"
        )
    if leading is None:
        leading = (system,) if leading_argument(function) == "system" else ()
    structural, numeric = arguments(function, len(leading))
    structure = {k: settings.pop(k) for k in structural if k in settings}
    build: Callable[..., Any] = partial(function, *leading, **structure)
    if function in systems.ALL and "vehicle" in settings:
        with at(file, f"{key}.vehicle"):
            build = of_vehicle(function, settings.pop("vehicle"), structure)
    # all at once: gains may be valid only together with their k1
    plain = {k: declared[k].value for k in numeric if k in declared}
    for parameter in [k for k in settings if k in numeric]:
        with at(file, f"{key}.{parameter}"):
            plain[parameter] = in_base_units(settings[parameter])
    with at(file, key):
        try:
            standard = build(**plain)
        except DefinitionError:  # or else a unit that does not fit
            plain = {k: v for k, v in plain.items() if not isinstance(settings.get(k), str)}
            standard = build(**plain)
        units = {p.name: p.unit for p in standard.parameters}
        accepted = accepted_parameters(function, units)
    values: dict[str, float] = {}
    for parameter, value in settings.items():
        if parameter not in accepted:
            raise ScenarioError(
                f"{file}: {key}.{parameter}: '{name}' has no such parameter",
                remedy=suggestion(parameter, [*accepted, *structural]),
            )
        with at(file, f"{key}.{parameter}"):
            values[parameter] = to_si(value, units[parameter])
    for parameter in accepted:
        if parameter in declared and parameter not in values:
            values[parameter] = declared[parameter].value
    built = standard
    if values != plain:
        with at(file, key):
            built = build(**values)
    return built


def scaled_region(file: str, region: Region, scales: object, key: str) -> Region:
    """The region with the scales of the table; `ScenarioError` for an unknown name or no number."""
    with at(file, f"{key}.scale"):
        if not isinstance(scales, Mapping):
            raise ScenarioError(
                f"got {scales!r}", expected='a table, such as { too_far = "10 cm" }'
            )
        numbers = {n: to_si(v, region.inequality(n).unit) for n, v in scales.items()}
        return region.with_scales(numbers) if numbers else region


def without_obstacles(table: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The table without the keys of `ObstaclesSpec`, and these."""
    placed = {n: v for n, v in table.items() if n in ObstaclesSpec.model_fields}
    if not {"obstacles", "room"} & set(placed):
        placed = {}
    return {n: v for n, v in table.items() if n not in placed}, placed


def obstacle_region(
    composer: Composer, system: System | None, table: Mapping[str, Any], key: str
) -> Region:
    """The region outside the polygons of the table, and in its room."""
    from holdfast.planning.obstacles import obstacles  # with geometry

    assert system is not None
    spec = validated(ObstaclesSpec, table, composer.file, key)

    with at(composer.file, key):
        outside: Region = obstacles(
            system,
            {name: _metres(corners) for name, corners in spec.obstacles.items()},
            room=None if spec.room is None else _metres(spec.room),
            clearance=to_si(spec.clearance, "m"),
            position=spec.position,
        )
    composer.declare(outside.parameters)
    return outside


def view_region(
    composer: Composer, system: System | None, placed: Mapping[str, Any], table: object, key: str
) -> Region:
    """The region in which the targets of the table are in view, past the placed obstacles."""
    from holdfast.planning.sight import targets_in_view  # with geometry

    assert system is not None
    around = validated(ObstaclesSpec, placed, composer.file, key)
    spec = validated(ViewSpec, table, composer.file, f"{key}.view")
    names = {q.name: q.symbol for q in system.states}

    def si(value: str | float | None, unit: str) -> float | None:
        return None if value is None else to_si(value, unit)

    with at(composer.file, f"{key}.view"):
        seen: Region = targets_in_view(
            system,
            {n: tuple(_end(c, "m", names) for c in place) for n, place in spec.targets.items()},
            {name: _metres(corners) for name, corners in around.obstacles.items()},
            room=None if around.room is None else _metres(around.room),
            at_least=spec.at_least,
            clearance=to_si(spec.clearance, "m"),
            half_angle=si(spec.half_angle, "rad"),
            range_min=si(spec.range_min, "m"),
            range_max=si(spec.range_max, "m"),
            heading=spec.heading,
            pan=spec.pan,
            pan_limit=si(spec.pan_limit, "rad"),
            position=spec.position,
        )
    composer.declare(seen.parameters)
    return seen


def _metres(corners: Sequence[Sequence[Any]]) -> list[list[float]]:
    return [[to_si(c, "m") for c in corner] for corner in corners]


MOVING = ("cone", "footprint")
"""Shapes that move with a vehicle; all others are stationary and depend on no state."""


def composed_shape(
    file: str, key: str, spec: ShapeSpec, names: Mapping[str, sp.Expr], constants: Container[str]
) -> region.Shape:
    """The shape of one table; `constants` are the names that are constant during a run."""
    if spec.kind not in MOVING:
        names = {n: e for n, e in names.items() if n in constants or n == "pi"}
    shape = SHAPES[spec.kind]
    parts, needed = spec.read(file, key, names=names), [f.name for f in fields(shape)]
    for part in needed:
        if part not in parts:
            raise ScenarioError(f"{file}: {key}: a {spec.kind} needs '{part}'")
    for part in parts:
        if part not in needed:
            raise ScenarioError(f"{file}: {key}: a {spec.kind} has no '{part}'")
    return shape(**parts)


Names = dict[str, sp.Expr]


def _end(written: str | float, unit: str, names: Names) -> sp.Expr:
    """An end of an interval: a number, one with a unit such as "2 m/s", or an expression."""
    try:
        return parse_formula(written, names)
    except ExpressionError:
        parts = split(written) if isinstance(written, str) else None
        if parts is None or not is_unit(parts[1]):
            raise
    return sp.Float(to_si(written, unit))


@dataclass
class Composer:
    """The names declared so far while one file is read."""

    file: str
    known: dict[str, Parameter] = field(default_factory=dict)
    drawn: dict[str, Parameter] = field(default_factory=dict)
    system_built: System | None = None
    limits: Region | None = None

    @property
    def states(self) -> tuple[Quantity, ...]:
        return self.system_built.states if self.system_built else ()

    # -- catalogue entries --------------------------------------------------------------

    def entry(
        self,
        catalogue: Sequence[Callable[..., Any]],
        table: Mapping[str, Any],
        key: str,
        leading: Sequence[object] | None = None,
    ) -> Any:
        """The catalogue entry that the table names; its parameters are declared."""
        built = catalogue_entry(
            self.file, self.known, catalogue, table, key, self.system_built, leading
        )
        self.declare(built.parameters)
        return built

    def declare(self, parameters: Iterable[Parameter]) -> None:
        for parameter in parameters:
            self.known.setdefault(parameter.name, parameter)

    # -- entries written by expressions -------------------------------------------------

    def system(self, table: Mapping[str, Any]) -> System:
        """[system]: a catalogue entry or one written by expressions."""
        if "rates" not in table and "states" not in table:
            self._need_name(table, "system", "rates")
            built: System = self.entry(systems.ALL, table, "system")
        else:
            spec = validated(SystemSpec, table, self.file, "system")
            with at(self.file, "system"):
                built = self._system(spec)
        self.system_built = built
        self.declare(built.parameters)
        return built

    def _need_name(self, table: Mapping[str, Any], key: str, alternative: str) -> None:
        if "name" not in table:
            raise ScenarioError(
                f"{self.file}: {key}: missing key 'name'",
                remedy=f"name a catalogue entry, or write one by '{alternative}'",
            )

    def _parameters(
        self, table: Mapping[str, ParameterSpec | float | str], key: str
    ) -> tuple[Parameter, ...]:
        return self._each(Parameter, table, f"{key}.parameters", alone=(ParameterSpec, "value"))

    def _each(
        self,
        kind: Callable[..., T],
        table: Mapping[str, Section | Value],
        key: str,
        names: Names | None = None,
        alone: tuple[type[Section], str] = (Section, ""),
    ) -> tuple[T, ...]:
        """What the sections of a table define, by their names.

        alone: the section, and its key, of a value that stands in place of one.
        """
        made = []
        for name, written in table.items():
            if isinstance(written, Section):
                spec = written
            else:
                spec = alone[0].model_validate({alone[1]: written})
            with at(self.file, f"{key}.{name}"):
                check_unit(getattr(spec, "unit", "1"))
                said = spec.read(self.file, f"{key}.{name}", names=names, alone=spec is not written)
                made.append(kind(name, **said))
        return tuple(made)

    def _parsed(
        self, table: Mapping[str, str | float], names: Names, key: str
    ) -> dict[str, sp.Expr]:
        result = {}
        for name, text in table.items():
            with at(self.file, f"{key}.{name}"):
                result[name] = parse_formula(text, names)
        return result

    def _with_definitions(self, table: Mapping[str, str | float], names: Names, key: str) -> Names:
        names = dict(names)
        for name, text in table.items():
            with at(self.file, f"{key}.definitions.{name}"):
                Quantity(name)
                if name in names:
                    raise ScenarioError(f"'{name}' is already declared")
                names[name] = parse_formula(text, names)
        return names

    def _system(self, spec: SystemSpec) -> System:
        parameters = self._parameters(spec.parameters, "system")
        states = self._each(Quantity, spec.states, "system.states")
        inputs = self._each(Quantity, spec.inputs, "system.inputs")
        disturbances = self._each(Quantity, spec.disturbances, "system.disturbances")
        values: Names = {p.name: p.symbol for p in parameters}
        names: Names = {q.name: q.symbol for q in states + inputs + disturbances}
        names |= values | {"t": TIME}
        rows = [
            PfaffianRow(**row.read(self.file, f"system.pfaffian.{number}", names=names))
            for number, row in enumerate(spec.pfaffian)
        ]
        flat: FlatOutput | None = None
        if spec.flat_output is not None:
            key = "system.flat_output"
            with at(self.file, key):
                flat = FlatOutput(**spec.flat_output.read(self.file, key, names=names))
        said = {"name": spec.name, **spec.read(self.file, "system", names=names)}
        rates = said.pop("rates", {})
        if rows and not rates and not inputs:
            with for_user():
                moved = kinematic_system(
                    states=states, rows=tuple(rows), parameters=parameters, **said
                )
            return replace(moved, flat_output=flat)
        measured = self._each(Measurement, spec.measurements, "system.measurements", names)
        with for_user():
            return System(
                states=states,
                inputs=inputs,
                disturbances=disturbances,
                rates=rates,
                parameters=parameters,
                input_bounds=self._box(spec.inputs, values, "system.inputs"),
                disturbance_bounds=self._box(spec.disturbances, values, "system.disturbances"),
                pfaffian=tuple(rows),
                flat_output=flat,
                measurements=measured,
                **said,
            )

    def _box(self, table: Mapping[str, BoundedSpec], names: Names, key: str) -> Box | None:
        if not any(spec.bounds for spec in table.values()):
            return None
        low, high = [], []
        for name, spec in table.items():
            if spec.bounds is None:
                low.append(-sp.oo)
                high.append(sp.oo)
                continue
            with at(self.file, f"{key}.{name}.bounds"):
                unit = getattr(spec, "unit", "")
                lower, upper = (_end(end, unit, names) for end in spec.bounds)
                Box((lower,), (upper,))  # refuses an interval that is empty
                low.append(lower)
                high.append(upper)
        return Box(tuple(low), tuple(high))

    def scope(self) -> Names:
        """States, measurements, time and every parameter declared so far."""
        names: Names = {q.name: q.symbol for q in self.states}
        measured = self.system_built.measurements if self.system_built else ()
        names |= {m.name: m.expression for m in measured}
        return names | {p: symbol(p) for p in self.known} | {"t": TIME}

    def law(self, table: Mapping[str, Any]) -> Law | Switching:
        """[law]: a catalogue entry or one written by expressions."""
        if "outputs" not in table and "modes" not in table:
            self._need_name(table, "law", "outputs")
            if any(f.__name__ == table["name"] and wants_law(f) for f in laws.ALL):
                raise ScenarioError(
                    f"{self.file}: law.name: '{table['name']}' is built on a convergent law",
                    remedy="name that law here, and this one under [redesign]",
                )
            built: Law = self.entry(laws.ALL, table, "law")
            return built
        spec = validated(LawSpec, table, self.file, "law")
        self.declare((*self._parameters(spec.parameters, "law"), *self.drawn.values()))
        reads = self._reads(spec.reads)
        scope = self.scope() | {q.name: q.symbol for q in reads}  # and all its measurements
        names = self._with_definitions(spec.definitions, scope, "law")
        said = {"name": spec.name, **spec.read(self.file, "law", names=names)}
        initial, outputs = said.pop("initial", ""), said.pop("outputs", None)
        if (spec.outputs is None) == (spec.modes is None):
            raise ScenarioError(f"{self.file}: law: give either outputs or modes")
        with at(self.file, "law"), for_user():
            parameters = tuple(self.known.values())
            if outputs is not None:
                return Law(reads=reads, parameters=parameters, outputs=outputs, **said)
            modes = {
                mode: self.outputs_law(
                    mode, written, f"law.modes.{mode}", names, reads, said.get("empirical", "")
                )
                for mode, written in (spec.modes or {}).items()
            }
            transitions = []
            for number, transition in enumerate(spec.transitions):
                with at(self.file, f"law.transitions.{number}.when"):
                    level = parse_condition(transition.when, names | {"time_in_mode": TIME_IN_MODE})
                transitions.append(Transition(transition.source, transition.target, level))
            return Switching(
                modes=modes,
                transitions=tuple(transitions),
                initial=initial,
                extra_parameters=parameters,
                **said,
            )

    def _reads(self, wanted: list[str] | None) -> tuple[Quantity, ...]:
        if wanted is None:
            return self.states
        system = self.system_built
        more = (*system.disturbances, *system.measurements) if system else ()
        by_name = {q.name: q for q in (*self.states, *more)}
        for name in wanted:
            if name not in by_name:
                raise ScenarioError(
                    f"{self.file}: law.reads: '{name}' is not a state, disturbance or measurement",
                    remedy=suggestion(name, by_name),
                )
        return tuple(by_name[name] for name in wanted)

    def outputs_law(
        self,
        name: str,
        spec: OutputsSpec,
        key: str,
        names: Names,
        reads: tuple[Quantity, ...] | None = None,
        empirical: str = "",
    ) -> Law:
        """A law given only by outputs and definitions."""
        names = self._with_definitions(spec.definitions, names, key)
        outputs = self._parsed(spec.outputs, names, f"{key}.outputs")
        with for_user():
            return Law(
                name=name,
                reads=self.states if reads is None else reads,
                outputs=outputs,
                parameters=tuple(self.known.values()),
                empirical=empirical,
            )

    def region(self, table: Mapping[str, Any], key: str) -> Region:
        """[region] or [goal], with the limits of inputs that are states."""
        view = table.get("view")
        plain, placed = without_obstacles({n: v for n, v in table.items() if n != "view"})
        parts = [self._region(plain, key)] if plain or not (placed or view) else []
        parts += [view_region(self, self.system_built, placed, view, key)] if view else []
        parts += [obstacle_region(self, self.system_built, placed, key)] if placed else []
        return reduce(both, [*parts, self.limits] if key == "region" and self.limits else parts)

    def _region(self, table: Mapping[str, Any], key: str) -> Region:
        if "constraints" not in table:
            self._need_name(table, key, "constraints")
            plain = {n: v for n, v in table.items() if n != "scale"}
            built: Region = self.entry(regions.ALL, plain, key)
            return scaled_region(self.file, built, table.get("scale", {}), key)
        spec = validated(RegionSpec, {"name": key, **table}, self.file, key)
        drawn = self.drawn.values() if key == "goal" else ()
        self.declare((*self._parameters(spec.parameters, key), *drawn))
        names = self._with_definitions(spec.definitions, self.scope(), key)
        alone = InequalitySpec, "expression"
        inequalities = self._each(
            Inequality, spec.constraints, f"{key}.constraints", names, alone=alone
        )
        shapes = tuple(
            composed_shape(self.file, f"{key}.scene.{i}", shape, names, self.known)
            for i, shape in enumerate(spec.scene)
        )
        with at(self.file, key), for_user():
            return Region(
                spec.name,
                reads=self.states,
                inequalities=inequalities,
                parameters=tuple(self.known.values()),
                scene=shapes,
                **spec.read(self.file, key),
            )


LATE = ("lag", "slew")
"""Of actuators: keys of the vehicle that moves, not of the model that laws and kernels are of."""
REDUCTIONS = ("keep", "promote", "disturb", "extend", "pan", "unmodelled", *LATE)
VEHICLE = "vehicle"
"""In place of the table of lags: those of the vehicle file, with its slews."""
STEADY = "steady"
"""Replaces an interval: the velocities that the inputs can hold in still water."""


def composed_system(composer: Composer, table: Mapping[str, Any]) -> System:
    """The system of the table, reduced as given there, and registered with the composer."""
    system = composer.system({k: v for k, v in table.items() if k not in REDUCTIONS})
    if "keep" in table:
        states = table["keep"]
        with at(composer.file, "system.keep"):
            if not (
                isinstance(states, list) and states and all(isinstance(n, str) for n in states)
            ):
                raise ScenarioError(f"got {states!r}", expected='states, such as ["u", "v", "r"]')
            system = subsystem(system, tuple(states))
    if "promote" in table or "disturb" in table:
        inputs, box = _intervals(composer, system, table, "promote")
        felt, felt_box = _intervals(composer, system, table, "disturb")
        with at(composer.file, "system.promote"):
            if not inputs:
                raise ScenarioError("'disturb' without 'promote'", remedy="name the inputs")
            system = promote(system, inputs, box, disturbances=felt, disturbance_bounds=felt_box)
    if "extend" in table:
        names, rates = _intervals(composer, system, table, "extend")
        with at(composer.file, "system.extend"):
            composer.limits = input_limits(system, names)
            system = dynamic_extension(system, names, rates)
    if "pan" in table:
        with at(composer.file, "system.pan"):
            system = panning(system, to_si(table["pan"], "rad/s"))
    if "unmodelled" in table:
        names, bounds = _intervals(composer, system, table, "unmodelled")
        assert bounds is not None
        with at(composer.file, "system.unmodelled"):
            system = add_unmodelled(system, names, bounds)
    composer.system_built = system
    return system


def plant_of(composer: Composer, system: System, table: Mapping[str, Any]) -> System:
    """The system that moves: with the lag and slew of its inputs, which the law does not know."""
    if "lag" not in table and "slew" not in table:
        return system
    units = actuator_units(system)
    late = None
    if table.get("lag") != VEHICLE:
        late = _numbers(composer, table, "lag", dict.fromkeys(units, "s"))
    slew = _numbers(composer, table, "slew", {n: per_second(u) for n, u in units.items()})
    with at(composer.file, "system"):
        plant = lagged(system, late, slew or None)
    composer.declare(plant.parameters)
    return plant


def _numbers(
    composer: Composer, table: Mapping[str, Any], key: str, units: Mapping[str, str]
) -> dict[str, float]:
    """A number for each of the inputs or actuators named under `key`."""
    entries = table.get(key, {})
    with at(composer.file, f"system.{key}"):
        if not isinstance(entries, Mapping):
            vehicle = " or 'vehicle'" if key == "lag" else ""
            raise ScenarioError(f"got {entries!r}", expected=f"{{ input = number }}{vehicle}")
        for name in entries:
            if name not in units:
                raise ScenarioError("unknown name", remedy=suggestion(name, units))
        return {name: to_si(value, units[name]) for name, value in entries.items()}


def _intervals(
    composer: Composer, system: System, table: Mapping[str, Any], key: str
) -> tuple[tuple[str, ...], Box | None]:
    """The states named under `key`, and the box of their intervals."""
    if key not in table:
        return (), None
    intervals = table[key]
    inputs = {q.name: q.unit for q in system.inputs}
    units = {q.name: q.unit for q in system.states}
    if key == "extend":
        units = {n: per_second(unit) for n, unit in inputs.items()}
    if key == "unmodelled":
        units = {n: per_second(unit) for n, unit in units.items()} | inputs
    with at(composer.file, f"system.{key}"):
        if not isinstance(intervals, Mapping) or not intervals:
            raise ScenarioError(f"got {intervals!r}", expected="{ state = [lowest, highest] }")
        sides = []
        for name, interval in intervals.items():
            if name not in units:
                raise ScenarioError("unknown name", remedy=suggestion(name, units))
            if interval == STEADY and key == "promote":
                held = steady_bounds(system, (name,))
                sides.append([float(held.lower[0]), float(held.upper[0])])
                continue
            if not isinstance(interval, list) or len(interval) != 2:
                raise ScenarioError(
                    f"'{name}' has {interval!r}", expected=f"[lowest, highest] or '{STEADY}'"
                )
            sides.append([to_si(side, units[name]) for side in interval])
        low, high = zip(*sides, strict=True)
        return tuple(intervals), Box(low, high)
