"""Sets of cells that are certified, with the input of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.analysis.certificates.cells import Cells, Halvings, Wholes


@dataclass(frozen=True)
class Kept:
    """members: numbers of the cells that are kept; inputs: for each the one that keeps it.

    region: the cells that lie in the region. holds: sampling periods, None for ever. depth: how
    often cells were halved; `cells`, and all these numbers, are of the smallest. entries: rows
    (number in `Halvings`, input, level): the input leads from that cell to cells of a level one
    lower, as many periods as are left at most; the level is 0 for ever.
    """

    cells: Cells
    members: Wholes
    inputs: Wholes
    holds: int | None
    sweeps: int
    entries: Wholes
    region: Wholes
    depth: int = 0

    @staticmethod
    def of(
        halvings: Halvings, entries: Wholes, holds: int | None, sweeps: int, region: Wholes,
        *, target: bool = False,
    ) -> Kept:  # fmt: skip
        """Members are the cells of the entries that last longest; with a target, of all entries."""
        final = entries if target else entries[entries[:, 2] == (holds or 0)]
        members, rows = halvings.spread(final[:, 0])
        order = np.argsort(members, kind="stable")
        members, inputs = members[order], final[rows[order], 1]
        region = np.union1d(region, members)  # a cell may lead to the target, and lie partly in it
        return Kept(
            halvings.finest, members, inputs, holds, sweeps, entries, region, halvings.depth
        )

    @property
    def inside(self) -> int:
        """How many cells lie in the region."""
        return len(self.region)

    @property
    def share(self) -> float:
        """Of the cells that lie in the region."""
        return len(self.members) / self.inside if self.inside else 0.0

    def spread(self) -> Wholes:
        """The entries, for each of the smallest cells that theirs are made of."""
        cell, rows = Halvings(self.cells, self.depth).spread(self.entries[:, 0])
        return np.concatenate([cell[:, None], self.entries[rows, 1:]], axis=1)
