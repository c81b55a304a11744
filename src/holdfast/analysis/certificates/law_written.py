"""The cases of a law as the header of a certificate has them, and read from there."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sympy as sp

from holdfast.execution.intervals.law_ranges import TableRanges
from holdfast.maths.definitions.law import LawCases, Lookup, Option, Program
from holdfast.maths.definitions.quantity import TIME_IN_MODE

MOST_OF_NODES, ROOM = 64, 1 << 20
"""How many times as long as its packed form a table of a file may be, beside so many bytes."""

LAW = {"names", "initial", "modes", "parts", "under_way", "table"}
PROGRAM = {"wanted", "rows", "hard", "scales", "limits", "box"}

Ranges = Sequence[tuple[float, float]]
Read = Callable[[object, Mapping[str, sp.Expr]], sp.Expr]


def written(law: LawCases, under_way: Ranges, text: Callable[[sp.Expr], str]) -> dict[str, Any]:
    """Plain data; text: of an expression."""

    def texts(expressions: Sequence[sp.Expr]) -> list[str]:
        return [text(e) for e in expressions]

    def inputs_of(o: Option | Program) -> Any:
        if isinstance(o, Option):
            return texts(o.inputs)
        return {
            "wanted": None if o.wanted is None else texts(o.wanted),
            "rows": [texts(row) for row in o.rows],
            "hard": o.hard,
            "scales": texts(o.scales),
            "limits": texts(o.limits),
            "box": None if o.box is None else [texts(ends) for ends in o.box],
        }

    return {
        "names": list(law.modes),
        "initial": law.initial,
        "modes": [[[texts(o.when), inputs_of(o), o.to] for o in mode] for mode in law.options],
        "parts": [_hexadecimal(edges) for edges in law.parts],
        "under_way": [_hexadecimal(ends) for ends in under_way],
        "table": None if law.lookup is None else _table(law.lookup, texts(law.lookup.places)),
    }


def read(law: Any, names: Mapping[str, sp.Expr], read: Read) -> tuple[LawCases, Ranges]:
    """The law of a header, and its inputs that may be under way; read: of the text of expressions.

    Raises what `read` does, and `ValueError`, `KeyError` or `TypeError` for other content.
    """
    if law.keys() != LAW:
        raise ValueError(f"the law has other parts: {', '.join(sorted(law.keys() ^ LAW))}")
    table = law["table"]
    lookup = None if table is None else _lookup(table, names, read)
    symbols = {**names, TIME_IN_MODE.name: TIME_IN_MODE}
    symbols |= {s.name: s for s in (lookup.symbols if lookup else ())}
    modes, initial = tuple(map(str, law["names"])), law["initial"]
    numbers = [initial, *(to for mode in law["modes"] for _, _, to in mode)]
    if len(modes) != len(law["modes"]) or any(
        type(k) is not int or not 0 <= k < len(modes) for k in numbers
    ):
        raise ValueError("the law has a mode that there is none of")

    def several(texts: Any) -> tuple[sp.Expr, ...]:
        return tuple(read(e, symbols) for e in texts)

    def option(when: Any, inputs: Any, to: int) -> Option | Program:
        if not isinstance(inputs, dict):
            return Option(several(when), several(inputs), to)
        if inputs.keys() != PROGRAM:
            raise ValueError("the program of a safeguard has other parts")
        wanted, box = inputs["wanted"], inputs["box"]
        return Program(
            several(when), None if wanted is None else several(wanted),
            tuple(map(several, inputs["rows"])), int(inputs["hard"]), several(inputs["scales"]),
            several(inputs["limits"]),
            None if box is None else tuple((low, high) for low, high in map(several, box)), to,
        )  # fmt: skip

    options = tuple(tuple(option(*o) for o in mode) for mode in law["modes"])
    parts = tuple(tuple(map(float.fromhex, edges)) for edges in law["parts"])
    under_way = tuple((float.fromhex(a), float.fromhex(b)) for a, b in law["under_way"])
    return LawCases(modes, initial, options, parts, lookup), under_way


def _table(lookup: Lookup, places: list[str]) -> dict[str, Any]:
    """Its nodes, and those of its slopes, between what these lie as differences of floats."""
    ranges = TableRanges(lookup.table)
    nodes = zip(lookup.symbols, ranges.nodes, strict=True)
    ends = [_hexadecimal(e) for e in zip(ranges.low, ranges.steps, strict=True)]
    axes = zip(places, ends, ranges.shape, ranges.periodic, strict=True)
    return {
        "axes": [list(axis) for axis in axes],
        "nodes": {s.name: [_packed(end) for end in ends] for s, ends in nodes},
    }


def _lookup(table: Any, names: Mapping[str, sp.Expr], read: Read) -> Lookup:
    texts, ends, shape, periodic = zip(*table["axes"], strict=True)
    low, steps = np.array([[float.fromhex(v) for v in axis] for axis in ends]).T
    lookup = Lookup(tuple(read(e, names) for e in texts), None)
    nodes = {name: [_unpacked(end) for end in ends] for name, ends in table["nodes"].items()}
    if nodes.keys() != {s.name for s in lookup.symbols}:
        raise ValueError("a table has other names")
    values = nodes[lookup.value.name][0]
    counts = np.array(shape, dtype=np.int64)
    if len(values) != counts.prod() or counts.min() < 2 or not (steps > 0).all():
        raise ValueError("the nodes of a table are not as many as its axes say")
    numbers = (values, low, steps, counts, np.array(periodic, dtype=bool))
    computed = TableRanges(numbers).nodes
    for s, ends in zip(lookup.symbols, computed, strict=True):
        if not all(map(np.array_equal, nodes[s.name], (e.ravel() for e in ends))):
            raise ValueError("the slopes of a table are not those of its values")
    return replace(lookup, table=numbers)


def unpacked(packed: bytes, times: int) -> bytes:
    """What is packed: so many times as long at most, so that a small file takes little memory.

    Raises `ValueError` for more.
    """
    most = times * len(packed) + ROOM
    numbers = zlib.decompressobj().decompress(packed, most + 1)
    if len(numbers) > most:
        raise ValueError(f"it unpacks to more than {times} times its length")
    return numbers


def _unpacked(text: str) -> Any:
    numbers = unpacked(base64.b64decode(text), MOST_OF_NODES)
    return np.frombuffer(numbers, dtype="<f8").astype(np.float64)


def _packed(values: Any) -> str:
    numbers = np.ascontiguousarray(values, dtype="<f8").tobytes()
    return base64.b64encode(zlib.compress(numbers, 6)).decode("ascii")


def _hexadecimal(values: Any) -> list[str]:
    return [float(v).hex() for v in values]
