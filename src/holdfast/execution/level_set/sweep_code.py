"""The machine code of sweeps, and the memory that they need."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.execution.codegen.scalar_llvm import scalars_text
from holdfast.execution.codegen.scalar_reader import read
from holdfast.execution.leaf import compiled_text

Numbers = npt.NDArray[Any]

Room = tuple[int, int, int]

LINE = 64
"""Bytes of a line of the processor's cache."""


class SweepCode:
    """Its functions take addresses and whole numbers, and let other threads of Python run."""

    def __init__(self, precision: str, *, one_slope: bool) -> None:
        files = ("stencils", f"slopes_{'once' if one_slope else 'twice'}", "sweep")
        folder = resources.files(__package__)
        source = "\n".join((folder / f"{name}.py").read_text("utf-8") for name in files)
        known, entries = read(source), ("sweep", "mirror", "watch")
        text = scalars_text(known, entries, single=precision == "float32", fused=True)
        self._machine = compiled_text(text, optimised=True)
        self.name = "sweep_" + hashlib.sha256(text.encode()).hexdigest()[:24]
        self.constants = {name: int(value) for name, value in known.constants.items()}
        self.kind = np.dtype(precision)
        self.one_slope = one_slope
        self._sweep, self._mirror, self._watch = (
            self._machine.function(name, len(known.functions[name].parameters)) for name in entries
        )
        self.turns = self.constants["MOST_SLICES"]
        self._held = threading.local()

    def room(self, shape: Sequence[int], cut: Sequence[int], sizes: Sequence[int]) -> Room:
        """How many numbers a sweep needs: whole ones, of double precision, of values."""
        of, n, nodes = self.constants, len(shape), shape[-1]
        local, stretches = cut[1] * cut[2], cut[2]
        (along, of_row, outer), plain = sizes[:3], sizes[5]
        wholes, held = of["SLOPES"] + 2 * of["WORDS"] + 9 * n + 10, 2 * n * of["PITCH"]
        if not self.one_slope:
            held = (2 + 2 * plain) * of["ENDS"] * n + of["GATHERED"] + of["VECTOR"]
            units, stride = local, shape[-1] * (shape[-2] if n > 1 else 1)
            for i in range(n - 3, -1, -1):
                if stride <= of["KEPT"]:
                    held, wholes = held + (1 + plain) * stride, wholes + units
                units, stride = units * shape[i], stride * shape[i]
        held += (stretches * along + of_row + of["ARRAYS"] + 1) * of["PITCH"]
        reals = (n + of_row + outer) * of["PITCH"] + outer + (1 + along) * (nodes + of["VECTOR"])
        return wholes, reals, held

    def sweep(
        self, turn: Numbers, slices: Numbers, room: Room, given: Sequence[int], counts: Numbers
    ) -> None:
        """A stage of a step, with memory of its own. given: the arguments from `u` on."""
        self._sweep(*_shared(turn, slices), address(counts), *self._memory(room), *given)

    def _memory(self, room: Room) -> tuple[int, int, int]:
        """Its addresses, of this thread: that of the last sweep if it was as large."""
        if getattr(self._held, "room", None) != room:
            wholes, reals = np.zeros(room[0], dtype=np.int64), np.zeros(room[1])
            values = np.zeros(room[2] + LINE // self.kind.itemsize, dtype=self.kind)
            self._held.room, self._held.arrays = room, (wholes, reals, values)
            aligned = -(-address(values) // LINE) * LINE
            self._held.places = (address(wholes), address(reals), aligned)
        places: tuple[int, int, int] = self._held.places
        return places

    def mirror(
        self, turn: Numbers, slices: Numbers, values: Numbers, shape: Numbers, places: Numbers,
        axis: int, chosen: Numbers, counts: Numbers,
    ) -> None:  # fmt: skip
        """Values at the chosen places along an axis, from the nodes that they reflect."""
        self._mirror(
            *_shared(turn, slices), address(values), len(values), address(shape), len(shape),
            address(places), places.shape[1], axis, address(chosen), len(chosen),
        )  # fmt: skip

    def watch(self, own: Numbers, other: Numbers, value: int, times: int) -> None:
        """Counts its own start, and waits until the other reaches the value."""
        self._watch(address(own), address(other), value, times)


@cache
def sweep_code(precision: str, *, one_slope: bool) -> SweepCode:
    """The code for a precision, and for schemes with one or two slopes of every interval."""
    return SweepCode(precision, one_slope=one_slope)


def address(array: Numbers) -> int:
    return int(array.ctypes.data)


def _shared(turn: Numbers, slices: Numbers) -> tuple[int, int, int]:
    return address(turn), address(slices), len(slices) - 1
