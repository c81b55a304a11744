"""What is done with the nodes of blocks (`block_sweep.py`), in machine code and by threads."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.execution.codegen.scalar_llvm import scalars_text
from holdfast.execution.codegen.scalar_reader import read
from holdfast.execution.leaf import compiled_text
from holdfast.execution.level_set.blocks import Bits, Blocks, Flags
from holdfast.execution.level_set.sweep_code import address
from holdfast.execution.level_set.workers import Counts, Workers

Numbers = npt.NDArray[Any]

ENTRIES = ("fill", "look_over", "hand_down", "take_over", "losses")
"""Of which the last alone counts something."""

ALONE = 32768
"""Nodes for which other threads are not worth waking."""


class BlockCode:
    """Its functions, for a precision; threads share their work by the slices of `Workers`."""

    def __init__(self, precision: str) -> None:
        folder, files = resources.files(__package__), ("stencils", "block_sweep")
        known = read("\n".join((folder / f"{name}.py").read_text("utf-8") for name in files))
        text = scalars_text(known, ENTRIES, single=precision == "float32", fused=True)
        machine = compiled_text(text, optimised=True)
        self._functions = {
            name: machine.function(name, len(known.functions[name].parameters)) for name in ENTRIES
        }
        self._kind = np.dtype(precision)

    def function(self, name: str, sizes: Sequence[int]) -> Callable[..., None]:
        """One of them for blocks of so many nodes along each axis, as `Workers.run` calls it."""
        code, counts_too = self._functions[name], name == ENTRIES[-1]
        wholes, values = 8 * len(sizes) + 2, (2 ** (len(sizes) - 1) + 2) * (sizes[-1] + 2)

        def called(turn: Numbers, slices: Numbers, *given: Any) -> None:
            room, rows = np.zeros(wholes, dtype=np.int64), np.empty(values, dtype=self._kind)
            counted = [address(given[-1])] if counts_too else []
            code(
                address(turn), address(slices), len(slices) - 1, *given[:-1], *counted,
                address(room), address(rows),
            )  # fmt: skip

        return called


@cache
def block_code(precision: str) -> BlockCode:
    """The code for "float32" or "float64"."""
    return BlockCode(precision)


class BlockTasks:
    """The blocks of a grid, the threads that work on them, and what they do."""

    def __init__(self, blocks: Blocks, workers: Workers, precision: str) -> None:
        self._blocks, self._workers, self._code = blocks, workers, block_code(precision)
        self._of = np.array([*blocks.shape, *blocks.coarse, *blocks.sizes, *blocks.counts,
                             *blocks.periodic], dtype=np.int64)  # fmt: skip

    def _run(self, name: str, count: int, *given: Any) -> Counts:
        """Shared by the threads where there is much to do; count: of the blocks."""
        function = self._code.function(name, self._blocks.sizes)
        if count * math.prod(self._blocks.sizes) > ALONE:
            self._workers.share(0, count)
            return self._workers.run(function, *given)
        counts = np.zeros(3)
        function(np.zeros(1, dtype=np.int64), np.array([0, count]), *given, counts)
        return counts

    def _of_chosen(self, name: str, chosen: Flags, *given: Any) -> None:
        blocks = np.flatnonzero(chosen)
        if len(blocks):
            self._run(name, len(blocks), address(blocks), *self._shape, *given)

    @property
    def _shape(self) -> tuple[int, int]:
        return address(self._of), len(self._blocks.shape)

    def fill(
        self,
        chosen: Flags,
        targets: Sequence[Numbers],
        coarse: tuple[Numbers, Numbers],
        bounds: tuple[Numbers | None, Numbers | None],
    ) -> None:
        """The chosen blocks from the lesser of two values on the coarser grid, within bounds.

        It is linear along every axis, and at the nodes of the coarser grid that of this grid.
        bounds: upper and lower, at every node.
        """
        to = np.array([address(t) for t in targets], dtype=np.int64)
        limits = (0 if a is None else address(a) for a in bounds)
        self._of_chosen("fill", chosen, *map(address, coarse), address(to), len(to), *limits)

    def crossed(self, chosen: Flags, values: Numbers, coarse: Numbers, reach: int) -> Bits:
        """Where the sign of a value changes in every block, as `Blocks.near` reads it.

        In the chosen blocks the value is that of their grid, in others that of the coarser one.
        """
        found = np.zeros(chosen.shape, dtype=np.uint8)
        given = (address(chosen), address(values), address(coarse), reach, address(found))
        self._run("look_over", chosen.size, *self._shape, *given)
        return found

    def hand_down(self, chosen: Flags, values: Numbers, coarse: Numbers) -> None:
        """The values of the chosen blocks to the nodes of the coarser grid in them."""
        self._of_chosen("hand_down", chosen, address(values), address(coarse))

    def take_over(self, chosen: Flags, values: Numbers, out: Numbers) -> None:
        """The values of the chosen blocks to another array."""
        self._of_chosen("take_over", chosen, address(values), address(out))

    def loss(
        self, chosen: Flags, before: Numbers, now: Numbers, side: float, nearest: float
    ) -> float:
        """The largest share of its value that a node of the coarser grid changed by, of those on a
        side of zero (1 or -1) that are in no chosen block."""
        numbers = np.array([side, nearest])
        given = (address(chosen), address(before), address(now), address(numbers))
        return float(self._run("losses", chosen.size, *self._shape, *given)[2])
