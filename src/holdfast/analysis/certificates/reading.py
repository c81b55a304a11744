"""Certificates read from their files: whole, unchanged, and of nothing that is not understood.

Expressions are read exactly: whole numbers of any size, and no rounding. The text is parsed to
Python's syntax tree, and only what a certificate can contain is translated; nothing is evaluated as
code.
"""

from __future__ import annotations

import ast
import hashlib
import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from keyword import iskeyword
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Halvings, Kept
from holdfast.analysis.certificates.certificate import (
    ENTRY,
    KNOWN,
    MAGIC,
    MOST_DEPTH,
    MOST_HALVES,
    MOST_STEPS,
    Certificate,
    Range,
    Ranges,
    check_content,
    check_names,
    read,
    unpacked,
)
from holdfast.analysis.certificates.certified_law import KEYS
from holdfast.analysis.certificates.images import sure_of
from holdfast.arguments import checked
from holdfast.errors import ExpressionError, HoldfastError, OutputError
from holdfast.execution.arrays import Array, Truths, Wholes
from holdfast.execution.intervals.enclosure import Enclosure
from holdfast.execution.intervals.enclosures import STANDARD, enclosures
from holdfast.execution.intervals.held_flow import Sampling
from holdfast.maths.definitions.law import LawCases, Option, Program
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.expressions import functions
from holdfast.maths.expressions.traversal import syntax_tree

LONGEST = 100_000
MOST, LONGEST_NUMBER = 64, 10_000
"""The largest exponent, and bits of a number."""

FUNCTIONS: Mapping[str, Callable[..., sp.Expr]] = {
    name: getattr(functions, name, None) or getattr(sp, name) for name in KNOWN
} | {"sqrt": sp.sqrt}

Names = Mapping[str, sp.Expr]


def exact_expression(text: object, names: Names) -> sp.Expr:
    """The expression of a text that `Certificate.header` made; names: every symbol by its name.

    Raises `ExpressionError` for text that is none.
    """
    if not isinstance(text, str) or len(text) > LONGEST:
        raise ExpressionError(f"{text!r:.40} is no expression", expected="text")
    try:
        return _of(syntax_tree(text, "eval").body, names)
    except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
        raise ExpressionError(f"'{text:.40}' is no expression ({error})") from None


def _of(node: ast.expr, names: Names) -> sp.Expr:
    match node:
        case ast.Constant(value=int() as value) if not isinstance(value, bool):
            return sp.Integer(value)
        case ast.Name(id="pi"):
            return sp.pi
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_of(inner, names)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as op, right=b):
            first, other = _of(left, names), _of(b, names)
            if isinstance(op, ast.Add):
                return first + other
            if isinstance(op, ast.Sub):
                return first - other
            return first * other if isinstance(op, ast.Mult) else first / other
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            exponent = _of(right, names)
            if not (exponent.is_Rational and abs(exponent) <= MOST):
                raise ExpressionError(
                    f"the exponent {ast.unparse(right):.40}", expected=f"a number up to {MOST}"
                )
            base = _of(left, names)
            if base.is_Rational and exponent.is_Integer:
                bits = base.p.bit_length() + base.q.bit_length()
                if bits * abs(int(exponent)) > LONGEST_NUMBER:
                    raise ExpressionError(f"a number is too long in '{ast.unparse(node):.40}'")
            several = exponent * base.exp if base.is_Pow and base.exp.is_Rational else exponent
            if abs(several) > MOST:
                raise ExpressionError(f"a power of a power is above {MOST}")
            return base**exponent
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](*(_of(a, names) for a in arguments))
    raise ExpressionError(
        f"'{ast.unparse(node):.40}' is nothing of a certificate",
        expected="its names, " + ", ".join(KNOWN),
    )


MOST_OF_ENTRIES = 16
"""How many times as long as their packed form the entries of a file may be: they are six times."""

