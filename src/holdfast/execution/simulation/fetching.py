"""The look-up of a loop in a table of which only what is read is in memory.

The loop calls its parts through their addresses. Here that of the look-up is the address of a
function of Python, which fetches what the lanes will read, and then calls the look-up itself; so
the loop, and every bit that it computes, are the same as for a table in memory.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray
from holdfast.execution.simulation.layout import Layout
from holdfast.execution.table_in_parts import TableInParts

_PART = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64


@dataclass
class _Noted:
    """What was raised, and how many look-ups were done."""

    failure: BaseException | None = None
    done: int = 0


class Fetching:
    """The look-up of the loops of some blocks in `table`, over a grid.

    look_up: the address of the look-up of a table in memory. address: that of the one that fetches.
    """

    def __init__(
        self, table: TableInParts, grid: tuple[AnyArray, ...], layout: Layout, look_up: int
    ) -> None:
        self._noted = _Noted()
        # no method of this object, or the table would stay until a collection
        self._function = ctypes.CFUNCTYPE(None, *_PART)(
            _fetching(table, grid, layout, ctypes.PYFUNCTYPE(None, *_PART)(look_up), self._noted)
        )
        address = ctypes.c_void_p.from_buffer(self._function).value  # a cast would keep it
        assert address is not None
        self.address = address

    def in_place_of(self, addresses: npt.NDArray[np.int64], number: int) -> npt.NDArray[np.int64]:
        """The addresses of what a loop calls, with this one at the place `number`."""
        found = addresses.copy()
        found[number] = self.address
        return found

    def begin(self) -> None:
        """Before the loop is called, for as many look-ups as are told at `end`.

        What was raised in an earlier call that was interrupted before its end is forgotten.
        """
        self._noted.failure, self._noted.done = None, 0

    def end(self, look_ups: int = 0) -> None:
        """After the loop was called: raises what was raised in it.

        look_ups: at least so many have to be done since `begin`. An interruption of the main thread
        may come before the first line of the function that fetches: the loop goes on then without
        the look-up, and what Python raised is lost, so that it is raised here.
        """
        failure, self._noted.failure = self._noted.failure, None
        if failure is not None:
            raise failure
        if self._noted.done < look_ups:
            raise KeyboardInterrupt


def _fetching(
    table: TableInParts,
    grid: tuple[AnyArray, ...],
    layout: Layout,
    look_up: Callable[[int, int, int], None],
    noted: _Noted,
) -> Callable[[int, int, int], None]:
    """The function that the loop calls with the addresses of s and w, and the place of entries."""
    axes, width = layout.counts["look_at"], layout.width
    looked_at, alive = 8 * layout.at["look_at"], 8 * layout.at["alive"]
    rows, row = ctypes.c_double * (axes * width), ctypes.c_double * width

    def called(s: int, w: int, entries: int) -> None:
        if noted.failure is not None:
            return
        try:
            goes = np.ctypeslib.as_array(row.from_address(w + alive)) != 0.0
            places = np.ctypeslib.as_array(rows.from_address(w + looked_at)).reshape(axes, width)
            with table.using:
                table.fetch_looked_up(places.T[goes], grid)
                look_up(s, w, entries)
            noted.done += 1
        except BaseException as error:
            noted.failure = error

    return called
