"""A march whose grid is divided among parts, asked as one: `March.drive` and `marched` see no cut.

A part is asked by the name of a method of `MarchPart`. Sums, largest values and the first of places
are the same for any cut, so that the steps, and when the march ends, are those of one part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from holdfast.analysis.reachability.march_part import (
    Facts,
    MarchPart,
    check_start,
    layers_of,
    merged,
)
from holdfast.analysis.reachability.problem import Ends, Marching, Posed
from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.slab import Part, check_cut
from holdfast.execution.level_set.sweeping import StageOrder, joined
from holdfast.execution.resources import Disk, Memory, Room, available_cores
from holdfast.maths.games.hamiltonian import Hamiltonian

TOGETHER = 1 << 23
"""Nodes whose values are fetched from a part at once."""


class PartsLostError(Exception):
    """A part is gone, with what it has done since the last checkpoint. error: to be told where this
    happens again and again."""

    def __init__(self, error: HoldfastError) -> None:
        super().__init__(str(error))
        self.error = error


class Parts(Protocol):
    """The parts of a march. stages: from an exchange of halos to the next; here: whether they are
    in this process."""

    parts: Sequence[Part]
    stages: int
    here: bool

    def ask(self, method: str, *arguments: Any) -> list[Any]:
        """What every part answers to a method of `MarchPart`, in their order."""

    def ask_one(self, place: int, method: str, *arguments: Any) -> Any:
        """What one of them answers."""

    def exchange(self) -> None:
        """Have every part take over the edges of the others."""


class Workplace(Protocol):
    """Where the parts of a march are."""

    def parts(self, posed: Posed, h: Hamiltonian) -> AbstractContextManager[Parts]:
        """The parts of a march, until the end of the block."""


class Here:
    """This process: one part, or as many as wanted, one after another.

    by_step: whether halos are exchanged once in a step, and not in every stage.
    """

    def __init__(
        self, threads: int, room: Room | None = None, *, count: int = 1, by_step: bool = True
    ) -> None:
        self._threads, self._room = threads, room or Memory()
        self._count, self._by_step = count, by_step

    @contextmanager
    def parts(self, posed: Posed, h: Hamiltonian) -> Iterator[Parts]:
        most = cut(posed, self._count)
        stages = posed.method.stages if self._by_step else 1
        parts = layers_of(posed).parts(most, stages)
        local = PartsHere(
            [
                MarchPart(posed, part, stages=stages, threads=self._threads, room=self._room, h=h)
                for part in parts
            ],
            stages,
        )
        try:
            yield local
        except BaseException:
            local.ask("close", False)
            raise
        local.ask("close")


def room_of(marching: Marching) -> Room:
    """Where the arrays of a march are."""
    return Memory() if marching.on_disk is None else Disk(Path(marching.on_disk))


def workplace(marching: Marching) -> Workplace:
    """Where the parts of a march are."""
    if marching.cluster is not None:
        return marching.cluster
    return Here(marching.threads or available_cores(), room_of(marching))


def cut(posed: Posed, count: int) -> int:
    """How many parts there are, at most; refused where there cannot be more than one."""
    if count > 1:
        axis = posed.grid.axes[0]
        signs = posed.marching.symmetry or {}
        check_cut(layers_of(posed), axis.name, signs.get(axis.name) == -1)
    return count


class PartsHere:
    """Parts in this process."""

    here = True

    def __init__(self, held: Sequence[MarchPart], stages: int) -> None:
        self._held, self.stages = held, stages
        self.parts: Sequence[Part] = [p.part for p in held]
        self._wanted = [p.wanted(self.parts) for p in self.parts]

    def ask(self, method: str, *arguments: Any) -> list[Any]:
        return [getattr(p, method)(*arguments) for p in self._held]

    def ask_one(self, place: int, method: str, *arguments: Any) -> Any:
        return getattr(self._held[place], method)(*arguments)

    def exchange(self) -> None:
        for part, wanted in zip(self._held, self._wanted, strict=True):
            part.take([self._held[k].edges(which) for k, which in wanted])


class DividedMarch:
    """The stages of a march, and what there is to know of its values, from its parts."""

    def __init__(self, posed: Posed, parts: Parts, begin: Array | None = None) -> None:
        self._posed, self._parts = posed, parts
        facts = merged(parts.ask("facts"))
        check_start(posed, facts)
        self.start_rate = max(parts.ask("start_rate")) if posed.filtered else math.inf
        """The largest rate of change of the start value [its unit per second], for a filter."""
        self.falls = np.max(parts.ask("falls", facts.highest), axis=0)
        """Of `March`."""
        least = () if begin is None else (begin,)
        self.start: Facts = merged(parts.ask("begin", facts, *least))
        """What is known of the start value."""
        self._stages = posed.method.stages
        self._waiting: list[StageOrder] = []
        self._time: float | None = None
        self._again = False
        self._fixed = False
        self.complete: Callable[[], object] = lambda: None
        """To be called before the values are read between two steps."""

    def all_again(self) -> None:
        self._again = True

    def refresh(self, time: float) -> None:
        """Have the bounds at nodes be those of a time t from the next stage on."""
        self._time = time

    def bounds_moved(self) -> None:
        """They are said to the parts with the next stage."""

    def stage(self, s: int, u: Array, numbers: Array, measures: bool) -> Array:
        order = StageOrder(s, u, numbers, measures, self._time, self._again)
        self._waiting.append(order)
        self._again = False
        if s < self._stages - 1 and self._parts.stages > len(self._waiting):
            return np.zeros(3)
        answer = joined(self._parts.ask("carry_out", self._waiting))
        self._waiting = []
        self._first, self._fixed = answer.first, answer.fixed
        if len(self._parts.parts) > 1 and not answer.wrong:
            self._parts.exchange()
        return np.array([answer.computed, answer.wrong, answer.move])

    def not_finite(self) -> int:
        return self._first

    @property
    def fixed(self) -> bool:
        return self._fixed

    def code(self) -> str:
        """What the compiled march is called."""
        codes = set(self._parts.ask("code"))
        if len(codes) > 1:
            raise SimulationError(
                "the parts of the march have been compiled from different sources",
                remedy="install the same version of holdfast for all workers",
            )
        return str(codes.pop())

    def fastest(self, times: Sequence[float]) -> tuple[Array, float]:
        """The largest speeds along every axis at times t, and the largest sum over the steps."""
        speeds, totals = zip(*self._parts.ask("fastest", list(times)), strict=True)
        return np.max(speeds, axis=0), max(totals)

    def open(self) -> None:
        self._parts.ask("open")

    def close(self) -> None:
        self._parts.ask("close")

    def keep(self, time: float) -> None:
        """Take down the values of a time [s] marched."""
        self.complete()
        self._parts.ask("keep", time)

    def largest(self) -> float:
        self.complete()
        return max(self._parts.ask("largest"))

    @property
    def highest(self) -> float:
        """Bound of all values so far."""
        return max(self._parts.ask("highest"))

    def on_one_side(self, limit: str) -> bool:
        """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
        self.complete()
        return all(self._parts.ask("on_one_side", limit))

    def ends(self) -> Ends:
        """The ends of the grid that the set touches."""
        touched: Ends = frozenset().union(*self._parts.ask("ends"))
        return touched

    def recorded(self) -> float:
        """The time [s] up to which arrivals are recorded."""
        return float(self._parts.ask_one(0, "recorded"))

    @property
    def divided(self) -> bool:
        """Whether the values are in several parts, or not in this process."""
        return len(self._parts.parts) > 1 or not self._parts.here

    def whole(self) -> Mapping[str, Array] | None:
        """The arrays themselves, where one part has all; what a march that goes on overwrites."""
        if self.divided:
            return None
        arrays: Mapping[str, Array] = self._parts.ask_one(0, "held")
        return arrays

    def bounded(self) -> tuple[Array, Array | None, Array | None]:
        """The values of the only part, and what bounds them above and below."""
        arrays: tuple[Array, Array | None, Array | None] = self._parts.ask_one(0, "bounded")
        return arrays

    def arrays(self, room: Room | None = None) -> dict[str, Array]:
        """The values and the records over the grid, brought together part after part."""
        self.complete()
        if (held := self.whole()) is not None:
            return dict(held)
        kinds: dict[str, str] = self._parts.ask_one(0, "kinds")
        plane = self._posed.grid.nodes // self._posed.grid.axes[0].count
        nodes, place = self._posed.grid.nodes, room or Memory()
        whole = {name: place.empty(nodes, kind) for name, kind in kinds.items()}
        for k, part in enumerate(self._parts.parts):
            planes = part.own_nodes
            count = (planes.stop - planes.start) * plane
            for name, array in whole.items():
                for first in range(0, count, TOGETHER):
                    last = min(first + TOGETHER, count)
                    piece = self._parts.ask_one(k, "piece", name, first, last)
                    array[planes.start * plane + first : planes.start * plane + last] = piece
        return whole

    def each(self, method: str, *arguments: Any) -> list[Any]:
        """What every part answers."""
        return self._parts.ask(method, *arguments)
