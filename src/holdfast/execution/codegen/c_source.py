"""A law as one file of C99 and its header: no allocation, and no library but libm.

Every name at file scope begins with the name of the law, so that several laws can be in one
program, and even in one translation unit. What other files see (sizes, the type of the state,
parameters, `_start`, `_step`) is one block with an include guard. The header is that block, and the
file of C repeats it, so that it compiles alone and with its header alike.

The table of a kernel or of a certificate is a part of it, or a file of its own that the C loads.
That is a header, which the C repeats byte by byte, and the numbers in the order of the grid:

| bytes | what |
|---|---|
| 8 | "HFTABLE" and a zero |
| 4 | the version of this layout, 1 |
| 4 | bytes of a number: 4 or 8 |
| 8 | the number of axes |
| 8 | how many numbers there are |
| 32 | the SHA-256 of the numbers |
| 8 each | the nodes of every axis |

Whole numbers and numbers are little-endian; zeros fill the header up to a multiple of 64 bytes.
"""

from __future__ import annotations

import hashlib
import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from holdfast._version import __version__
from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import AnyArray
from holdfast.execution.codegen.c_obstacles import CObstacles
from holdfast.execution.codegen.c_printer import (
    BITS,
    c_body,
    c_functions,
    c_helpers,
    c_own,
    scalars_c,
)
from holdfast.execution.codegen.closed_loop_program import ControllerProgram, controller_program
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.codegen.scalar_reader import Scalars, scalars
from holdfast.execution.foreseen import CUTS, numbers_of_search
from holdfast.execution.interpolate import numbers_of_places
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.execution.table_in_parts import in_memory, in_turn
from holdfast.host.files import atomic_file
from holdfast.maths.definitions.law import CellLookup, Foresight, Law, Lookup, Safeguard
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import symbols_of


def c_name(name: str) -> str:
    """The name as a C identifier: underscores for other characters, law_ before a digit."""
    return re.sub(r"^(?=\d|$)", "law_", re.sub(r"\W", "_", name, flags=re.ASCII))


def c_file(name: str) -> str:
    """The text of a file of this package's folder `c`."""
    return (files("holdfast.execution.codegen") / "c" / f"{name}.c").read_text("utf-8")


def c_comment(*lines: str) -> str:
    """The lines as a C comment; sequences that would end it are replaced."""
    plain = [
        re.sub(r"\?(?=\?)", "? ", " ".join(x.split()).replace("*/", "* /").replace("/*", "/ *"))
        for x in lines
    ]
    if len(plain) == 1:
        return f"/* {plain[0]} */"
    return "/* " + "\n".join([plain[0], *(f" * {x}".rstrip() for x in plain[1:]), " */"])


LAYOUT = 1
DIGEST = 32
"""Where in the header the digest begins."""

MOST_AS_TEXT = 2**16
"""Numbers up to which `holdfast export-c` writes a table into the source."""

FAULTS = {
    "READY": "the table can be used",
    "NOT_FOUND": "the file cannot be opened",
    "TRUNCATED": "the file is shorter or longer than the table",
    "NONE": "the file is no table",
    "VERSION": "the table has another layout",
    "BYTE_ORDER": "this processor is not little-endian",
    "OTHER": "the table is that of another law",
    "DAMAGED": "the numbers are not those that were written",
    "ALIGNMENT": "the memory begins at an address at which such numbers cannot",
    "MEMORY": "there is no memory for the table",
}
"""What NAME_load and NAME_use answer, in the order of their numbers."""

INCLUDES = """#if defined(__unix__) || defined(__APPLE__)
#define HF_MAPS
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#else
#include <stdio.h>
#include <stdlib.h>
#endif"""


