"""Certificates: what is proved of a vehicle, as a file that another program checks.

The header of the file has the cases of a law too. At the target of its certificate a law stays as
long as it can.
"""

from __future__ import annotations

import base64
import hashlib
import importlib
import json
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Counted, Halvings, Kept
from holdfast.analysis.certificates.images import Images, forget, images, sure_of
from holdfast.errors import DefinitionError, ModelWarning, OutputError, SimulationError
from holdfast.execution.arrays import Array, Truths, Wholes
from holdfast.execution.intervals.enclosures import STANDARD
from holdfast.execution.intervals.held_flow import HeldFlow, Sampling
from holdfast.execution.intervals.law_ranges import TableRanges
from holdfast.host.files import Stored, atomic_file
from holdfast.maths.definitions.law import LawCases, Lookup, Option, Program
from holdfast.maths.definitions.quantity import TIME, TIME_IN_MODE, symbol
from holdfast.maths.expressions.traversal import exact, plain_text

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


MAGIC = "holdfast-certificate 1"
ENTRY = np.dtype([("cell", "<u4"), ("input", "<u2"), ("level", "<u4")])
MOST_CELLS, MOST_INPUTS, MOST_DEPTH, MOST_STEPS, MOST_HALVES = 2**32, 2**16, 31, 64, 8

KNOWN = (
    "sin", "cos", "tan", "atan", "exp", "log", "tanh", "Abs", "magnitude", "least", "greatest",
    "angle", "atan2", "length", "wrap",
)  # fmt: skip
"""Functions of expressions that the checker knows, beside powers of whole and half numbers."""

RESERVED = ("pi", "sqrt", "E", "I")

Range = tuple[float, float]


@dataclass(frozen=True)
class Certificate:
    """A set of cells that a system is kept in, by held inputs, whatever the disturbances.

        xdot = f(x, u, d; p),    c_j(x) <= 0 at every instant,    d(t) in D, p in P

    states, inputs, disturbances: (name, unit) each. ranges: of disturbances and parameters, any
    number between counts. rates, constraints: exact expressions. candidates: inputs that were
    tried, shape (inputs, ...); none where a law gives them. sampling: how long inputs are held, and
    what is not exact about the states and inputs. target: where the system arrives; none where it
    stays.
    """

    title: str
    states: tuple[tuple[str, str], ...]
    inputs: tuple[tuple[str, str], ...]
    disturbances: tuple[tuple[str, str], ...]
    parameters: tuple[tuple[str, str], ...]
    ranges: Mapping[str, Range]
    rates: tuple[sp.Expr, ...]
    constraints: tuple[tuple[str, str, sp.Expr], ...]
    sampling: Sampling
    candidates: Array
    kept: Kept
    target: tuple[tuple[str, str, sp.Expr], ...] = ()

    @property
    def hold(self) -> float:
        """The sampling period [s]."""
        return self.sampling.hold

    @property
    def cells(self) -> Cells:
        return self.kept.cells

    def header(self) -> dict[str, Any]:
        """What the file says before its entries; numbers in hexadecimal digits, which are exact."""
        kept_set, law = self.kept, self.sampling.law
        more: dict[str, Any] = {"depth": kept_set.depth} if kept_set.depth else {}
        more |= {"steps": self.sampling.steps} if self.sampling.steps > 1 else {}
        more |= {"halves": self.sampling.halves} if self.sampling.halves else {}
        enclosure = self.sampling.enclosure
        more |= {"enclosure": enclosure} if enclosure != STANDARD else {}
        return {
            "title": self.title,
            "states": named(self.states),
            "inputs": named(self.inputs),
            "disturbances": ranged(self.disturbances, self.ranges),
            "parameters": ranged(self.parameters, self.ranges),
            "rates": [plain_text(r) for r in self.rates],
            "constraints": limits_written(self.constraints),
            "target": limits_written(self.target),
            "law": [] if law is None else written(law, self.sampling.under_way, plain_text),
            "hold": self.hold.hex(),
            "delay": self.sampling.delay.hex(),
            "errors": [float(e).hex() for e in self.sampling.errors],
            "holds": kept_set.holds,
            "edges": [[float(e).hex() for e in axis] for axis in kept_set.cells.edges],
            "periodic": list(kept_set.cells.periodic),
            "candidates": [[float(v).hex() for v in row] for row in self.candidates],
            **more,
            "cells_in_region": kept_set.inside,
            "cells_kept": len(kept_set.members),
            "entries": len(kept_set.entries),
        }

    def summary(self) -> dict[str, Any]:
        """Plain data."""
        kept_set = self.kept
        return {
            "title": self.title,
            "cells_in_region": kept_set.inside,
            "cells_certified": len(kept_set.members),
            "share": kept_set.share,
            "seconds": None if kept_set.holds is None else kept_set.holds * self.hold,
            "sample_time": self.hold,
            "delay": self.sampling.delay,
            "errors": {n: e for (n, _), e in zip(self.states, self.sampling.errors, strict=True)},
            "kind": "reach" if self.target else "keep",
            "law": self.sampling.law is not None,
            "inputs_tried": len(self.candidates),
            "cells": list(kept_set.cells.counts),
            "halved": kept_set.depth,
            "entries": len(kept_set.entries),
            "sweeps": kept_set.sweeps,
            "ranges": {name: list(ends) for name, ends in self.ranges.items()},
        }

    def write(self, path: str | Path) -> Path:
        """The file: its kind and digest, one line of JSON, and the packed entries."""
        path = Path(path)
        total = self.cells.total * (self.kept.depth + 1)  # numbers of cells of all sizes
        if total >= MOST_CELLS or len(self.candidates) >= MOST_INPUTS:
            raise SimulationError(
                f"{total} cells and {len(self.candidates)} inputs",
                expected=f"fewer than {MOST_CELLS} and {MOST_INPUTS} in a certificate",
            )
        packed = zlib.compress(_rows(self.kept.entries), 6)
        write_checked(path, MAGIC, self.header(), packed)
        forget(path.parent)
        return path


