"""The look-up of a loop in a table of which only what is read is in memory.

The loop calls its parts through their addresses. Here that of the look-up is the address of a
function of Python, which fetches what the lanes will read, and then calls the look-up itself; so
the loop, and every bit that it computes, are the same as for a table in memory.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray, Array
from holdfast.execution.simulation.layout import Layout
from holdfast.execution.table_in_parts import TableInParts

_PART = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64


class Fetching:
    """The look-up of the loops of some blocks in `table`, over a grid.

    look_up: the address of the look-up of a table in memory. address: that of the one that fetches.
    """

    def __init__(
        self, table: TableInParts, grid: tuple[AnyArray, ...], layout: Layout, look_up: int
    ) -> None:
        self._failures: list[BaseException] = []
        # no method of this object, or the table would stay until a collection
        self._function = ctypes.CFUNCTYPE(None, *_PART)(
            _fetching(table, grid, layout, ctypes.PYFUNCTYPE(None, *_PART)(look_up), self._failures)
        )
        address = ctypes.c_void_p.from_buffer(self._function).value  # a cast would keep it
        assert address is not None
        self.address = address

    def in_place_of(self, addresses: npt.NDArray[np.int64], number: int) -> npt.NDArray[np.int64]:
        """The addresses of what a loop calls, with this one at the place `number`."""
        found = addresses.copy()
        found[number] = self.address
        return found

    def begin(self, looked_up: Array, alive: Array) -> None:
        """Before the loop is called: what is not looked up in these rows is not a number.

        An interruption of the main thread may come before the first line of the function of Python,
        and is lost.
        """
        np.copyto(looked_up, np.nan, where=alive != 0.0)

    def end(self) -> None:
        """After the loop was called: raises what was raised in it."""
        if self._failures:
            failure = self._failures[0]
            self._failures.clear()
            raise failure


def _fetching(
    table: TableInParts,
    grid: tuple[AnyArray, ...],
    layout: Layout,
    look_up: Callable[[int, int, int], None],
    failures: list[BaseException],
) -> Callable[[int, int, int], None]:
    """The function that the loop calls with the addresses of s and w, and the place of entries."""
    axes, width = layout.counts["look_at"], layout.width
    looked_at, alive = 8 * layout.at["look_at"], 8 * layout.at["alive"]
    rows, row = ctypes.c_double * (axes * width), ctypes.c_double * width

    def called(s: int, w: int, entries: int) -> None:
        if failures:
            return
        try:
            goes = np.ctypeslib.as_array(row.from_address(w + alive)) != 0.0
            places = np.ctypeslib.as_array(rows.from_address(w + looked_at)).reshape(axes, width)
            with table.using:
                table.fetch_looked_up(places.T[goes], grid)
                look_up(s, w, entries)
        except BaseException as error:
            failures.append(error)

    return called
