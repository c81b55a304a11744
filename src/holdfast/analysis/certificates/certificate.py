"""Certificates: what is proved of a vehicle, as a file that another program checks."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Floats, Wholes
from holdfast.analysis.certificates.images import forget
from holdfast.analysis.certificates.kept_set import Kept
from holdfast.analysis.certificates.law_written import written
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.intervals.held_flow import Sampling
from holdfast.host.files import atomic_file
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.expressions.traversal import exact, plain_text

MAGIC = "holdfast-certificate 1"
ENTRY = np.dtype([("cell", "<u4"), ("input", "<u2"), ("level", "<u4")])
MOST_CELLS, MOST_INPUTS, MOST_DEPTH, MOST_STEPS, MOST_HALVES = 2**32, 2**16, 31, 64, 16

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
    candidates: Floats
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
        more = {"depth": kept_set.depth} if kept_set.depth else {}
        more |= {"steps": self.sampling.steps} if self.sampling.steps > 1 else {}
        more |= {"halves": self.sampling.halves} if self.sampling.halves else {}
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

    def write(self, path: Path) -> Path:
        """The file: its kind and digest, one line of JSON, and the packed entries."""
        total = self.cells.total * (self.kept.depth + 1)  # numbers of cells of all sizes
        if total >= MOST_CELLS or len(self.candidates) >= MOST_INPUTS:
            raise SimulationError(
                f"{total} cells and {len(self.candidates)} inputs",
                expected=f"fewer than {MOST_CELLS} and {MOST_INPUTS} in a certificate",
            )
        packed = zlib.compress(_packed(self.kept.entries), 6)
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
                    f"function '{name}' has no proved enclosure in a certificate: {part}",
                    expected=", ".join(KNOWN),
                )


def check_names(names: Iterable[str]) -> None:
    """Raises `DefinitionError` for a name that the checker reads as something else."""
    for name in names:
        if name in (*KNOWN, *RESERVED):
            raise DefinitionError(
                f"'{name}' is the name of a function or number", remedy="rename it"
            )


def _packed(entries: Wholes) -> bytes:
    rows = np.empty(len(entries), dtype=ENTRY)
    for k, name in enumerate(ENTRY.names or ()):
        rows[name] = entries[:, k]
    return rows.tobytes()


def limits_written(constraints: Iterable[tuple[str, str, sp.Expr]]) -> list[dict[str, str]]:
    return [{"name": n, "unit": u, "expression": plain_text(e)} for n, u, e in constraints]


def named(quantities: Sequence[tuple[str, str]]) -> list[dict[str, Any]]:
    return [{"name": n, "unit": u} for n, u in quantities]


def ranged(
    quantities: Sequence[tuple[str, str]], ranges: Mapping[str, Range]
) -> list[dict[str, Any]]:
    return [
        {"name": n, "unit": u, "range": [float(v).hex() for v in ranges[n]]} for n, u in quantities
    ]