def write_checked(path: Path, magic: str, header: Mapping[str, Any], packed: bytes) -> None:
    """A file for the checker: its kind and digest, one line of JSON, and what is packed."""
    text = json.dumps(header, separators=(",", ":"), sort_keys=True).encode()
    content = text + b"\n" + packed
    digest = hashlib.sha256(content).hexdigest()
    with atomic_file(path) as partial:
        partial.write_bytes(f"{magic} {digest}\n".encode() + content)


def check_functions(expressions: Iterable[sp.Expr]) -> None:
    """Raises `DefinitionError` for a function that the checker does not know, and for time."""
    for e in expressions:
        if TIME in e.free_symbols:
            raise DefinitionError(
                f"the expression depends on time: {e}", expected="rates and constraints without t"
            )
        for part in sp.preorder_traversal(exact(e)):
            name = type(part).__name__
            if part.is_NumberSymbol and part is not sp.pi:
                raise DefinitionError(f"a certificate has no {part}: {e}", expected="pi, exp(...)")
            halves = part.is_Pow and part.exp.is_Rational and (2 * part.exp).is_Integer
            if part.is_Pow and not halves and not isinstance(part, sp.exp):
                raise DefinitionError(
                    f"a certificate has no power {part}",
                    expected="whole and half numbers as exponents",
                )
            if part.args and not (part.is_Add or part.is_Mul or part.is_Pow) and name not in KNOWN:
                raise DefinitionError(
                    f"function '{name}' has no proved enclosure in a certificate: {part!s:.60}",
                    expected=", ".join(KNOWN),
                )


def check_names(names: Iterable[str]) -> None:
    """Raises `DefinitionError` for a name that the checker reads as something else."""
    for name in names:
        if name in (*KNOWN, *RESERVED):
            raise DefinitionError(
                f"'{name}' is the name of a function or number", remedy="rename it"
            )


def _rows(entries: Wholes) -> bytes:
    rows = np.empty(len(entries), dtype=ENTRY)
    for k, name in enumerate(ENTRY.names or ()):
        rows[name] = entries[:, k]
    return rows.tobytes()


def limits_written(constraints: Iterable[tuple[str, str, sp.Expr]]) -> list[dict[str, str]]:
    return [{"name": n, "unit": str(u), "expression": plain_text(e)} for n, u, e in constraints]


