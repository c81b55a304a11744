"""The law of a certificate: in every certified cell the input that keeps it.

Of a single state more is proved than of its cell: where a held input leads from exactly there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import sympy as sp

from holdfast.analysis.certificates.cells import Cells, Counted
from holdfast.analysis.certificates.certificate import NONE, Certificate, flow_of, inputs_at_target
from holdfast.analysis.certificates.problem import ROUNDED
from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import Array, Truths, Wholes
from holdfast.execution.codegen.scalar_llvm import called
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.law import CellLookup, Law
from holdfast.maths.definitions.quantity import Parameter, Quantity
from holdfast.maths.definitions.sets.base import Box
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact

KEYS = {
    "title", "states", "inputs", "disturbances", "parameters", "rates", "constraints", "target",
    "law", "hold", "delay", "errors", "holds", "edges", "periodic", "candidates",
    "cells_in_region", "cells_kept", "entries",
}  # fmt: skip
"""What a header says: another key could change what is proved."""

REMAINING = "remaining"
"""The signal for how long the state is kept still, or in what time it is at the target."""


@checked
def certified_law(
    certificate: Certificate,
    system: System | None = None,
    *,
    disturbance: Mapping[str, float] | None = None,
) -> Law:
    """The law of a certificate: u = u_X for a state in the certified cell X, held for T.

    certificate: found by `certify`, or read from its file (`read_certificate`).

    A state on the edge of two cells takes one that is certified. In no certified cell the input is
    that of the nearest one, counted in cells: nothing is promised there, and a run has the outcome
    "left grid". Other sample times than T are refused. A certificate for a horizon has the signal
    `remaining` [s]: how long the state is kept from now on, 0 where it is not.

    With a target `remaining` is when the state is at the target at the latest, 0 at the target. The
    input there is one that keeps the target at every sample from now on; where none that was tried
    does, one that leads back to it, and else that of the nearest cell.

    system: the vehicle, whose rates have to be those of the certificate, and its numbers and bounds
    within those of it; by default `certified_system(certificate)`. disturbance: those that are
    known and constant, of which the bounds do not count.

    Raises `DefinitionError` for a certificate without a cell and for another system.

    >>> hf.certified_law(certificate, cart)
    Law 'certified inputs of cart in track' of x, v
      a = _C0
      looks up a table at x, v
    """
    check_usable(certificate)
    if system is None:
        states = tuple(Quantity(n, u) for n, u in certificate.states)
    else:
        check_fits(certificate, system, disturbance or {})
        states = system.states
    lookup = CellLookup(
        tuple(q.symbol for q in states),
        cell_table(certificate),
        unit="s",
        width=len(certificate.inputs),
        hold=certificate.hold,
        errors=certificate.sampling.errors,
        delay=certificate.sampling.delay,
    )
    inputs = [n for n, _ in certificate.inputs]
    return Law(
        name=f"certified inputs of {certificate.title}",
        reads=states,
        outputs=dict(zip(inputs, lookup.entries, strict=True)),
        signals={} if certificate.kept.holds is None else {REMAINING: lookup.value},
        lookup=lookup,
        description="the input of the certified cell that the state is in",
        source="holdfast's own",
    )


@checked
def certified_system(certificate: Certificate) -> System:
    """The system that a certificate is of, from its file alone.

        xdot = f(x, u, d; p)

    Uncertain numbers have the middle of their range; a disturbance that is known has bounds that
    are one number.

    certificate: found, or read from its file.

    The bounds of the inputs are the box of those that were tried, where all its corners were; a
    file has no others. An axis that comes back to itself is an angle.

    >>> print(hf.certified_system(certificate))
    System 'cart': 2 states, 1 input
      x' = v
      v' = a
      inputs: a in [-1.0, 1.0] m/s^2
    """
    ranges = certificate.ranges
    disturbances = tuple(Quantity(n, u) for n, u in certificate.disturbances)
    bounds = [ranges[n] for n, _ in certificate.disturbances]
    full = _whole_box(certificate.candidates)
    return System(
        name=certificate.title.partition(" in ")[0],
        states=tuple(
            Quantity(n, u, angle=turns)
            for (n, u), turns in zip(certificate.states, certificate.cells.periodic, strict=True)
        ),
        inputs=tuple(Quantity(n, u) for n, u in certificate.inputs),
        rates={n: r for (n, _), r in zip(certificate.states, certificate.rates, strict=True)},
        disturbances=disturbances,
        parameters=tuple(
            Parameter(n, u, value=0.5 * (ranges[n][0] + ranges[n][1]))
            for n, u in certificate.parameters
        ),
        input_bounds=None if full is None else Box(*full),
        disturbance_bounds=Box(*zip(*bounds, strict=True)) if bounds else None,
    )


def _whole_box(candidates: Array) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """The box of the inputs that were tried, if all its corners were tried."""
    if not candidates.shape[1]:
        return None
    low, high = candidates.min(axis=0), candidates.max(axis=0)
    extreme = (candidates == low) | (candidates == high)
    corners = np.unique(candidates[extreme.all(axis=1)], axis=0)
    if len(corners) < 2 ** int((low < high).sum()):
        return None
    return tuple(low.tolist()), tuple(high.tolist())


# -- the table ---------------------------------------------------------------------------------


def lasting(certificate: Certificate) -> tuple[Wholes, Wholes, Wholes]:
    """The cells with an entry, the input of each, and for how many periods it keeps it.

    An input that leads to cells of one level lower does so for all lower levels, so that the entry
    of the highest level of a cell is enough. The level is 0 for ever. With a target it is in how
    many periods the cell leads there, of which the lowest counts.

    All three have the shape (cells,).
    """
    entries = certificate.kept.spread()
    better = -entries[:, 2] if certificate.target else entries[:, 2]
    order = np.lexsort((better, entries[:, 0]))
    last = np.r_[entries[order[1:], 0] != entries[order[:-1], 0], True]
    cell, tried, level = entries[order[last]].T
    return cell, tried, level


def cell_table(certificate: Certificate) -> tuple[Any, ...]:
    """The table of `look_in_cells.py`: every cell has the input of itself or of the nearest one.

    Cells of a target are known too, for no time.
    """
    cells, rows = certificate.cells, len(certificate.candidates)
    cell, tried, level = lasting(certificate)
    arrived = np.empty(0, dtype=np.int64)
    if certificate.target:
        arrived, best = inputs_at_target(certificate)
        outside = ~np.isin(cell, arrived)
        some, lasts = arrived[best != NONE], np.zeros((best != NONE).sum(), dtype=np.int64)
        cell = np.concatenate([cell[outside], some])
        tried = np.concatenate([tried[outside], best[best != NONE]])
        level = np.concatenate([level[outside], lasts])
    entries = np.full(math.prod(cells.counts), 2 * rows, dtype=np.int64)
    entries[cell] = tried
    entries = np.where(entries < rows, entries, entries[_nearest(cells, cell)] + rows)
    entries[arrived] %= rows
    last, parts = math.inf, [entries.astype(np.float64)]
    if certificate.kept.holds is not None:
        levels = np.zeros(len(entries))
        levels[cell] = level
        last, parts = certificate.hold, [*parts, levels]
    numbers = np.concatenate([*cells.edges, certificate.candidates.ravel(), [last]])
    return (
        np.concatenate(parts),
        np.array([e[0] for e in cells.edges]),
        np.array([e[-1] - e[0] for e in cells.edges]),
        np.array(cells.counts, dtype=np.int64),
        np.array(cells.periodic),
        numbers,
        rows,
    )


def _nearest(cells: Cells, certified: Wholes) -> Wholes:
    """Of every cell the nearest one of those that are certified, counted in cells."""
    from scipy.ndimage import distance_transform_edt

    missing = np.ones(cells.counts, dtype=bool)
    missing.reshape(-1)[certified] = False
    turns = [(n, n) if p else (0, 0) for n, p in zip(cells.counts, cells.periodic, strict=True)]
    around = np.pad(missing, turns, mode="wrap") if any(cells.periodic) else missing
    places = distance_transform_edt(around, return_distances=False, return_indices=True)
    middle = tuple(slice(a, a + n) for (a, _), n in zip(turns, cells.counts, strict=True))
    indices = [
        p[middle] % n if turned else p[middle]
        for p, n, turned in zip(places, cells.counts, cells.periodic, strict=True)
    ]
    nearest: Wholes = np.ravel_multi_index(tuple(indices), cells.counts).reshape(-1)
    return nearest


# -- whether a vehicle is the one that is certified ----------------------------------------------


def check_usable(certificate: Certificate) -> None:
    """Raises `DefinitionError` for a certificate without a cell, or of more than is known here."""
    if not len(certificate.kept.members):
        raise DefinitionError(
            f"the certificate '{certificate.title}' has no cell",
            remedy="certify with more cells or inputs, or for a shorter horizon",
        )
    if certificate.sampling.law is not None:
        raise DefinitionError(
            f"the certificate '{certificate.title}' is of a law", remedy="take that law"
        )


def check_fits(
    certificate: Certificate, system: System, constants: Mapping[str, float] | None = None
) -> None:
    """Raises `DefinitionError` where a system is not the one that the certificate is of.

    constants: disturbances that are constant.
    """
    for what, quantities, said in (
        ("states", system.states, certificate.states),
        ("inputs", system.inputs, certificate.inputs),
        ("disturbances", system.disturbances, certificate.disturbances),
    ):
        if tuple((q.name, q.unit) for q in quantities) != said:
            raise DefinitionError(
                f"system '{system.name}' has the {what} "
                + _listed((q.name, q.unit) for q in quantities),
                expected=f"those of the certificate: {_listed(said)}",
            )
    ranges = certificate.ranges
    for p in system.parameters:
        low, high = ranges.get(p.name, (-math.inf, math.inf))
        if not low <= p.value <= high:
            raise DefinitionError(
                f"system '{system.name}' has {p.name} = {p.value:g}",
                expected=f"{low:g} to {high:g}, for which it is certified",
                remedy="certify it again; to simulate another vehicle under this law, use plant",
            )
    for (name, _), rate in zip(certificate.states, certificate.rates, strict=True):
        if exact(system.rates[name]) != exact(rate) and not _same(system, name, rate):
            raise DefinitionError(
                f"the rate of '{name}' of system '{system.name}' is not the certified one",
                remedy="certify this system",
            )
    _check_bounds(certificate, system, constants or {})


def _same(system: System, name: str, rate: sp.Expr) -> bool:
    """Whether two rates are one expression, written otherwise."""
    equal: bool = sp.expand(exact(system.rates[name]) - exact(rate)) == 0
    return equal


def _check_bounds(certificate: Certificate, system: System, constants: Mapping[str, float]) -> None:
    ends = {name: (value, value) for name, value in constants.items()}
    if any(q.name not in constants for q in system.disturbances):
        if system.disturbance_bounds is None:
            raise DefinitionError(f"system '{system.name}' has no bounds of its disturbances")
        numbers = {p.symbol: p.value for p in system.parameters}
        bounds = system.disturbance_bounds.at(numbers).ranges()
        ends = dict(zip(system.disturbance_names, bounds, strict=True)) | ends
    for q in system.disturbances:
        (low, high), (least, most) = ends[q.name], certificate.ranges[q.name]
        if low < least - ROUNDED or high > most + ROUNDED:
            raise DefinitionError(
                f"'{q.name}' of system '{system.name}' is {float(low):g} to {float(high):g}",
                expected=f"within {least:g} to {most:g}, for which it is certified",
                remedy="take certified_system(certificate), which has these bounds",
            )
    if system.input_bounds is not None and certificate.sampling.law is None:
        inputs = [q.symbol for q in system.inputs]
        limited = Evaluator(system.input_bounds.saturate(inputs), inputs, system.parameters)
        tried = certificate.candidates
        off = np.abs(limited.values(tried) - tried).max(axis=0)
        for q, most in zip(system.inputs, off, strict=True):
            if most > 1e-9 * (1 + np.abs(tried).max()):
                raise DefinitionError(
                    f"the certificate has an input that '{q.name}' of system '{system.name}' "
                    "cannot have",
                    expected="the bounds of the certified system",
                )


def _listed(quantities: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{n} [{u}]" for n, u in quantities) or "none"


AROUND = (1e-6, 0.1)
"""Parts of a cell by which a state is enclosed. The way from a narrow box may have no room for the
inclusion that proves it: where it is not enclosed, a wider one is tried."""


class Proof:
    """The cells of a certificate, and the enclosures that they were certified with.

    A cell is certified as a whole. From one state of it more inputs lead into the set, and from a
    state of a cell that is not certified some may.
    """

    def __init__(self, certificate: Certificate) -> None:
        self.certificate, self.cells = certificate, certificate.cells
        self.candidates = np.ascontiguousarray(certificate.candidates)
        self.flow = flow_of(certificate)
        self.lasts = certificate.kept.holds is not None
        self._widths = np.array([np.diff(e).min() for e in self.cells.edges])
        self._table: tuple[Any, ...] = cell_table(certificate)
        total = math.prod(self.cells.counts)
        entries: Array = self._table[0]
        levels = entries[total:] if self.lasts else np.zeros(total)
        levels = np.where(entries[:total] < len(self.candidates), levels, -1).astype(np.int64)
        if self.lasts and not certificate.target:  # with no period left a state is in the region
            left = certificate.kept.region
            levels[left] = np.maximum(levels[left], 0)
        self._levels = levels
        self._sets: dict[int, Counted] = {}

    def looked_up(self, states: Array) -> tuple[Array, Array]:
        """For how long the cell of each state keeps it [s], -1 where none does, and its inputs.

        With a target: in what time it leads there, 0 where the state is there.

        states: shape (count, states). The times have the shape (count,), the inputs (count,
        inputs).
        """
        entries, _, _, shape, periodic, numbers, rows = self._table
        axes, width = states.shape[1], 1 + self.candidates.shape[1]
        out = np.empty((len(states), width))
        called(
            "look_in_cells", "look_in_cells_many", len(states), entries,
            np.ascontiguousarray(states), numbers, shape, periodic.astype(np.int64), axes, rows,
            width, out, np.empty(2 * axes, dtype=np.int64),
        )  # fmt: skip
        return out[:, 0], out[:, 1:]

    def needed(self, seconds: Array) -> Wholes:
        """The level that an input has to lead to, for states that are kept so long [s].

        One less than that of their cell; to any certified cell from where none is, and from the
        target.

        seconds: shape (count,), as the levels.
        """
        if not self.lasts:
            return np.zeros(len(seconds), dtype=np.int64)
        levels = np.rint(seconds / self.certificate.hold).astype(np.int64)
        least = (self.certificate.kept.holds or 0) if self.certificate.target else 1
        return np.where(levels > 0, levels - 1, least)

    def inside(self, states: Array) -> Truths:
        """Whether the constraints surely hold at states, shape (count, states)."""
        return self.flow.inside(states, states)

    def leads(self, states: Array, inputs: Array, needed: Wholes) -> Truths:
        """Whether an input leads from each state to cells of that level, inside on the way.

        Proved, with every rounding, of states at which the constraints hold.

        states: shape (count, states). inputs: shape (count, inputs). needed: shape (count,), as the
        answers.
        """
        fine = np.zeros(len(states), dtype=bool)
        left = np.arange(len(states))
        for part in AROUND:
            x, room = states[left], part * self._widths
            held = self.flow.held(x - room, x + room, inputs[left])
            first, last, inside = self.cells.touched(held.low, held.high)
            usable = held.kept & inside
            for level in set(needed[left[usable]].tolist()):
                some = np.flatnonzero(usable & (needed[left] == level))
                fine[left[some]] = self._set(level).all_of(first[some], last[some])
            left = left[~held.kept]
            if not len(left):
                break
        return fine

    def _set(self, level: int) -> Counted:
        """The cells of at least that level, or that are so near to the target."""
        if level not in self._sets:
            target = bool(self.certificate.target)
            fine = self._levels <= level if target else self._levels >= level
            self._sets[level] = Counted(self.cells, fine & (self._levels >= 0))
        return self._sets[level]