@checked
def export_c_table(law: Law | Switching, path: str | Path) -> Path:
    """Write the table of the law, for what `export_c(..., table="file")` wrote.

    path: of the file.

    Raises `DefinitionError` for a law without the table of a kernel, and `OutputError` where the
    file cannot be written.

    >>> hf.export_c_table(hf.safety_law(cart, kernel, brake, ahead=False), "brake.bin")
    PosixPath('brake.bin')
    """
    if law.lookup is None or isinstance(law.lookup, CellLookup):
        raise DefinitionError(
            f"law '{law.name}' has no kernel", expected="the law of a kernel, whose table is large"
        )
    path = Path(path)
    with atomic_file(path) as partial, partial.open("wb") as file:
        file.write(header_of(law.lookup))
        for values in _numbers(law.lookup):
            file.write(_bytes(values))
    return path


def numbers_of(lookup: Lookup | None) -> int:
    """How many numbers the table of a kernel has; 0 without one."""
    if lookup is None or isinstance(lookup, CellLookup):
        return 0
    table: Any = lookup.table
    return int(np.prod([int(n) for n in table[3]]))


def header_of(lookup: Lookup) -> bytes:
    """The bytes before the numbers."""
    table: Any = lookup.table
    shape, digest = [int(n) for n in table[3]], hashlib.sha256()
    for values in _numbers(lookup):
        digest.update(_bytes(values))
    size, count = table[0].dtype.itemsize, numbers_of(lookup)
    said = struct.pack("<8sIIQQ", b"HFTABLE\0", LAYOUT, size, len(shape), count)
    text = said + digest.digest() + struct.pack(f"<{len(shape)}Q", *shape)
    return text + bytes(-len(text) % 64)


def loader(lookup: Lookup, name: str) -> str:
    """The C that loads the table, its names without the prefix of the law."""
    header = header_of(lookup)
    rows = (", ".join(map(str, header[k : k + 16])) for k in range(0, len(header), 16))
    count = numbers_of(lookup)
    return (
        f"{_fits(count)}#define HF_HEADER {len(header)}\n#define HF_DIGEST {DIGEST}\n"
        f"#define HF_COUNT ((size_t){count}u)\n"
        f"static const unsigned char hf_header[HF_HEADER] = {{\n    "
        + ",\n    ".join(rows)
        + "\n};\n"
        + _named(c_file("table"), name)
    )


def declarations(name: str) -> list[str]:
    """What the header says of loading."""
    text = [f"    NAME_TABLE_{fault}, /* {said} */" for fault, said in FAULTS.items()]
    lines = [
        "/* The table of the law is in a file. NAME_load opens it, NAME_use takes it from memory",
        "   that stays (flash, say). Each answers one of these; unless READY, NAME_step gives NAN.",
        "   The file is mapped: while it is loaded nobody may write to it; another one may be",
        "   given its name (rename), and be loaded then.",
        "   With NAME_LINKED defined as a path, the table is linked, and NAME_load takes that. */",
        "enum {",
        *text,
        "};",
        "int NAME_load(const char *path);",
        "int NAME_use(const void *memory, size_t size);",
        "void NAME_unload(void);",
        "",
    ]
    return _named("\n".join(lines), name).split("\n")


def _fits(count: int) -> str:
    """That whole numbers of C can count the numbers of a table."""
    if count < 2**31:
        return ""
    error = f"this table of {count} numbers needs a long of 64 bits"
    return f"#include <limits.h>\n#if LONG_MAX < {count}\n#error {error}\n#endif\n"


def _named(text: str, name: str) -> str:
    for part in ("TABLE_", "LINKED"):
        text = text.replace(f"NAME_{part}", f"{name.upper()}_{part}")
    return text.replace("NAME_", f"{name}_")


def _numbers(lookup: Lookup) -> Iterator[AnyArray]:
    """The numbers of the table, little-endian, in parts."""
    table: Any = lookup.table
    for part in in_turn(table[0]):
        values = np.ascontiguousarray(part)
        yield values.astype(values.dtype.newbyteorder("<"), copy=False)


def _bytes(values: AnyArray) -> memoryview:
    """The bytes of an array, without a copy."""
    return memoryview(values.view(np.uint8).data)


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


def _placed(axes: int, memory: str) -> str:
    return f"    double place[{axes}];\n    hf_place(t, seen, {memory}, p, place);\n"


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


