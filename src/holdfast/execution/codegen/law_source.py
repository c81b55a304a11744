"""The laws and the guards of a controller as source text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sympy as sp

from holdfast.execution.codegen.printer import body
from holdfast.maths.definitions.switching import Switching


def looked_up(switching: Switching) -> str:
    """The line that evaluates the lookup table of a law."""
    return "    look = look_up(table, places(t, q, p))\n" if switching.lookup else ""


def unpacked(
    switching: Switching, state: Mapping[str, Sequence[sp.Symbol]], p: Sequence[sp.Symbol]
) -> dict[str, Sequence[sp.Symbol]]:
    """The symbols in the argument arrays of a law."""
    look = {"look": switching.lookup.symbols} if switching.lookup else {}
    return {**state, "p": p, **look}


def law_source(
    switching: Switching,
    inputs: Sequence[str],
    state: Mapping[str, Sequence[sp.Symbol]],
    p: Sequence[sp.Symbol],
) -> str:
    """The command in every mode, and the slack that its safety filter needed (0 without one).

    If some mode has a safety filter, two entries follow: 1 if the filter intervened, else 0, and
    the unfiltered command.
    """
    guarded = any(mode.safeguard for mode in switching.modes.values())
    lines = ["@inlined", f"def law(t, q, mode, p, table):\n{looked_up(switching)}".rstrip()]
    unpack = unpacked(switching, state, p)
    same = _in_every_mode(switching, inputs)
    if same:
        lines.append(body(unpack, list(same.values()), give="same ="))
    for number, mode in enumerate(switching.modes.values()):
        last = number == len(switching.modes) - 1
        if not last:
            lines.append(f"    if mode == {number}:")
        indent = "    " if last else "        "
        results = [mode.outputs[n] for n in inputs if n not in same]
        if mode.safeguard is None:
            own = f"own{number}"
            lines.append(body(unpack, results, indent=indent, give=f"{own} ="))
            places = {n: f"same[{i}]" for i, n in enumerate(same)}
            places |= {n: f"{own}[{i}]" for i, n in enumerate(n for n in inputs if n not in same)}
            command = [places[n] for n in inputs]
            told = ["0.0", *command] if guarded else []
            lines.append(f"{indent}return ({', '.join([*command, '0.0', *told])})")
            continue
        guard, m = mode.safeguard, len(inputs)
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


def nominal_source(switching: Switching, inputs: int) -> str:
    """The command before the safety filter, from the return value of `law`."""
    first = inputs + 2 if any(mode.safeguard for mode in switching.modes.values()) else 0
    entries = "".join(f"answer[{first + i}], " for i in range(inputs)) or "0.0, "
    return f"@inlined\ndef nominal(answer):\n    return ({entries})"


def _in_every_mode(switching: Switching, inputs: Sequence[str]) -> dict[str, sp.Expr]:
    """The outputs that are equal in all modes, if there is more than one mode."""
    modes = list(switching.modes.values())
    if len(modes) == 1 or any(mode.safeguard for mode in modes):
        return {}
    return {n: modes[0].outputs[n] for n in inputs if len({m.outputs[n] for m in modes}) == 1}


def guard_source(
    switching: Switching, state: Mapping[str, Sequence[sp.Symbol]], p: Sequence[sp.Symbol]
) -> str:
    numbers = {name: i for i, name in enumerate(switching.modes)}
    lines = ["@inlined", "def next_mode(t, q, mode, time_in_mode, p):"]
    for name, number in numbers.items():
        leaving = [x for x in switching.transitions if x.source == name]
        if not leaving:
            continue
        lines.append(f"    if mode == {number}:")
        guards = [x.when for x in leaving]
        lines.append(body({**state, "p": p}, guards, indent="        ", give="levels ="))
        for i, transition in enumerate(leaving):
            lines.append(f"        if levels[{i}] >= 0.0:")
            lines.append(f"            return {numbers[transition.target]}")
    lines.append("    return mode")
    return "\n".join(lines)
