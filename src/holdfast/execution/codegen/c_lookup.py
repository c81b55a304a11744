"""The table of a kernel or of a certificate as C, and how an exported law looks it up."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from holdfast.errors import DefinitionError
from holdfast.execution.codegen.c_table_file import INCLUDES, declarations, loader
from holdfast.execution.interpolate import numbers_of_places
from holdfast.execution.table_in_parts import in_memory
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.lookup import CellLookup, Lookup
from holdfast.maths.definitions.switching import Switching

GRID = "hf_low, hf_steps, hf_shape, hf_periodic"

SHORT = 2**16
"""An entry of a table of cells is a whole number below it."""


class CTable:
    """The parts of an exported law that a table has.

    text: the numbers; needed: the scalar functions that look them up. found: the statements that
    fill `look` with what the table says; asked: those that note whether the state was outside.
    said: what is to be known of whoever calls it. included, declared: for a table `in_file`, what
    its loader includes and what the header says of it; guard: what NAME_step does without it.
    """

    needed: tuple[str, ...]
    said: tuple[str, ...] = ()
    included: tuple[str, ...] = ()
    declared: tuple[str, ...] = ()
    guard: str = ""

    @classmethod
    def of(cls, law: Law | Switching, name: str, *, in_file: bool) -> CTable | None:
        """Of the law `name` in C; None if it has no table."""
        if law.lookup is not None:
            return cls(law.lookup, name, in_file=in_file)
        if in_file:
            raise DefinitionError(f"law '{law.name}' has no table", expected='table="text"')
        return None

    def __init__(self, lookup: Lookup, name: str, *, in_file: bool = False) -> None:
        axes, count = len(lookup.places), len(lookup.symbols)
        if isinstance(lookup, CellLookup):
            if in_file:
                raise DefinitionError(
                    "the table of a certificate is in the source",
                    expected='a kernel, for table="file"',
                )
            rows = lookup.table[6]  # type: ignore[index]
            call = (
                f"hf_look_in_cells(hf_entries, place, hf_numbers, hf_shape, hf_periodic, {axes}, "
                f"{rows}, {count}, look, near)"
            )
            self.text, self.needed = _cells(lookup), ("look_in_cells",)
            self.said = _counted(lookup)
            room = f"    double look[{count}];\n    long near[{2 * axes}];\n"
            self.found = f"{_placed(axes, 'kept')}{room}    (void){call};\n"
            self.asked = (
                f"{_placed(axes, 's->kept')}    {{\n{room}    s->outside = !{call};\n    }}\n"
            )
            self.outside = (
                "1 if the state was in no certified cell: the input is that of the nearest one"
            )
            return
        numbers, whole = numbers_of_places(axes)
        self.text, self.needed = _grid(lookup, name if in_file else ""), ("look_up", "beyond_grid")
        if in_file:
            self.included, self.declared = (INCLUDES,), tuple(declarations(name))
            self.guard = _unloaded(name)
        self.found = (
            f"{_placed(axes, 'kept')}    double look[{count}], between[{numbers}];\n"
            f"    long near[{whole}];\n"
            f"    hf_look_up(hf_values, place, {GRID}, {axes}, {count - 1}, look, between, near);\n"
        )
        call = f"hf_beyond_grid(place, {GRID}, {axes}, {int(lookup.timed)})"
        self.asked = f"{_placed(axes, 's->kept')}    s->outside = {call};\n"
        self.outside = (
            "1 if the state was outside the grid of the kernel: the nearest place of the grid is "
            "used"
        )


def _placed(axes: int, kept: str) -> str:
    return f"    double place[{axes}];\n    hf_place(t, seen, {kept}, p, place);\n"


def _unloaded(name: str) -> str:
    upper = name.upper()
    return (
        "    if (!hf_values) {\n"
        f"        for (int i = 0; i < {upper}_INPUTS; i++) command[i] = NAN;\n"
        f"        for (int i = 0; i < {upper}_ACTUATORS; i++) actuators[i] = NAN;\n"
        "        s->outside = 1;\n        return s->mode;\n    }\n"
    )


def _grid(lookup: Lookup, loaded_by: str) -> str:
    """The grid and the values of a table, for the functions of `interpolate.py`.

    loaded_by: the name of the law, where the values are in a file.
    """
    table: Any = lookup.table
    values, low, steps, shape, periodic = table
    kind = "float" if values.dtype == np.float32 else "double"
    grid = (
        f"typedef {kind} hf_table;\n"
        f"{_doubles('low', low)}{_doubles('steps', steps)}{_axes(shape, periodic)}"
    )
    if loaded_by:
        return grid + loader(lookup, loaded_by)
    values = in_memory(values)
    return f"{grid}static const hf_table hf_values[{len(values)}] = {{\n{_listed(values)}\n}};\n"


def _cells(lookup: CellLookup) -> str:
    """The edges of the cells, the rows and the entries, for `look_in_cells.py`."""
    table: Any = lookup.table
    entries, _, _, shape, periodic, numbers, _ = table
    if not entries.max() < SHORT:
        raise DefinitionError(
            f"a table of cells with the entry {int(entries.max())}",
            expected=f"fewer than {SHORT // 2} inputs and {SHORT} sampling periods in C",
        )
    return (
        "typedef unsigned short hf_table;\n"
        f"{_axes(shape, periodic)}{_doubles('numbers', numbers)}"
        f"static const hf_table hf_entries[{len(entries)}] = {{\n"
        f"{_listed([int(e) for e in entries], 16)}\n}};\n"
    )


def _counted(lookup: CellLookup) -> tuple[str, ...]:
    """What the certificate of a table of cells promises for."""
    late = f"late by up to {lookup.delay!r} s" if lookup.delay else "without delay"
    errors = [
        f"{place} measured to {error!r}"
        for place, error in zip(lookup.places, lookup.errors, strict=False)
        if error
    ]
    return (
        f"certified for inputs that are held for {lookup.hold!r} s, {late}",
        f"certified for {', '.join(errors)}" if errors else "certified for exact measurements",
    )


def _axes(shape: Iterable[Any], periodic: Iterable[Any]) -> str:
    counts, turns = [int(k) for k in shape], [int(k) for k in periodic]
    return (
        f"static const long hf_shape[{len(counts)}] = {{{_listed(counts)}}};\n"
        f"static const long hf_periodic[{len(turns)}] = {{{_listed(turns)}}};\n"
    )


def _doubles(name: str, values: Any) -> str:
    return f"static const double hf_{name}[{len(values)}] = {{{_listed(values)}}};\n"


def _listed(values: Iterable[Any], across: int = 8) -> str:
    """The numbers of an array, so many per line."""
    texts = [_number(v) for v in values]
    return ",\n".join(", ".join(texts[k : k + across]) for k in range(0, len(texts), across))


def _number(value: Any) -> str:
    """The shortest text that reads back as this number."""
    if isinstance(value, int):
        return str(value)
    if math.isfinite(value):
        return f"{value!s}f" if isinstance(value, np.float32) else repr(float(value))
    return "NAN" if math.isnan(value) else ("INFINITY" if value > 0 else "-INFINITY")
