"""A march whose grid is divided among parts, asked as one: `OneMarch` sees no cut.

A part is asked by a method of `MarchPart`. Sums, largest values and the first of places are the
same for any cut, so that the steps, and when the march ends, are those of one machine. What parts
answer is small, but for the edges that they hand one another, and the values that are asked for at
the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Protocol, TypeVar, TypeVarTuple

import numpy as np

from holdfast.analysis.reachability.checkpoint import Written
from holdfast.analysis.reachability.posed_march import (
    Facts,
    PosedMarch,
    StartFacts,
    check_start,
    hamiltonian_of,
    march_of,
    merged,
)
from holdfast.analysis.reachability.problem import Ends, Posed
from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.device_sweeping import DeviceSweeping
from holdfast.execution.level_set.march import Advances, Done
from holdfast.execution.level_set.refined_march import RefinedSweeping
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.slab import Edges, Layers, Part, Slab, check_cut, layers
from holdfast.execution.level_set.sweeping import (
    NOT_YET,
    StageAnswer,
    StageOrder,
    Sweeping,
    Within,
    joined,
)
from holdfast.execution.resources import Memory, Room
from holdfast.maths.games.hamiltonian import Hamiltonian

NODES_FETCHED_AT_ONCE = 1 << 23
"""Nodes whose values are fetched from a part at once."""

Asked = TypeVarTuple("Asked")
Answer = TypeVar("Answer")


class PartsLostError(Exception):
    """A part is gone, with what it has done since the last checkpoint. error: to be told where this
    happens again and again."""

    def __init__(self, error: HoldfastError) -> None:
        super().__init__(str(error))
        self.error = error


def layers_of(posed: Posed) -> Layers:
    """The layers that the grid of a problem can be cut at."""
    ghosts = schemes()[posed.marching.scheme].ghosts
    return layers(posed.grid.shape, ghosts, posed.grid.axes[0].ends)


def cut(posed: Posed, count: int) -> int:
    """How many parts there are, at most; refused where there cannot be more than one."""
    if count > 1:
        axis = posed.grid.axes[0]
        signs = posed.marching.symmetry or {}
        check_cut(layers_of(posed), axis.name, signs.get(axis.name) == -1)
    return count


class MarchPart(PosedMarch):
    """A part of a march. stages: from an exchange of halos to the next, where it has a halo."""

    def __init__(
        self, posed: Posed, part: Part, *, stages: int, threads: int, h: Hamiltonian | None = None
    ) -> None:
        super().__init__(posed, hamiltonian_of(posed) if h is None else h, part.planes, Memory())
        self._part, self._stages, self._threads = part, stages, threads

    def begin(self, facts: Facts, least: Array | None = None) -> Facts:
        """As `start_with`, with the march of the part. least: at all nodes of the grid, shape
        (nodes,), or that of the grid."""
        grid = self.posed.grid
        self.steps = march_of(self.posed, self._h, grid, planes=self.planes, threads=self._threads)
        return self.start_with(facts, self.steps, least)

    def fastest(self, times: Sequence[float]) -> tuple[Array, float]:
        """The largest speeds at these times t, shape (axes,), and the largest sum of them over the
        steps."""
        return self.steps.fastest(times)

    def open(self) -> None:
        """Make ready for the stages."""
        self.__enter__()

    def close(self, complete: bool = True) -> None:
        """End the stages; complete: between two steps, so that the values are those of a time."""
        self.__exit__(None if complete else Exception, None, None)

    def _swept(self) -> tuple[Sweeping | DeviceSweeping | RefinedSweeping, Advances]:
        if self.planes.whole:
            return super()._swept()
        upper, lower, moving = self._obstacles.upper, self._obstacles.lower, self._moving
        held = self._values, upper, lower, self._room, moving
        slab = Slab(self.steps, *held, self._part, self._stages)
        return slab, partial(self.steps.advances, slab, moving is not None)

    def carry_out(self, orders: Sequence[StageOrder]) -> list[StageAnswer]:
        """Stages that follow one another without an exchange of halos."""
        assert isinstance(self._sweeping, Sweeping)
        return [self._sweeping.stage(order) for order in orders]

    def edges(self, wanted: Sequence[int]) -> Edges:
        assert isinstance(self._sweeping, Slab)
        return self._sweeping.edges(wanted)

    def take(self, edges: Sequence[Edges]) -> None:
        assert isinstance(self._sweeping, Slab)
        self._sweeping.take(edges)

    def kinds(self) -> dict[str, str]:
        """The precision of each of what is held."""
        return {name: str(array.dtype) for name, array in self.held().items()}

    def piece(self, name: str, first: int, last: int) -> Array:
        """Some of the values of one of them, shape (last - first,)."""
        return self.held()[name][first:last]


class Parts(Protocol):
    """The parts of a march. stages: from an exchange of halos to the next."""

    parts: Sequence[Part]
    stages: int

    def ask(
        self, method: Callable[[MarchPart, *Asked], Answer], *arguments: *Asked
    ) -> list[Answer]:
        """What every part answers, in their order."""

    def ask_one(
        self, place: int, method: Callable[[MarchPart, *Asked], Answer], *arguments: *Asked
    ) -> Answer:
        """What one of them answers."""

    def carry_out(self, orders: Sequence[StageOrder]) -> list[list[StageAnswer]]:
        """Stages that follow one another, after every part has taken over the edges of the others
        that the stages before have left."""


class Workplace(Protocol):
    """Where the parts of a march are."""

    def parts(self, posed: Posed, h: Hamiltonian) -> AbstractContextManager[Parts]:
        """The parts of a march, until the end of the block."""


class DividedMarch:
    """As `PosedMarch`, from its parts. begin: values at all nodes of the grid, shape (nodes,), or
    that of the grid."""

    divided = True

    def __init__(
        self, posed: Posed, h: Hamiltonian, parts: Parts, begin: Array | None = None
    ) -> None:
        self._posed, self._parts = posed, parts
        facts = merged(parts.ask(MarchPart.facts))
        check_start(posed, facts)
        start = StartFacts(
            max(parts.ask(MarchPart.start_rate)) if posed.filtered else math.inf,
            np.max(parts.ask(MarchPart.falls, facts.highest), axis=0),
        )
        self.start = merged(parts.ask(MarchPart.begin, facts, begin))
        self.march = march_of(posed, h, posed.grid, fastest=self._fastest, start=start)
        self._waiting: list[StageOrder] = []

    def code(self) -> str:
        codes = set(self._parts.ask(MarchPart.code))
        if len(codes) > 1:
            raise SimulationError(
                "the parts of the march have been compiled from different sources",
                remedy="install the same version of holdfast for all workers",
            )
        return codes.pop()

    def _fastest(self, times: Sequence[float]) -> tuple[Array, float]:
        """The largest speeds along every axis at times t, shape (axes,), and the largest sum over
        the steps."""
        speeds, totals = zip(*self._parts.ask(MarchPart.fastest, times), strict=True)
        return np.max(speeds, axis=0), max(totals)

    def __enter__(self) -> DividedMarch:
        self._parts.ask(MarchPart.open)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if kind is None:  # else whoever has the parts lets go of them
            self._parts.ask(MarchPart.close)

    def advances(
        self, times: Sequence[float], within: Within, done: Done
    ) -> Iterator[float | None]:
        """As `Advances`."""
        moves = any(r.moves for r in self._posed.problem.regions)
        return self.march.advances(self, moves, times, within, done)

    def stage(self, order: StageOrder) -> StageAnswer:
        """Stages between which no halos are exchanged are carried out with the last of them."""
        self._waiting.append(order)
        last = order.s == self._posed.method.stages - 1
        if not last and self._parts.stages > len(self._waiting):
            return NOT_YET
        orders, self._waiting = self._waiting, []
        return joined(self._parts.carry_out(orders))

    def keep(self, time: float) -> None:
        """Take down the values of a time [s] marched."""
        self._parts.ask(MarchPart.keep, time)

    def largest(self) -> float:
        return max(self._parts.ask(MarchPart.largest))

    def highest(self) -> float:
        """Bound of all values so far."""
        return max(self._parts.ask(MarchPart.highest))

    def on_one_side(self, limit: str) -> bool:
        """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
        return all(self._parts.ask(MarchPart.on_one_side, limit))

    def ends(self) -> Ends:
        """The ends of the grid that the set touches."""
        return frozenset().union(*self._parts.ask(MarchPart.ends))

    def recorded(self) -> float:
        return self._parts.ask_one(0, MarchPart.recorded)

    def arrays(self, room: Room) -> dict[str, Array]:
        """The values and the records of all parts, each of shape (nodes,)."""
        kinds = self._parts.ask_one(0, MarchPart.kinds)
        nodes = self._posed.grid.nodes
        plane = nodes // self._posed.grid.axes[0].count
        whole = {name: room.empty(nodes, kind) for name, kind in kinds.items()}
        for k, part in enumerate(self._parts.parts):
            places = part.planes.own_nodes
            count = (places.stop - places.start) * plane  # planes follow one another in memory
            for name, array in whole.items():
                for first in range(0, count, NODES_FETCHED_AT_ONCE):
                    last = min(first + NODES_FETCHED_AT_ONCE, count)
                    piece = self._parts.ask_one(k, MarchPart.piece, name, first, last)
                    array[places.start * plane + first : places.start * plane + last] = piece
        return whole

    def write(self, generation: Path) -> list[Written]:
        return [one for of in self._parts.ask(MarchPart.write, generation) for one in of]

    def restore(self, path: Path, then: float) -> None:
        self._parts.ask(MarchPart.restore, path, then)
