"""What each entry of the catalogue is, as text: `holdfast list` and `holdfast show`."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import sympy as sp
from sympy.printing.pretty.pretty import PrettyPrinter
from sympy.printing.pretty.pretty_symbology import greek_unicode
from sympy.printing.pretty.stringpict import prettyForm

from holdfast.catalogue import KINDS, example
from holdfast.errors import ScenarioError, suggestion
from holdfast.maths.bounds import Ball, Bounds, Box, LinearImage
from holdfast.maths.law import GainCondition, Law
from holdfast.maths.quantity import Parameter, Quantity
from holdfast.maths.region import Region
from holdfast.maths.switching import Switching
from holdfast.maths.system import System
from holdfast.maths.systems.marine_vehicle import PARAMETERS
from holdfast.maths.vehicle import load_vehicle, vehicle_names
from holdfast.scenario import load_scenario, read_text, scenario_names


def catalogue_lines() -> Iterable[str]:
    """One line for each entry, by kind."""
    rows: list[tuple[str, str, str]] = []
    for kind, catalogue in KINDS.items():
        for function in catalogue:
            rows.append((kind, function.__name__, example(function).description))
    for name in vehicle_names():
        rows.append(("vehicle", name, load_vehicle(name, PARAMETERS).title))
    for name in scenario_names():
        rows.append(("scenario", name, load_scenario(name).title))
    width = max(len(name) for _, name, _ in rows)
    return [f"{kind:<9} {name:<{width}}  {text}" for kind, name, text in rows]


def describe(name: str) -> str:
    """Everything about one entry. Raises `ScenarioError` for an unknown name."""
    for catalogue in KINDS.values():
        for function in catalogue:
            if function.__name__ == name:
                return "\n".join(_entry(function))
    if name in vehicle_names():
        return "\n".join(_vehicle(name))
    if name in scenario_names() or name.endswith(".toml"):
        load_scenario(name)
        return read_text(name)[1].rstrip()
    known = [f.__name__ for c in KINDS.values() for f in c]
    raise ScenarioError(
        f"nothing is called '{name}'",
        remedy=suggestion(name, [*known, *vehicle_names(), *scenario_names()]),
    )


def _entry(function: Callable[..., Any]) -> list[str]:
    entry = example(function)
    kind = next(kind for kind, entries in KINDS.items() if function in entries)
    lines = [f"{kind} {function.__name__}", f"  {entry.description}", f"  source: {entry.source}"]
    lines += ["", *("  " + x if x else "" for x in inspect.getdoc(function).splitlines()[1:])]  # type: ignore[union-attr]
    if isinstance(entry, System):
        lines += _system(entry)
    elif isinstance(entry, Law):
        lines += _law(entry)
    elif isinstance(entry, Switching):
        lines += _switching(entry)
    elif isinstance(entry, Region):
        lines += _region(entry)
    lines += _parameters(entry.parameters)
    return lines


WIDTH = 100


def _equations(pairs: Iterable[tuple[str, sp.Expr]], relation: str = "=") -> list[str]:
    """Equations set in two dimensions; long ones are split by naming their parts."""
    given = dict(pairs)
    if max(_width(e) for e in given.values()) > WIDTH:
        shared, reduced = sp.cse(
            list(given.values()), symbols=sp.numbered_symbols("w", start=1), order="none"
        )
        given = {str(s): e for s, e in shared} | dict(zip(given, reduced, strict=True))
    lines = []
    for left, expression in given.items():
        rows = _pretty(expression)
        if max(len(row) for row in rows) > WIDTH:
            rows = textwrap.wrap(sp.sstr(expression), WIDTH, break_long_words=False)
        head = f"    {left} {relation} "
        middle = len(rows) // 2
        lines += [
            (head if i == middle else " " * len(head)) + row.rstrip() for i, row in enumerate(rows)
        ]
    return lines


class _Printer(PrettyPrinter):
    """Names as they are written in a scenario, Greek letters excepted."""

    def _print_Symbol(self, e: sp.Symbol) -> prettyForm:  # noqa: N802
        return prettyForm(greek_unicode.get(e.name, e.name))


def _pretty(expression: sp.Expr) -> list[str]:
    text: str = _Printer({"use_unicode": True, "wrap_line": False}).doprint(expression)
    return text.splitlines()


def _width(expression: sp.Expr) -> int:
    return max(len(row) for row in _pretty(expression))


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
    lines += ["", "  rates", *_equations((f"d{n}/dt", e) for n, e in system.rates.items())]
    if system.pfaffian:
        lines += ["", "  Pfaffian constraints A(q) qdot = b"]
        for row in system.pfaffian:
            left = " + ".join(f"({c}) d{n}/dt" for n, c in row.coefficients.items())
            lines.append(f"    {left} = {row.rhs}")
    return lines


def _bounds(bounds: Bounds | None) -> list[str]:
    if isinstance(bounds, Box):
        pairs = zip(bounds.lower, bounds.upper, strict=True)
        return ["    bounds: box " + ", ".join(f"[{a}, {b}]" for a, b in pairs)]
    if isinstance(bounds, Ball):
        return [f"    bounds: ball of radius {bounds.radius}"]
    if isinstance(bounds, LinearImage):
        return [
            f"    bounds: {bounds.matrix.tolist()} times ({', '.join(bounds.actuators)})",
            *_bounds(bounds.of),
        ]
    return []


def _law(law: Law) -> list[str]:
    lines = ["", "  reads: " + ", ".join(q.name for q in law.reads), "", "  outputs"]
    lines += _equations(law.outputs.items())
    return lines + _conditions(law.conditions)


def _conditions(conditions: Sequence[GainCondition]) -> list[str]:
    lines: list[str] = []
    for condition in conditions:
        lines += [
            "",
            "  converges only if",
            *_equations([(str(condition.value), condition.limit)], "<"),
            f"    otherwise {condition.consequence} ({condition.source})",
        ]
    return lines


def _switching(law: Switching) -> list[str]:
    lines = ["", "  reads: " + ", ".join(q.name for q in law.reads)]
    for mode, inner in law.modes.items():
        lines += ["", f"  mode {mode}{' (first)' if mode == law.initial else ''}"]
        lines += _equations(inner.outputs.items())
    lines += ["", "  changes of mode, as soon as"]
    for change in law.transitions:
        lines += _equations([(f"{change.source} -> {change.target}", change.when)], "when 0 <=")
    return lines + _conditions(law.conditions)


def _region(region: Region) -> list[str]:
    lines = ["", "  inequalities, safe where <= 0"]
    lines += _equations((c.name, c.expression) for c in region.inequalities)
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
    vehicle = load_vehicle(name, PARAMETERS)
    lines = [f"vehicle {name}: {vehicle.title}", f"  for system {vehicle.system}"]
    if vehicle.note:
        lines.append(f"  note: {vehicle.note}")
    lines += _parameters(tuple(vehicle.parameters.values()))
    sources = dict.fromkeys(p.source for p in vehicle.parameters.values() if not p.assumed)
    return [*lines, "", "  sources", *(f"    {s}" for s in sources)]