SLACK = "0 if an input was admissible, else the relaxation of the safeguard"

PLAIN = (
    "/* No fused operations, so that the results have the very bits of the simulated law. */",
    "#if defined(__clang__)",
    "#pragma STDC FP_CONTRACT OFF",
    "#elif defined(__GNUC__)",
    '#pragma GCC optimize("fp-contract=off")',
    "#endif",
)


@checked
def export_c(
    system: System, law: Law | Switching, name: str = "controller", *, table: str = "text"
) -> str:
    """The law as C99, with its modes, its memory, and the limits of the actuators.

    The file allocates no memory and needs no library but libm, of which it calls square roots and
    roundings only. NAME is `name` with underscores in place of characters that a C name cannot
    have, and law_ before a digit. `NAME_start` sets the first mode; at every control sample
    `NAME_step` takes the time [s], the measurements, what others hand the law (where it is the
    filter of a command: `handed`) and the parameters, writes the command of the law and the limited
    values of the actuators, and returns the mode. Its numbers are those of the compiled closed
    loop, bit for bit, if the compiler keeps to IEEE 754 (without -ffast-math). `slack` of the state
    is the relaxation of a safeguard at a sample: 0 if an input was admissible. table: that of a
    kernel is in the "text", or in a "file", which `export_c_table` writes, and NAME_load opens.

    `outside` of the state is 1 at a sample outside its grid. Every name at file scope begins with
    NAME, or with its upper case. `export_c_header` gives the header.

    Raises `DefinitionError` for a law that does not fit the system.

    >>> print(hf.export_c(cart, brake, "brake").splitlines()[0])
    /* brake, for cart. Made by holdfast 0.1.0.
    """
    return _file(system, law, name, table).text()


@checked
def export_c_header(
    system: System, law: Law | Switching, name: str = "controller", *, table: str = "text"
) -> str:
    """The header of the file that `export_c` writes for this law and name, for C and for C++.

    name, table: as of `export_c`.

    It declares the sizes, the type NAME_state, NAME_parameters, NAME_start and NAME_step. A program
    may include the headers of several laws whose names differ in more than upper and lower case.

    Raises `DefinitionError` for a law that does not fit the system.

    >>> "brake_step(" in hf.export_c_header(cart, brake, "brake")
    True
    """
    return _file(system, law, name, table).header()


def _file(system: System, law: Law | Switching, name: str, table: str) -> _File:
    if table not in ("text", "file"):
        raise DefinitionError(f"table is '{table}'", expected='"text" or "file"')
    program = controller_program(system, law)
    return _File(program, CTable.of(law, c_name(name), in_file=table == "file"), c_name(name))