OPTIONAL = {"depth", "steps", "halves", "enclosure"}
"""What a header says of cells that were halved, of holds that enclosures divide, of cells that the
checker may halve, and of which kind the enclosures are."""


@checked
def read_certificate(path: str | Path, *, check: float = 1.0) -> Certificate:
    """The certificate of a file that `Certificate.write` or `holdfast certify` made, checked.

    The checker of certificates (`holdfast-check`) reads the whole file, a millisecond or less an
    entry, the first time that a file with this content is read; what it found is kept in the cache.

    path: of the file. check: the share of the entries that the checker reads, drawn anew each time;
    0 for none.

    What was not checked, and a checker that is not installed, is a `ModelWarning`. `kept.sweeps` is
    0 and how many cells are in the region is told, neither of which the file proves.

    Raises `OutputError` for a file that is no certificate, is damaged, says something that this
    version does not know, or does not prove what it says.

    >>> hf.read_certificate(certificate.write("cart.holdfast")).states
    (('x', 'm'), ('v', 'm/s'))
    """
    if not 0 <= check <= 1:
        raise OutputError(f"check is {check}", expected="a share of the entries, 0 to 1")
    file = Path(path)
    certificate, content = unchecked(file)
    check_content(file, content, check)
    return certificate


def unchecked(file: Path) -> tuple[Certificate, bytes]:
    """The certificate that a file says, and its content. Raises `OutputError`."""
    try:
        if file.exists() and not file.is_file():
            raise OutputError(f"{file} is no file", expected="a certificate")
        raw = file.read_bytes()
    except OSError as error:
        raise OutputError(f"{file} cannot be read ({error.strerror})") from None
    first, _, content = raw.partition(b"\n")
    magic, _, digest = first.decode("ascii", "replace").rpartition(" ")
    if magic != MAGIC:
        what = (
            "a flowpipe, of one box" if magic.startswith("holdfast-flowpipe") else "no certificate"
        )
        raise OutputError(f"{file} is {what}", expected=f"a file that begins '{MAGIC}'")
    if hashlib.sha256(content).hexdigest() != digest:
        raise OutputError(
            f"{file} is not what was written: its digest is another",
            remedy="certify again, or take the file from where it was written",
        )
    text, _, packed = content.partition(b"\n")
    try:
        header = json.loads(text, object_pairs_hook=_once)
        if not isinstance(header, dict):
            raise ValueError("its header is no table")
        lists = ("rates", "constraints", "target", "edges", "errors", "candidates")
        if odd := [k for k in lists if k in header and type(header[k]) is not list]:
            raise ValueError(f"its {odd[0]} are no list")
        if unknown := sorted(header.keys() - OPTIONAL ^ KEYS):
            which = f"says '{unknown[0]}'" if unknown[0] in header else f"lacks '{unknown[0]}'"
            raise OutputError(
                f"{file} {which}, and this version reads certificates without it"
                if unknown[0] in header else f"{file} {which}",
                remedy="read it with the version that wrote it",
            )  # fmt: skip
        return _certificate(header, packed), raw
    except OutputError:
        raise
    except HoldfastError as error:
        raise OutputError(f"{file}: {error.cause}", expected=error.expected) from None
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
        RecursionError,
        zlib.error,
    ) as error:
        raise OutputError(f"{file} is damaged: {error}") from None


def _once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    by_key = dict(pairs)
    if len(by_key) < len(pairs):
        raise ValueError("a key stands twice")
    return by_key


