"""A law as one file of C99 and its header: no allocation, and no library but libm.

Every name at file scope begins with the name of the law, so that several laws can be in one
program, and even in one translation unit. What other files see (sizes, the type of the state,
parameters, `_start`, `_step`) is one block with an include guard. The header is that block, and the
file of C repeats it, so that it compiles alone and with its header alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast._version import __version__
from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.codegen.c_lookup import GRID, CTable
from holdfast.execution.codegen.c_printer import c_body, c_functions
from holdfast.execution.codegen.c_text import c_comment, c_name, c_needed, c_own
from holdfast.execution.codegen.controller_program import ControllerProgram, controller_program
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.codegen.scalar_c import scalars_c
from holdfast.execution.codegen.scalar_reader import scalars
from holdfast.execution.foreseen import CUTS, numbers_of_search
from holdfast.execution.simulation.quadratic_program import numbers_of_programs
from holdfast.maths.definitions.law import Foresight, Law, Safeguard
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import symbols_of

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
    loop, bit for bit, if the compiler keeps to IEEE 754 (without -ffast-math).
    `slack` of the state is the relaxation of a safeguard at a sample: 0 if an input was admissible.
    table: that of a kernel is in the "text", or in a "file", which `export_c_table` writes, and
    NAME_load opens. `outside` of the state is 1 at a sample outside its grid.
    Every name at file scope begins with NAME, or with its upper case. `export_c_header` gives the
    header.

    Raises `DefinitionError` for a law that does not fit the system.
    """
    return _file(system, law, name, table).text()


@checked
def export_c_header(
    system: System, law: Law | Switching, name: str = "controller", *, table: str = "text"
) -> str:
    """The header of the file that `export_c` writes for this law and name, for C and for C++.

    It declares the sizes, the type NAME_state, NAME_parameters, NAME_start and NAME_step. A program
    may include the headers of several laws whose names differ in more than upper and lower case.

    Raises `DefinitionError` for a law that does not fit the system.
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
        used = symbols_of(program.expressions)
        self.parameters = tuple(p for p in program.parameters if p.symbol in used)

    def header(self) -> str:
        return "\n".join([self._about(), *self._interface()]) + "\n"

    def text(self) -> str:
        n, upper = self.name, self.name.upper()
        functions = [self._place()] if self.program.lookup else []
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
        found = [
            c_needed("arithmetic", functions + called),
            called,
            c_needed("walls", functions),
        ]
        guards = self.program.safeguards.values()
        scalar = sorted({_keeper(g) for g in guards})
        if self.table is not None:
            found.append(self.table.text)
            scalar += self.table.needed
        found.append(scalars_c(scalars("simulation/parts"), scalar))
        return [text for text in found if text]

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
        told, upper = "", self.name.upper()
        if self.program.handed:  # the functions of the law find it behind what is seen
            told = f"    double told[{upper}_SEEN + {upper}_HANDED];\n"
            for name, at in (("seen", ""), ("handed", f" + {upper}_SEEN")):
                size = f"sizeof(double) * {upper}_{name.upper()}"
                told += f"    memcpy(told{at}, {name}, {size});\n"
            told += "    seen = told;\n"
        body = (
            f" {{\n{told}{begin}    s->begun = 1;\n"
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