class _File:
    def __init__(self, program: ControllerProgram, table: CTable | None, name: str) -> None:
        self.program, self.table, self.name = program, table, name
        self.obstacles = CObstacles.of(program, name)
        used = symbols_of(program.expressions)
        self.parameters = tuple(p for p in program.parameters if p.symbol in used)

    def header(self) -> str:
        return "\n".join([self._about(), *self._interface()]) + "\n"

    def text(self) -> str:
        n, upper = self.name, self.name.upper()
        functions = [self._place()] if self.program.lookup else []
        functions += self.obstacles.functions(self._unpack()) if self.obstacles else []
        functions += [self._law(), self._next_mode(), self._limit()]
        functions += [self._remember()] if self.program.remembered else []
        values = "\n".join(
            f"    {float(p.value)!r}, {c_comment(f'{i} {p.name} [{p.unit}] {p.description}')}"
            for i, p in enumerate(self.parameters)
        )
        helpers = "\n".join(self._helpers("\n".join(functions)))
        lines = [
            self._about(),
            "#include <math.h>",
            "#include <stdint.h>",
            "#include <string.h>",
            *(c_own(text, n) for text in (self.table.included if self.table else ())),
            "",
            *PLAIN,
            "",
            *self._interface(),
            "",
            c_own(helpers, n),
            f"const double {n}_parameters[{upper}_PARAMETERS] = {{",
            values or "    0.0",
            "};",
            "",
            self._start(),
            "",
            *(line for f in functions for line in (c_own(f, n), "")),
            self._step(),
            *(["", self.obstacles.text()] if self.obstacles else ()),
        ]
        return "\n".join(lines) + "\n"

    def _about(self) -> str:
        n, system, law = self.name, self.program.system, self.program.switching
        return c_comment(
            f"{law.name}, for {system.name}. Made by holdfast {__version__}.",
            "",
            *(f"seen[{i}]: {q.name} [{q.unit}]" for i, q in enumerate(self.program.measurements)),
            *(f"handed[{i}]: {q.name} [{q.unit}]" for i, q in enumerate(self.program.handed)),
            *(f"command[{i}]: {q.name} [{q.unit}]" for i, q in enumerate(system.inputs)),
            *(f"actuators[{i}]: {a}" for i, a in enumerate(self.program.actuators)),
            *(f"mode {i}: {m}" for i, m in enumerate(self.program.modes)),
            *([f"{n}_state.slack: {SLACK}"] if self.program.safeguards else []),
            *([f"{n}_state.outside: {self.table.outside}"] if self.table else []),
            *(self.table.said if self.table else ()),
        )

    def _interface(self) -> list[str]:
        """The declarations for other files."""
        n, upper = self.name, self.name.upper()
        sizes = {
            "MODES": len(self.program.modes),
            "SEEN": len(self.program.measurements),
            **({"HANDED": len(self.program.handed)} if self.program.handed else {}),
            "KEPT": max(len(self.program.remembered), 1),
            "INPUTS": len(self.program.inputs),
            "ACTUATORS": len(self.program.actuators),
            "PARAMETERS": max(len(self.parameters), 1),
        }
        return [
            f"#ifndef {upper}_H",
            f"#define {upper}_H",
            *(["#include <stddef.h>"] if self.table and self.table.declared else []),
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            *(f"#define {upper}_{size} {count}" for size, count in sizes.items()),
            "",
            "typedef struct {",
            "    int mode, begun, outside;",
            f"    double since, slack, kept[{upper}_KEPT];",
            f"}} {n}_state;",
            "",
            f"extern const double {n}_parameters[{upper}_PARAMETERS];",
            f"void {n}_start({n}_state *s);",
            f"{self._step_heading()};",
            *(self.obstacles.declared() if self.obstacles else ()),
            "",
            *(self.table.declared if self.table else ()),
            "#ifdef __cplusplus",
            "}",
            "#endif",
            "#endif",
        ]

    def _step_heading(self) -> str:
        n = self.name
        handed = "const double *handed, " if self.program.handed else ""
        return (
            f"int {n}_step({n}_state *s, double t, double sample_time, const double *seen,\n"
            f"        {handed}const double *p, double *command, double *actuators)"
        )

    def _helpers(self, functions: str) -> list[str]:
        """The helper functions that the functions call."""
        called = c_functions(functions, FUNCTIONS)
        texts = [c_helpers(BITS, functions + called), called]
        guards = self.program.safeguards.values()
        scalar = sorted({_keeper(g) for g in guards})
        library = scalars("simulation/parts")
        if self.obstacles is not None:
            library = Scalars(library.functions | scalars("obstacle_pairs").functions, {})
            scalar.append("find_pairs")
        if self.table is not None:
            texts.append(self.table.text)
            scalar += self.table.needed
        texts.append(scalars_c(library, scalar))
        return [text for text in texts if text]

    def _unpack(self) -> dict[str, Sequence[sp.Symbol]]:
        return {
            "seen": [q.symbol for q in self.program.seen],
            "kept": [q.symbol for q in self.program.remembered],
            "p": [p.symbol for p in self.parameters],
        }

    def _start(self) -> str:
        first = self.program.initial_mode
        return (
            f"void {self.name}_start({self.name}_state *s) {{\n    s->mode = {first};\n"
            "    s->begun = s->outside = 0;\n    s->since = s->slack = 0.0;\n"
            f"    for (int i = 0; i < {self.name.upper()}_KEPT; i++) s->kept[i] = 0.0;\n}}"
        )

    def _law(self) -> str:
        lookup, names = self.program.lookup, self.program.system.input_names
        unpack, look = self._unpack(), ""
        if lookup is not None and self.table is not None:
            look = self.table.found
            unpack |= {"look": lookup.symbols}
        cases = []
        for number, name in enumerate(self.program.modes):
            results, into, ending = self.program.commands(name), "command", "return 0.0;"
            asked = ""
            if guard := self.program.safeguards.get(name):
                m, count = len(names), len(guard.offsets)
                into, end = "asked", len(results) + count * (m + 1)
                results += guard.rows(names)
                ahead = guard.foresight
                rows = count + (CUTS * ahead.moves if ahead else 0)
                room, whole = numbers_of_programs(m, rows)
                asked = f"        double asked[{len(results)}], room[{room + m}];\n"
                asked += f"        long counts[{whole}];\n"
                called, ends = "keep_within", ""
                if ahead:
                    asked += _of_search(guard, ahead, m, len(lookup.places) if lookup else 0)
                elif len(guard.ends) > 1:
                    called, ends = "keep_in_order", f"ends, {len(guard.ends)}, "
                    asked += f"        long ends[] = {{{', '.join(map(str, guard.ends))}}};\n"
                ending = (
                    _search(guard, ahead, m, end, len(lookup.places) if lookup else 0)
                    if ahead
                    else f"return hf_{called}(asked, asked + {end}, asked + {m}, {m}, {count}, "
                    f"{guard.hard}, {ends}command, room, counts);"
                )
            body = c_body(unpack, results, into, "        ")
            if guard and self.obstacles and guard.repeated:
                body += self.obstacles.filled(number, guard)
            cases.append(f"    case {number}: {{\n{asked}{body}\n        {ending}\n    }}")
        return (
            "/* Returns the slack of the safeguard. */\n"
            "static double hf_law(double t, double sample_time, const double *seen,\n"
            "                     const double *kept, int mode, const double *p,\n"
            "                     double *command) {\n"
            "    (void)t; (void)sample_time; (void)seen; (void)kept; (void)p;\n"
            f"{look}    switch (mode) {{\n" + "\n".join(cases) + "\n    }\n    return NAN;\n}"
        )

    def _place(self) -> str:
        assert self.program.lookup is not None
        return (
            "static void hf_place(double t, const double *seen, const double *kept,\n"
            "                     const double *p, double *place) {\n"
            "    (void)t; (void)seen; (void)kept; (void)p;\n"
            + c_body(self._unpack(), self.program.lookup.places, "place", "    ")
            + "\n}"
        )

    def _next_mode(self) -> str:
        cases = []
        for name, leaving in self.program.transitions.items():
            tests = [
                f"        if (level[{i}] >= 0.0) return {target};"
                for i, (_, target) in enumerate(leaving)
            ]
            cases.append(
                f"    case {self.program.modes.index(name)}: {{\n"
                f"        double level[{len(leaving)}];\n"
                + c_body(self._unpack(), [when for when, _ in leaving], "level", "        ")
                + "\n"
                + "\n".join(tests)
                + "\n        break;\n    }"
            )
        inside = "    switch (mode) {\n" + "\n".join(cases) + "\n    }\n" if cases else ""
        return (
            "static int hf_next_mode(double t, const double *seen, const double *kept, int mode,\n"
            "                        double time_in_mode, const double *p) {\n"
            "    (void)t; (void)seen; (void)kept; (void)time_in_mode; (void)p;\n"
            f"{inside}    return mode;\n}}"
        )

    def _limit(self) -> str:
        unpack = {"command": self.program.inputs, "p": [p.symbol for p in self.parameters]}
        return (
            "static void hf_limit(const double *command, const double *p, double *actuators) {\n"
            "    (void)p;\n" + c_body(unpack, self.program.actuation(), "actuators") + "\n}"
        )

    def _remember(self) -> str:
        program, count = self.program, len(self.program.remembered)
        made = {"actuators": program.requested, "p": [p.symbol for p in self.parameters]}
        u = {"u": program.inputs}
        return (
            "static void hf_first(const double *seen, const double *p, double *kept) {\n"
            "    (void)seen; (void)p;\n"
            + c_body(self._unpack() | {"kept": []}, program.initial_memory, "kept")
            + "\n}\n\n"
            "static void hf_remember(double t, double sample_time, const double *seen,\n"
            "                        const double *actuators, const double *p, double *kept) {\n"
            f"    double u[{len(self.program.inputs)}], next[{count}];\n"
            "    (void)t; (void)sample_time; (void)seen; (void)p;\n    {\n"
            + c_body(made, program.produced(), "u", "        ")
            + "\n    }\n"
            + c_body(self._unpack() | u, program.next_memory, "next")
            + f"\n    for (int i = 0; i < {count}; i++) kept[i] = next[i];\n}}"
        )

    def _step(self) -> str:
        asked = begin = remember = ""
        if self.program.remembered:
            begin = "    if (!s->begun) hf_first(seen, p, s->kept);\n"
            remember = "    hf_remember(t, sample_time, seen, actuators, p, s->kept);\n"
        if self.table is not None:
            asked, begin = self.table.asked, self.table.guard + begin
        preamble, upper = "", self.name.upper()
        if self.program.handed:  # the functions of the law find it behind what is seen
            preamble = f"    double told[{upper}_SEEN + {upper}_HANDED];\n"
            for name, at in (("seen", ""), ("handed", f" + {upper}_SEEN")):
                size = f"sizeof(double) * {upper}_{name.upper()}"
                preamble += f"    memcpy(told{at}, {name}, {size});\n"
            preamble += "    seen = told;\n"
        body = (
            f" {{\n{preamble}{begin}    s->begun = 1;\n"
            "    int mode = hf_next_mode(t, seen, s->kept, s->mode, t - s->since, p);\n"
            "    if (mode != s->mode) {\n        s->mode = mode;\n        s->since = t;\n    }\n"
            f"{asked}    s->slack = hf_law(t, sample_time, seen, s->kept, mode, p, command);\n"
            "    hf_limit(command, p, actuators);\n"
            f"{remember}    return mode;\n}}"
        )
        return self._step_heading() + c_own(body, self.name)


