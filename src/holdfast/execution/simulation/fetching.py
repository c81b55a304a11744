"""The look-up of a loop in a table of which only what is read is in memory.

The loop calls its parts through their addresses. Here that of the look-up is the address of a
function of Python, which fetches what the lanes will read, and then calls the look-up itself; so
the loop, and every bit that it computes, are the same as for a table in memory.
"""

from __future__ import annotations

import ctypes

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray
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
        self.table, self._grid = table, grid
        axes, width = layout.counts["look_at"], layout.width
        self._look_at = 8 * layout.at["look_at"], ctypes.c_double * (axes * width), (axes, width)
        self._alive = 8 * layout.at["alive"], ctypes.c_double * width
        self._look_up = ctypes.PYFUNCTYPE(None, *_PART)(look_up)
        self._function = ctypes.CFUNCTYPE(None, *_PART)(self._called)
        address = ctypes.cast(self._function, ctypes.c_void_p).value
        assert address is not None
        self.address = address
        self._failure: BaseException | None = None
        self._done = 0

    def in_place_of(self, addresses: npt.NDArray[np.int64], number: int) -> npt.NDArray[np.int64]:
        """The addresses of what a loop calls, with this one at the place `number`."""
        found = addresses.copy()
        found[number] = self.address
        return found

    def begin(self) -> None:
        """Before the loop is called in the main thread, for as many look-ups as are told at `end`.

        What was raised in an earlier call that was interrupted before its end is forgotten.
        """
        self._failure, self._done = None, 0

    def end(self, look_ups: int = 0) -> None:
        """After the loop was called: raises what was raised in it.

        look_ups: at least so many have to be done since `begin`. An interruption of the main
        thread may come before the first line of `_called`: the loop goes on then without the
        look-up, and what Python raised is lost, so that it is raised here.
        """
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        if self._done < look_ups:
            raise KeyboardInterrupt

    def _called(self, s: int, w: int, entries: int) -> None:
        if self._failure is not None:
            return
        try:
            place, row = self._alive
            alive = np.ctypeslib.as_array(row.from_address(w + place)) != 0.0
            place, rows, shape = self._look_at
            looked_at = np.ctypeslib.as_array(rows.from_address(w + place)).reshape(shape)
            with self.table.using:
                self.table.fetch_looked_up(looked_at.T[alive], self._grid)
                self._look_up(s, w, entries)
            self._done += 1
        except BaseException as error:
            self._failure = error