def _certificate(header: Mapping[str, Any], packed: bytes) -> Certificate:
    groups = ("states", "inputs", "disturbances", "parameters")
    named = {group: _quantities(header[group]) for group in groups}
    names = [name for group in groups for name, _ in named[group]]
    if len(set(names)) < len(names):
        raise ValueError("a name stands twice")
    check_names(names)
    if odd := [n for n in names if not (n.isascii() and n.isidentifier()) or iskeyword(n)]:
        raise ValueError(f"'{odd[0]}' is no name")
    symbols = {name: symbol(name) for name in names}
    ranges = {q["name"]: _range(q["range"]) for group in groups[2:] for q in header[group]}
    rates = tuple(exact_expression(e, symbols) for e in header["rates"])
    constraints, target = (
        tuple(
            (_text(c["name"]), _text(c["unit"]), exact_expression(c["expression"], symbols))
            for c in header[which]
        )
        for which in ("constraints", "target")
    )
    cells = _cells(header, len(rates))
    candidates = np.array([[_finite(v) for v in row] for row in header["candidates"]])
    if header["law"] and not isinstance(header["law"], dict):
        raise ValueError("its law is one of an earlier version")
    law, late = read(header["law"], symbols, exact_expression) if header["law"] else (None, ())
    if law and len(candidates):
        raise ValueError("it has a law, and inputs that were tried")
    candidates = candidates.reshape(len(candidates), 0 if law else -1)
    counts = {candidates.shape[1]}
    if law:
        counts = {k for mode in law.options for o in mode for k in _counts(o)}
    if len(rates) != len(named["states"]) or counts != {len(named["inputs"])}:
        raise ValueError("rates, states, inputs and their values are not as many")
    sampling, holds = _sampling(header, candidates, law, late), header["holds"]
    if not (holds is None or (type(holds) is int and holds > 0)):
        raise ValueError(f"it holds inputs {holds} times")
    parameters = {symbols[n]: ranges[n] for n, _ in named["parameters"]}
    states = [symbols[n] for n, _ in named["states"]]
    halvings = Halvings(cells, _depth(header, cells))
    region = _region(halvings, [e for *_, e in constraints], states, parameters, sampling.errors)
    if target:
        both = [e for *_, e in (*constraints, *target)]
        arrived = _region(halvings, both, states, parameters, sampling.errors)
        region = np.setdiff1d(region, arrived)
    kept_set = _kept(header, packed, halvings, region)
    return Certificate(
        title=_text(header["title"]), states=named["states"], inputs=named["inputs"],
        disturbances=named["disturbances"], parameters=named["parameters"], ranges=ranges,
        rates=rates, constraints=constraints, sampling=sampling, candidates=candidates,
        kept=kept_set, target=target,
    )  # fmt: skip


def _counts(o: Option | Program) -> Iterator[int]:
    """Of how many inputs each part of an option is."""
    if isinstance(o, Option):
        yield len(o.inputs)
        return
    yield from (len(row) - 1 for row in o.rows)
    yield from map(len, (o.scales, o.limits, *(p for p in (o.wanted, o.box) if p is not None)))


def _sampling(
    header: Mapping[str, Any], candidates: Array, law: LawCases | None, late: Ranges
) -> Sampling:
    hold, delay, *errors = (
        _finite(v) for v in (header["hold"], header["delay"], *header["errors"])
    )
    if not 0 <= delay < hold or len(errors) != len(header["states"]) or min(errors) < 0:
        raise ValueError(f"inputs are held for {hold:g} s, {delay:g} s late, with errors {errors}")
    under_way = (
        tuple(late) if law else tuple((float(c.min()), float(c.max())) for c in candidates.T)
    )
    steps = header.get("steps", 1)
    if type(steps) is not int or not 1 <= steps <= MOST_STEPS:
        raise ValueError(f"its holds are divided into {steps!r} steps")
    halves = header.get("halves", 0)
    if type(halves) is not int or not 0 <= halves <= MOST_HALVES:
        raise ValueError(f"its cells may be halved {halves!r} times")
    enclosure = header.get("enclosure", STANDARD)
    if type(enclosure) is not str or enclosure not in enclosures():
        raise ValueError(
            f"its enclosures are {enclosure!r:.40}, and this version has " + ", ".join(enclosures())
        )
    return Sampling(hold, tuple(errors), delay, under_way, law, steps, enclosure, halves)