def _keeper(guard: Safeguard) -> str:
    """The scalar function of a safeguard."""
    if guard.foresight:
        return "keep_foreseen"
    return "keep_in_order" if len(guard.ends) > 1 else "keep_within"


def _of_search(guard: Safeguard, ahead: Foresight, m: int, axes: int) -> str:
    """The arrays of the search of a foresight."""
    room = numbers_of_search(axes, m, len(guard.offsets), ahead.moves)
    return (
        f"        double result[{m + 1}], ahead[{room}];\n        long whole[{2 * axes}];\n"
        f"        long ends[] = {{{', '.join(map(str, guard.ends))}}};\n"
    )


def _search(guard: Safeguard, ahead: Foresight, m: int, end: int, axes: int) -> str:
    """The statements that search, and return the slack."""
    points, moves, curved, motion, first = ahead.counts
    more = end + m
    return (
        f"double slack = hf_keep_foreseen(hf_values, asked, asked + {end}, asked + {m}, "
        f"asked + {more + 3}, asked + {more + 3 + motion}, {m}, {len(guard.offsets)}, "
        f"{guard.hard}, ends, {len(guard.ends)}, {first}, {points}, asked[{more}], "
        f"asked[{more + 1}], asked[{more + 2}], {GRID}, {axes}, {moves}, {curved}, result, ahead, "
        f"whole, room, counts);\n"
        f"        for (int i = 0; i < {m}; i++) command[i] = result[i];\n"
        "        return slack;"
    )
