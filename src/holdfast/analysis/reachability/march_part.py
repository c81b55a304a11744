"""A part of a march: the value in some layers of the grid, its obstacles, its records, its stages.

The whole grid is one part. Parts of a grid that is cut are in this process or in workers, which
may be on other machines; `divided_march.py` asks them. What they answer is small, but for the
edges that they hand one another, and the values that are asked for at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from holdfast.analysis.reachability.checkpoint_parts import (
    Written,
    read_parts,
    readable,
    write_part,
)
from holdfast.analysis.reachability.obstacles import Facts, Obstacles
from holdfast.analysis.reachability.posed_march import march_of, reflected, start_rate
from holdfast.analysis.reachability.problem import Ends, Posed, touched
from holdfast.analysis.reachability.snapshots import Record
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.device_sweeping import DeviceSweeping
from holdfast.execution.level_set.layers import Layers, Part, layers
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.slab import Edges, Slab
from holdfast.execution.level_set.stage_orders import StageAnswer, StageOrder, carried_out
from holdfast.execution.level_set.streaming import Streaming
from holdfast.execution.level_set.sweeping import Sweeping, on_one_side
from holdfast.execution.working_room import Room
from holdfast.maths.games.hamiltonian import Hamiltonian, hamiltonian


def layers_of(posed: Posed) -> Layers:
    """The layers that the grid of a problem can be cut at."""
    ghosts = schemes()[posed.marching.scheme].ghosts
    return layers(posed.grid.shape, ghosts, posed.grid.axes[0].ends)


def hamiltonian_of(posed: Posed) -> Hamiltonian:
    return hamiltonian(
        posed.system,
        inputs=posed.problem.inputs,
        disturbances=posed.problem.disturbances,
        samples=posed.marching.samples,
    )


class MarchPart:
    """stages: from an exchange of halos to the next, where the part has a halo."""

    def __init__(
        self,
        posed: Posed,
        part: Part,
        *,
        stages: int,
        threads: int,
        room: Room,
        h: Hamiltonian | None = None,
    ) -> None:
        self.posed, self.part, self._stages, self._threads = posed, part, stages, threads
        self._h = hamiltonian_of(posed) if h is None else h
        self._room = room
        kind = posed.marching.precision  # no method: the arrays would stay until a collection
        self._obstacles = Obstacles(posed, part, lambda count: room.empty(count, kind))
        self._sweeping: Sweeping | DeviceSweeping | None = None

    @property
    def _plane(self) -> int:
        """Nodes at a place of the first axis."""
        return len(self._obstacles.start) // len(self.part.nodes)

    def facts(self) -> Facts:
        """What is known of the start value in this part."""
        return self._obstacles.facts()

    def start_rate(self) -> float:
        """The largest rate of change of the start value [its unit per second] in this part."""
        return start_rate(self.posed, self._h, self.part, self._obstacles.start)

    def falls(self, highest: float) -> Array:
        """How the start value falls beyond the ends of this part, of `March`.

        highest: the highest start value, as far below zero as which it falls at most.
        """
        return self._obstacles.falls(highest)

    def begin(self, facts: Facts, least: Array | None = None) -> Facts:
        """The start value, from what is known of it over the grid.

        least: values that it begins with where they are less.
        """
        obstacles, posed = self._obstacles, self.posed
        found = obstacles.begin(facts)
        if least is not None:
            planes = least.reshape(posed.grid.axes[0].count, -1)[self.part.nodes]
            np.minimum(obstacles.start, planes.ravel(), out=obstacles.start)
            found = replace(found, deepest=obstacles.facts().deepest)
        mirror = reflected(posed, self.part)
        self.march = march_of(
            posed, self._h, posed.grid, part=self.part, threads=self._threads, reflected=mirror
        )
        self._values = obstacles.start
        self.record = Record(posed, self._mine(self._values), self._room)
        return found

    def code(self) -> str:
        """What the compiled march is called."""
        return self.march.name

    def fastest(self, times: Sequence[float]) -> tuple[Array, float]:
        """The largest speeds at these times t, and the largest sum of them over the steps."""
        return self.march.fastest(times)

    def open(self) -> None:
        """Make ready for the stages."""
        given = (self._values, self._obstacles.upper, self._obstacles.lower, self._room)
        if self.part.whole:
            self._sweeping = self.march.sweeping(*given)
        else:
            self._sweeping = Slab(self.march, *given, self.part, self._stages)
        self._sweeping.__enter__()

    def close(self, complete: bool = True) -> None:
        """End the stages; complete: between two steps, so that the values are those of a time."""
        sweeping, self._sweeping = self._sweeping, None
        if sweeping is not None:
            sweeping.__exit__(None if complete else Exception, None, None)

    def carry_out(self, orders: Sequence[StageOrder]) -> list[StageAnswer]:
        """Stages that follow one another without an exchange of halos."""
        found = self._sweeping
        assert found is not None
        if isinstance(found, Streaming) and found.streams:
            return found.step(orders, self._obstacles)
        return list(carried_out(found, orders, self._obstacles))

    def edges(self, wanted: Sequence[int]) -> Edges:
        assert isinstance(self._sweeping, Slab)
        return self._sweeping.edges(wanted)

    def take(self, found: Sequence[Edges]) -> None:
        assert isinstance(self._sweeping, Slab)
        self._sweeping.take(found)

    def now(self) -> Array:
        """The values at the part's own nodes, between two steps; they change with the next."""
        return self._mine(self._values if self._sweeping is None else self._sweeping.values())

    def _mine(self, values: Array) -> Array:
        own = self.part.own
        return values[own.start * self._plane : own.stop * self._plane]

    def keep(self, time: float) -> None:
        """Take down the values of a time [s] marched."""
        self.record.keep(time, self.now())

    def largest(self) -> float:
        if self._sweeping is not None:
            return self._sweeping.largest()
        return float(self.now().max())

    def highest(self) -> float:
        """Bound of all values of the part so far."""
        return self._obstacles.highest

    def on_one_side(self, limit: str) -> bool:
        if self._sweeping is not None:
            return self._sweeping.on_one_side(limit)
        return on_one_side(self.now(), limit)

    def ends(self) -> Ends:
        """The ends of the grid that the set touches."""
        values = self._values if self._sweeping is None else self._sweeping.values()
        return touched(values.reshape(self._obstacles.shape)[self.part.own], self.part.ends)

    def bounded(self) -> tuple[Array, Array | None, Array | None]:
        """The values that a march changes, and what bounds them above and below."""
        return self._values, self._obstacles.upper, self._obstacles.lower

    def held(self) -> dict[str, Array]:
        """All that the part's march depends on and has recorded, at its own nodes."""
        return {"values": self.now(), **self.record.arrays()}

    def kinds(self) -> dict[str, str]:
        """The precision of each of them."""
        return {name: str(array.dtype) for name, array in self.held().items()}

    def piece(self, name: str, first: int, last: int) -> Array:
        """Some of the values of one of them."""
        return self.held()[name][first:last]

    def recorded(self) -> float:
        """The time [s] up to which arrivals are recorded."""
        return self.record.then

    def write(self, generation: Path) -> Written:
        """Write what is held into the folder of a generation of a checkpoint."""
        return write_part(generation, self.part.own_nodes.start, self.held())

    def restore(self, path: Path, then: float) -> None:
        """Go on from the checkpoint at a path, which was recorded up to the time `then` [s]."""
        plane, own = self._plane, self.part.own_nodes
        with readable(path, "" if self.part.whole else "a checkpoint that all machines share"):
            known = read_parts(path, plane)
            values = known("values")
            if values is None:
                raise KeyError("values")
            for j, k in enumerate(self.part.nodes.tolist()):
                self._values[j * plane : (j + 1) * plane] = values[k * plane : (k + 1) * plane]
            self.record.restore(known, slice(own.start * plane, own.stop * plane), then)
        if self.posed.varies:  # what it has come to by now, when it may have been larger than now
            largest = float(self._mine(self._values).max())
            self._obstacles.highest = max(self._obstacles.highest, largest)