def named(quantities: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    return [{"name": n, "unit": str(u)} for n, u in quantities]  # plain, as of a file


def ranged(
    quantities: Sequence[tuple[str, str]], ranges: Mapping[str, Range]
) -> list[dict[str, Any]]:
    return [{**q, "range": [float(v).hex() for v in ranges[q["name"]]]} for q in named(quantities)]


NONE = -1


def flow_of(certificate: Certificate) -> HeldFlow:
    """The enclosures that a certificate was found with."""
    ranges = certificate.ranges
    return HeldFlow(
        certificate.rates,
        [e for _, _, e in certificate.constraints],
        [symbol(n) for n, _ in certificate.states],
        [symbol(n) for n, _ in certificate.inputs],
        {symbol(n): ranges[n] for n, _ in certificate.disturbances},
        {symbol(n): ranges[n] for n, _ in certificate.parameters},
        certificate.sampling,
        [e for _, _, e in certificate.target],
    )


def inputs_at_target(certificate: Certificate) -> tuple[Wholes, Wholes]:
    """The cells of the target, and for each the input that was tried and is best there.

    That is one which keeps the target at every sample from now on; where none does, one which leads
    to cells of the target or to certified ones; NONE where none does either. The region is kept on
    the way. Of several it is the one that is nearest to zero, in parts of what was tried.

    Both have the shape (cells of the target,).
    """
    cells, tried = certificate.cells, certificate.candidates
    flow = flow_of(certificate)
    target = sure_of(flow.arrived, Halvings(cells, certificate.kept.depth))
    all_images = images(flow, cells, tried, target, lambda what, share: None)
    stays = np.ones(len(target), dtype=bool)
    while True:
        leads = _led(all_images, stays, Counted(cells, _noted(certificate, target[stays])))
        if (stays == (stays & leads.any(axis=1))).all():
            break
        stays &= leads.any(axis=1)
    certified = np.concatenate([target, certificate.kept.members])
    again = _led(all_images, ~stays, Counted(cells, _noted(certificate, certified)))
    leads = np.where(stays[:, None], leads, again)
    order = _from_zero(tried)
    first = order[leads[:, order].argmax(axis=1)]
    return target, np.where(leads.any(axis=1), first, NONE)


def _noted(certificate: Certificate, of: Wholes) -> Truths:
    noted = np.zeros(int(np.prod(certificate.cells.counts)), dtype=bool)
    noted[of] = True
    return noted


def _led(images: Images, rows: Truths, into: Counted) -> Truths:
    """Whether each input leads from each of these cells into a set, shape (cells, inputs)."""
    asked = images.usable & rows[:, None]
    leads = np.zeros(asked.shape, dtype=bool)
    leads[asked] = into.all_of(
        images.first[asked].astype(np.int64), images.last[asked].astype(np.int64)
    )
    return leads


def _from_zero(tried: Array) -> Wholes:
    """The numbers of inputs, those that are nearest to zero first."""
    most = np.abs(tried).max(axis=0)
    order: Wholes = ((tried / np.where(most > 0, most, 1)) ** 2).sum(axis=1).argsort(kind="stable")
    return order


def part_of_checker(name: str) -> ModuleType:
    """A module of the checker, which is a program of its own and shares no code with this one.

    Raises `SimulationError` where the library of its numbers is missing.
    """
    try:
        return importlib.import_module(f"holdfast_check.{name}")
    except ImportError as error:
        if error.name != "flint":
            raise
        raise SimulationError(
            "the checker of certificates needs python-flint",
            remedy="python -m pip install 'holdfast[check]'",
        ) from error


def check_content(file: Path, content: bytes, share: float) -> None:
    """Let the checker read the content of a file, and warn of what it did not check.

    share: of its entries, drawn anew each time; 0 for none. That a whole file is valid is kept in
    the cache, by the digest of the content and of the checker, so that it is asked once.

    Raises `OutputError` for what is not valid.
    """
    if share == 0:
        return _warn(f"{file} was not checked: that its cells are kept is what it says")
    try:
        checker = part_of_checker("checker")
    except SimulationError as missing:
        return _warn(
            f"{file} was not checked: that its cells are kept is what it says; {missing.cause}",
            missing.remedy,
        )
    verdicts = Stored("certificate", _digest_of_checker())
    digest = hashlib.sha256(content).hexdigest()
    if verdicts.load(digest) is not None:
        return None
    numbers = checker.flint.ctx
    bits = numbers.prec
    try:
        verdict = checker.proved(content, share)
    except checker.NotValidError as wrong:
        raise OutputError(
            f"{file} is not valid: {wrong}", remedy="certify again; nothing of it is proved"
        ) from None
    except Exception as error:  # whatever a file contains
        raise OutputError(
            f"{file} cannot be checked ({type(error).__name__}: {error!s:.200})"
        ) from error
    finally:
        numbers.prec = bits
    if not verdict["valid"]:
        return _warn(
            f"{verdict['checked']} of {verdict['entries']} entries of {file} were checked (seed "
            f"{verdict['seed']}): that the others are kept is what it says"
        )
    return verdicts.save(digest, b"valid")


def _warn(cause: str, remedy: str | None = None) -> None:
    text = cause if remedy is None else f"{cause}: {remedy}"
    warnings.warn(text, ModelWarning, stacklevel=5)


def _digest_of_checker() -> str:
    """Of its source and of the version of its numbers, so that another one is asked anew."""
    digest = hashlib.sha256(version("python-flint").encode())
    for path in sorted(Path(str(resources.files("holdfast_check"))).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
