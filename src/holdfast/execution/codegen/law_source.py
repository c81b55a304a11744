"""The laws and the guards of a controller as source text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from holdfast.execution.codegen.controller_program import ControllerProgram
from holdfast.execution.codegen.printer import body

Symbols = Sequence[sp.Symbol]


def law_source(program: ControllerProgram, seen: Symbols, p: Symbols) -> str:
    """The command in every mode, and the slack that its safety filter needed (0 without one).

    If some mode has a safety filter, two entries follow: 1 if the filter intervened, else 0, and
    the unfiltered command.
    """
    inputs, guards = program.system.input_names, program.safeguards
    lines = ["@inlined", f"def law(t, q, mode, p, table):\n{_looked_up(program)}".rstrip()]
    unpack = _unpacked(program, seen, p)
    same = _in_every_mode(program)
    if same:
        lines.append(body(unpack, list(same.values()), give="same ="))
    for number, mode in enumerate(program.modes):
        last = number == len(program.modes) - 1
        if not last:
            lines.append(f"    if mode == {number}:")
        indent = "    " if last else "        "
        commands = dict(zip(inputs, program.commands(mode), strict=True))
        results = [commands[n] for n in inputs if n not in same]
        guard = guards.get(mode)
        if guard is None:
            own = f"own{number}"
            lines.append(body(unpack, results, indent=indent, give=f"{own} ="))
            places = {n: f"same[{i}]" for i, n in enumerate(same)}
            places |= {n: f"{own}[{i}]" for i, n in enumerate(n for n in inputs if n not in same)}
            command = [places[n] for n in inputs]
            told = ["0.0", *command] if guards else []
            lines.append(f"{indent}return ({', '.join([*command, '0.0', *told])})")
            continue
        m = len(inputs)
        results += guard.rows(inputs)
        # separate names in each mode: Numba does not unify long tuples of different modes
        asked, given = f"asked{number}", f"given{number}"
        lines.append(body(unpack, results, indent=indent, give=f"{asked} ="))
        end = len(results) - m
        lines.append(
            f"{indent}{given} = keep_within({asked}[:{m}], {asked}[{end}:], {asked}[{m}:{end}], "
            f"{guard.hard})"
        )
        told = [f"{given}[{i}]" for i in range(m + 1)]
        told.append(f"overrules({asked}[:{m}], {given}, {asked}[{m}:{end}], {guard.hard})")
        told += [f"{asked}[{i}]" for i in range(m)]
        lines.append(f"{indent}return ({', '.join(told)})")
    return "\n".join(lines)


def nominal_source(program: ControllerProgram) -> str:
    """The command before the safety filter, from the return value of `law`."""
    inputs = len(program.inputs)
    first = inputs + 2 if program.safeguards else 0
    entries = "".join(f"answer[{first + i}], " for i in range(inputs)) or "0.0, "
    return f"@inlined\ndef nominal(answer):\n    return ({entries})"


def signals_source(program: ControllerProgram, seen: Symbols, p: Symbols) -> str:
    """The recorded signals of the law."""
    results = list(program.switching.signals.values())
    text = body(_unpacked(program, seen, p), results)
    return f"@inlined\ndef signals(t, q, p, table):\n{_looked_up(program)}{text}"


def guard_source(program: ControllerProgram, seen: Symbols, p: Symbols) -> str:
    """The mode after the guards of a mode are tried in order."""
    lines = ["@inlined", "def next_mode(t, q, mode, time_in_mode, p):"]
    for name, leaving in program.transitions.items():
        lines.append(f"    if mode == {program.modes.index(name)}:")
        guards = [when for when, _ in leaving]
        lines.append(body({"q": seen, "p": p}, guards, indent="        ", give="levels ="))
        for i, (_, target) in enumerate(leaving):
            lines.append(f"        if levels[{i}] >= 0.0:")
            lines.append(f"            return {target}")
    lines.append("    return mode")
    return "\n".join(lines)


def _looked_up(program: ControllerProgram) -> str:
    """The line that evaluates the lookup table of a law."""
    return "    look = look_up(table, places(t, q, p))\n" if program.lookup else ""


def _unpacked(program: ControllerProgram, seen: Symbols, p: Symbols) -> Mapping[str, Symbols]:
    """The symbols in the argument arrays of a law."""
    look = {"look": program.lookup.symbols} if program.lookup else {}
    return {"q": seen, "p": p, **look}


def _in_every_mode(program: ControllerProgram) -> dict[str, sp.Expr]:
    """The outputs that are equal in all modes, if there is more than one mode."""
    if len(program.modes) == 1 or program.safeguards:
        return {}
    columns = zip(*map(program.commands, program.modes), strict=True)
    named = zip(program.system.input_names, columns, strict=True)
    return {name: column[0] for name, column in named if len(set(column)) == 1}
