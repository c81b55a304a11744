"""Descriptions of the catalogue's entries as text: `holdfast list` and `holdfast show`."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any

from holdfast.errors import ScenarioError, nearest, suggestion
from holdfast.maths.catalogue.signature import CATALOGUES, example
from holdfast.maths.catalogue.vehicles import vehicle_of
from holdfast.maths.definitions.bounds import Bounds
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.quantity import Parameter, Quantity
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import is_vehicle, read_vehicle, vehicle_names
from holdfast.maths.reference_fields.facts import field_facts
from holdfast.maths.reference_fields.field import Field
from holdfast.presentation.text.derivation import equations
from holdfast.scenario.files import (
    is_scenario,
    load_field,
    load_system,
    read_tables,
    read_text,
    scenario_names,
)
from holdfast.scenario.glossary import looked_up
from holdfast.scenario.glossary import rows as rows_of_glossary
from holdfast.scenario.kinds.parts import PartsScenario
from holdfast.scenario.load import load_scenario


def catalogue_lines(words: str = "") -> Iterable[str]:
    """One line for each entry, by kind; of those alone that have the words, if there are some.

    A word of the glossary gives its rows too, and the entries that these name. Raises
    `ScenarioError` where no entry has the words.
    """
    rows = list(_entries())
    if words:
        terms = looked_up(words)
        named = frozenset().union(*(term.names for term in terms))
        rows = [r for r in rows if words.lower() in f"{r[1]} {r[2]}".lower() or r[1] in named]
        rows += [("word", term.words[0], term.here) for term in terms]
    if not rows:
        near = nearest(words.lower(), _words())
        raise ScenarioError(
            f"no entry has the words '{words}'",
            remedy=f"did you mean '{near}'?" if near else "holdfast list without words names all",
        )
    width = max(len(name) for _, name, _ in rows)
    return [f"{kind:<9} {name:<{width}}  {text}" for kind, name, text in rows]


def _words() -> set[str]:
    """What a user may ask for: the words of names, of descriptions and of the glossary."""
    texts = [f"{name} {name.replace('_', ' ')} {text}" for _, name, text in _entries()]
    terms = [word for row in rows_of_glossary() for word in row.words]
    said = " ".join([*texts, *terms]).lower()
    return {*map(str.lower, terms), *re.findall(r"[a-z][a-z0-9_-]{3,}", said)}


@cache
def _entries() -> tuple[tuple[str, str, str], ...]:
    """Kind, name and description of every entry."""
    rows: list[tuple[str, str, str]] = []
    for kind, catalogue in CATALOGUES.items():
        for function in catalogue:
            rows.append((kind, function.__name__, example(function).description))
    for name in vehicle_names():
        rows.append(("vehicle", name, str(read_vehicle(name)[1]["title"])))
    for name in scenario_names():
        rows.append(("scenario", name, read_tables(name)[2]["scenario"]["title"]))
    return tuple(rows)


def describe(name: str, overrides: Sequence[str] = ()) -> str:
    """Everything about one entry; `overrides` are arguments of a system or field ("lam=2").

    Of a word of the glossary, its rows. Raises `ScenarioError` for an unknown name, or overrides of
    an entry without parameters.
    """
    load = {"system": load_system, "field": load_field}
    for kind, catalogue in CATALOGUES.items():
        for function in catalogue:
            if function.__name__ != name:
                continue
            if not overrides:
                return "\n".join(_entry(kind, function, example(function)))
            if kind in load:
                return "\n".join(_entry(kind, function, load[kind](name, overrides)))
    if overrides:
        raise ScenarioError(f"'{name}' takes no --set here", expected="a system or a field")
    if is_vehicle(name):
        return "\n".join(_vehicle(name))
    if is_scenario(name):
        loaded, text = load_scenario(name), read_text(name)[1].rstrip()
        if isinstance(loaded, PartsScenario):
            text = "\n".join([text, "", *(f"# {line}" for line in loaded.decomposition.lines())])
        return text
    if rows := looked_up(name):
        return "\n\n".join(f"{', '.join(row.words)}\n  {row.here}" for row in rows)
    entries = [f.__name__ for c in CATALOGUES.values() for f in c]
    raise ScenarioError(
        f"unknown name '{name}'",
        remedy=suggestion(name, [*entries, *vehicle_names(), *scenario_names()]),
    )


def _entry(kind: str, function: Callable[..., Any], entry: Any) -> list[str]:
    lines = [f"{kind} {function.__name__}", f"  {entry.description}", f"  source: {entry.source}"]
    text = (inspect.getdoc(function) or "").partition("\n")[2].strip("\n")
    lines += ["", *("  " + x if x else "" for x in text.splitlines())] if text else []
    if isinstance(entry, System):
        lines += _system(entry)
    elif isinstance(entry, Law):
        lines += _law(entry)
    elif isinstance(entry, Switching):
        lines += _switching(entry)
    elif isinstance(entry, Region):
        lines += _region(entry)
    elif isinstance(entry, Field):
        lines += _field(entry)
    lines += _parameters(entry.parameters)
    return lines


def _quantities(title: str, quantities: Sequence[Quantity]) -> list[str]:
    if not quantities:
        return []
    return ["", f"  {title}"] + [
        f"    {q.name:<8} [{q.unit}] {q.description}{' (angle)' if q.angle else ''}".rstrip()
        for q in quantities
    ]


def _system(system: System) -> list[str]:
    lines = _quantities("states", system.states) + _quantities("inputs", system.inputs)
    lines += _bounds(system.input_bounds)
    lines += _quantities("disturbances", system.disturbances) + _bounds(system.disturbance_bounds)
    taken = [q.name for q in (*system.states, *system.inputs, *system.parameters)]
    rates = ((f"d{n}/dt", e) for n, e in system.rates.items())
    lines += ["", "  rates", *equations(rates, taken=taken)]
    if system.measurements:
        lines += _quantities("measurements", system.measurements)
        lines += equations(((m.name, m.expression) for m in system.measurements), taken=taken)
    if system.pfaffian:
        lines += ["", "  Pfaffian constraints A(q) qdot = b"]
        for row in system.pfaffian:
            left = " + ".join(f"({c}) d{n}/dt" for n, c in row.coefficients.items())
            lines.append(f"    {left} = {row.rhs}")
    return lines


def _bounds(bounds: Bounds | None) -> list[str]:
    return [f"    bounds: {line}" for line in bounds.lines()] if bounds else []


def _law(law: Law) -> list[str]:
    lines = ["", "  reads: " + ", ".join(q.name for q in law.reads), "", "  outputs"]
    lines += equations(law.outputs.items())
    return lines + _conditions(law.conditions)


def _field(field: Field) -> list[str]:
    named = zip(field.coordinates, field.components, strict=True)
    factor = [] if field.factor == 1 else [("factor", field.factor)]
    lines = ["", f"  components [{field.unit}]{', times the factor' if factor else ''}"]
    lines += equations([*((f"F_{q.name}", e) for q, e in named), *factor])
    lines += ["", "  known facts"]
    for fact in field_facts(field):
        indent = "    " + " " * (len(fact) - len(fact.lstrip()))
        lines += textwrap.wrap(fact, 98, initial_indent=indent, subsequent_indent=indent + "  ")
    return lines


def _conditions(conditions: Sequence[GainCondition]) -> list[str]:
    lines: list[str] = []
    for condition in conditions:
        lines += [
            "",
            "  converges only if",
            *equations([(str(condition.value), condition.limit)], "<"),
            f"    otherwise {condition.consequence} ({condition.source})",
        ]
    return lines


def _switching(law: Switching) -> list[str]:
    lines = ["", "  reads: " + ", ".join(q.name for q in law.reads)]
    for mode, inner in law.modes.items():
        lines += ["", f"  mode {mode}{' (first)' if mode == law.initial else ''}"]
        lines += equations(inner.outputs.items())
    lines += ["", "  changes of mode, as soon as"]
    for change in law.transitions:
        lines += equations([(f"{change.source} -> {change.target}", change.when)], "when 0 <=")
    return lines + _conditions(law.conditions)


def _region(region: Region) -> list[str]:
    lines = ["", "  inequalities, safe where <= 0"]
    lines += equations((c.name, c.expression) for c in region.inequalities)
    lines += ["", *(f"    {c.name} [{c.unit}]: {c.description}" for c in region.inequalities)]
    return lines


def _parameters(parameters: Sequence[Parameter]) -> list[str]:
    if not parameters:
        return []
    lines = ["", "  parameters"]
    for p in parameters:
        note = " (assumed)" if p.assumed else ""
        lines.append(f"    {p.name:<18} {p.value:<10g} {p.unit:<10} {p.description}{note}".rstrip())
    return lines


def _vehicle(name: str) -> list[str]:
    vehicle = vehicle_of(name)
    lines = [f"vehicle {name}: {vehicle.title}", f"  for system {vehicle.system}"]
    if vehicle.note:
        lines.append(f"  note: {vehicle.note}")
    numbers = [*vehicle.parameters.values()]
    lines += _parameters(numbers)
    for actuator, (kind, table) in vehicle.actuators.items():
        lines += ["", f"  {kind.noun} {actuator}", *_parameters([*table.values()])[2:]]
        numbers += table.values()
    sources = dict.fromkeys(p.source for p in numbers if not p.assumed)
    return [*lines, "", "  sources", *(f"    {s}" for s in sources)]
