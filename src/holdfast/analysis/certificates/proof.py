"""What a certificate proves of single states: where a held input leads from exactly there."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from holdfast.analysis.certificates.arrival import flow_of
from holdfast.analysis.certificates.cells import Counted, Floats, Truths, Wholes
from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.certified_law import cell_table
from holdfast.execution.codegen.scalar_llvm import called

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
        entries: Floats = self._table[0]
        levels = entries[total:] if self.lasts else np.zeros(total)
        levels = np.where(entries[:total] < len(self.candidates), levels, -1).astype(np.int64)
        if self.lasts and not certificate.target:  # with no period left a state is in the region
            left = certificate.kept.region
            levels[left] = np.maximum(levels[left], 0)
        self._levels = levels
        self._sets: dict[int, Counted] = {}

    def looked_up(self, states: Floats) -> tuple[Floats, Floats]:
        """For how long the cell of each state keeps it [s], -1 where none does, and its inputs.

        With a target: in what time it leads there, 0 where the state is there.
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

    def needed(self, seconds: Floats) -> Wholes:
        """The level that an input has to lead to, for states that are kept so long [s].

        One less than that of their cell; to any certified cell from where none is, and from the
        target.
        """
        if not self.lasts:
            return np.zeros(len(seconds), dtype=np.int64)
        levels = np.rint(seconds / self.certificate.hold).astype(np.int64)
        least = (self.certificate.kept.holds or 0) if self.certificate.target else 1
        return np.where(levels > 0, levels - 1, least)

    def inside(self, states: Floats) -> Truths:
        """Whether the constraints surely hold at states."""
        return self.flow.inside(states, states)

    def leads(self, states: Floats, inputs: Floats, needed: Wholes) -> Truths:
        """Whether an input leads from each state to cells of that level, inside on the way.

        Proved, with every rounding, of states at which the constraints hold.
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