def _cells(header: Mapping[str, Any], axes: int) -> Cells:
    edges = tuple(np.array([_finite(e) for e in axis]) for axis in header["edges"])
    periodic = tuple(header["periodic"])
    if not (len(edges) == len(periodic) == axes and all(type(p) is bool for p in periodic)):
        raise ValueError("axes and states are not as many")
    if not all(len(e) > 1 and (np.diff(e) > 0).all() for e in edges):
        raise ValueError("the edges of an axis do not grow")
    return Cells(edges, periodic)


def _depth(header: Mapping[str, Any], cells: Cells) -> int:
    """How often the largest cells were halved."""
    depth = header.get("depth", 0)
    if type(depth) is not int or not 0 <= depth <= MOST_DEPTH:
        raise ValueError(f"its cells were halved {depth!r} times")
    if any(count % 2**depth for count in cells.counts):
        raise ValueError(f"its cells cannot have been halved {depth} times")
    return depth


def _kept(header: Mapping[str, Any], packed: bytes, halvings: Halvings, region: Wholes) -> Kept:
    count, holds = header["entries"], header["holds"]
    if not (type(count) is int and count >= 0):
        raise ValueError(f"it has {count!r} entries")
    most = count * ENTRY.itemsize
    content = unpacked(packed, MOST_OF_ENTRIES)
    if len(content) != most:
        raise ValueError(f"its entries are not {count}")
    rows = np.frombuffer(content, dtype=ENTRY)
    names = ENTRY.names or ()
    entries = np.stack([rows[n].astype(np.int64) for n in names], axis=1)
    cell, tried, level = entries.T
    law = header["law"]
    inputs = len(law["modes"]) if law else len(header["candidates"])
    if count and (
        not halvings.has(cell) or tried.max() >= inputs
        or level.max() > (holds or 0) or (holds is not None and level.min() < 1)
    ):  # fmt: skip
        raise ValueError("an entry has a cell, an input or a level that there is none of")
    first = entries[tried == law["initial"]] if law else entries
    kept_set = Kept.of(halvings, first, holds, 0, region, target=bool(header["target"]))
    members = kept_set.members
    if len(members) != header["cells_kept"] or (members[1:] == members[:-1]).any():
        raise ValueError(f"the cells that are kept are not {header['cells_kept']}")
    return replace(kept_set, entries=entries)


def _region(
    halvings: Halvings,
    constraints: Sequence[sp.Expr],
    states: Sequence[Any],
    of: Mapping[Any, Range],
    errors: Sequence[float],
) -> Wholes:
    """The cells that lie in the region wherever they are measured."""
    enclosure = Enclosure(constraints, [*states, *of]) if constraints else None

    def sure(low: Array, high: Array) -> Truths:
        if enclosure is None:
            return np.ones(len(low), dtype=bool)
        for axis, error in enumerate(errors):
            if error:
                low[:, axis] = np.nextafter(low[:, axis] - error, -np.inf)
                high[:, axis] = np.nextafter(high[:, axis] + error, np.inf)
        ends = [np.tile([r[k] for r in of.values()], (len(low), 1)) for k in (0, 1)]
        most = enclosure.over(np.hstack([low, ends[0]]), np.hstack([high, ends[1]]))[1]
        inside: Truths = np.asarray((most <= 0).all(axis=1))
        return inside

    return sure_of(sure, halvings)


def _quantities(rows: Any) -> tuple[tuple[str, str], ...]:
    return tuple((_text(q["name"]), _text(q["unit"])) for q in rows)


def _range(ends: Any) -> Range:
    low, high = (_finite(e) for e in ends)
    if low > high:
        raise ValueError(f"a range from {low:g} to {high:g}")
    return low, high


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is no text")
    return value


def _finite(value: Any) -> float:
    number = float.fromhex(_text(value))
    if not math.isfinite(number):
        raise ValueError(f"{value} is not finite")
    return number
