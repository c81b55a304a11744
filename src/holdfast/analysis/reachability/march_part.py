"""A part of a march: the value in some layers of the grid, its obstacles, its records, its stages.

The whole grid is one part. Parts of a grid that is cut are in this process or in workers, which
may be on other machines; `divided_march.py` asks them. What they answer is small, but for the
edges that they hand one another, and the values that are asked for at the end.

Initial values, and the obstacles below and above the value:

    a region to be kept      W <= l_K                   start l_K
    one to be reached        l_T <= W                   start l_T
    reached within another   l_G <= W, then W <= l_K    start the lesser

If the sign of dW/dtau is restricted, one of them holds automatically. With d the distance to the
open ends of the grid, leaving the grid counts as lost with W <= d, and as won with l_K or -d <= W.

Every part writes a checkpoint for itself, into a folder that all of them see:

    said.json               the problem, what has been done, which generation holds and its parts
    3fa9.../120-values.npy  a generation: the values of the part from place 120 of the first axis

A new generation is written beside the old one, which is removed when `said.json` names the new. So
whenever a process ends, one of them is complete. No two have the same name: a part that was given
up, and still writes, does not write into one that holds. A march cut otherwise reads it too.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import secrets
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.posed_march import march_of, reflected, start_rate
from holdfast.analysis.reachability.problem import ON_END, Ends, Posed, check_inside, touched
from holdfast.errors import OutputError, SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.level_set.device_sweeping import DeviceSweeping
from holdfast.execution.level_set.march import ALL, over_grid
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.slab import Edges, Layers, Part, Slab, layers
from holdfast.execution.level_set.sweeping import (
    StageAnswer,
    StageOrder,
    Streaming,
    Sweeping,
    carried_out,
    on_one_side,
)
from holdfast.execution.resources import Room
from holdfast.host.files import atomic_file, discarded_at_the_end, kept_at_the_end
from holdfast.maths.games.hamiltonian import Hamiltonian, hamiltonian


@dataclass(frozen=True)
class Facts:
    """What is known of the start value. nan: whether it is somewhere; inside: whether a node is in
    the set; ends: the ends of the grid that the set touches; cell: the largest change from node to
    node; highest: the largest value; deepest: the largest magnitude."""

    nan: bool
    inside: bool
    ends: Ends
    cell: float
    highest: float
    deepest: float


NOTHING = Facts(False, True, frozenset(), 0.0, -math.inf, 0.0)
"""Facts of a start value at no node; that a node is in the set has been found before."""

WIDER = 1.0 / 15.0
"""Share of an axis for which the margin is taken to fall beyond its ends. With a few cells in its
place finer grids would keep too much where constraints meet; without end all would too little."""

NODES_RENEWED_AT_ONCE = 1 << 20
"""Nodes at which moving bounds are renewed together."""


def merged(parts: Sequence[Facts]) -> Facts:
    """Of the whole grid, from those of its parts."""
    return Facts(
        any(f.nan for f in parts),
        any(f.inside for f in parts),
        frozenset().union(*(f.ends for f in parts)),
        max(f.cell for f in parts),
        max(f.highest for f in parts),
        max(f.deepest for f in parts),
    )


def check_start(posed: Posed, facts: Facts) -> None:
    """Refuse a start value that no march can begin with."""
    if facts.nan:
        raise SimulationError(
            "the constraints of a region are NaN at some nodes of the grid",
            remedy="take an interval on which its inequalities are defined",
        )
    check_inside(posed, facts.ends)
    if not facts.inside:
        raise SimulationError(
            f"no node of the grid is in region '{posed.problem.start.name}'",
            remedy="take a finer grid",
        )


class Obstacles:
    """start, lower, upper: values at every node of a part of the grid, flat, at the beginning of
    the march; if they depend on time, `refresh` writes those of a time into lower and upper.

    highest: bound of all values of the part, without its halo. room: an array of so many values.
    """

    def __init__(self, posed: Posed, part: Part, room: Callable[[int], Array]) -> None:
        grid = posed.grid
        self.posed, self.part, self._empty = posed, part, room
        self.room: Array | None = None
        axes = [grid.axes[0].nodes[part.nodes], *(a.nodes for a in grid.axes[1:])]
        self.shape = tuple(len(a) for a in axes)
        self.margins = [
            over_grid(
                region.margin,
                [a.state.symbol for a in grid.axes],
                posed.parameters,
                axes,
                band=posed.marching.band,
                precision=posed.marching.precision,
                room=room,
            )
            for region in posed.problem.regions
        ]
        self._begin_at(posed.clock[0])

    def facts(self) -> Facts:
        start = self.start.reshape(self.shape)
        planes = self.part.own
        mine = start[planes]
        before = planes.start - (self.part.first > 0)  # the change from the part before it, too
        return Facts(
            bool(np.isnan(mine.min())),
            any((plane > 0).any() for plane in mine),
            touched(mine, self.part.ends),
            largest_change(start[before : planes.stop]),
            float(mine.max()),
            float(max(mine.max(), -mine.min())),
        )

    def begin(self, facts: Facts) -> Facts:
        """Where leaving the grid counts, as for the whole grid: what is known of the new start."""
        posed = self.posed
        if posed.beyond:
            self.room = self._room_inside(open_ends(posed, facts.ends), facts.cell)
            self._begin_at(posed.clock[0])
            facts = replace(self.facts(), cell=facts.cell)
        self.highest = facts.highest
        return facts

    def falls(self, highest: float) -> Array:
        """How steeply the margin falls beyond the lower and the upper end of every axis, at most
        [its unit per unit of the state], over nodes that are lost, and down to what.

        So the value falls beyond an end (`stencils.py`) as on a grid that is wider by `WIDER`.
        highest: of `MarchPart.falls`.
        """
        posed, values = self.posed, self.start.reshape(self.shape)
        ends = np.tile((0.0, 0.0, -math.inf, -math.inf), (len(self.shape), 1))
        if posed.problem.limit != "shrink":
            return ends
        symbols = [a.state.symbol for a in posed.grid.axes]
        axes = [posed.grid.axes[0].nodes[self.part.nodes], *(a.nodes for a in posed.grid.axes[1:])]
        for (i, axis), side in itertools.product(enumerate(posed.grid.axes), (0, 1)):
            if axis.ends != "contained" or (i == 0 and not self.part.ends[side]):
                continue
            place = (self.part.own.start, self.part.own.stop - 1)[side] if i == 0 else -side
            edge = np.take(values, place, axis=i)
            further = (axis.low - axis.step, axis.high + axis.step)[side]
            beyond = over_grid(
                posed.problem.regions[0].margin, symbols, posed.parameters,
                [np.array([further]) if k == i else nodes for k, nodes in enumerate(axes)],
                band=posed.marching.band,
            )(posed.clock[0]).reshape(edge.shape)  # fmt: skip
            fall = edge - np.maximum(beyond, -highest)  # of NaN no node is lost
            lost = edge <= ON_END * fall
            steepest = np.max(fall, initial=0.0, where=lost) / axis.step
            depth = WIDER * (axis.high - axis.low) * steepest
            lowest = np.max(edge, initial=-math.inf, where=lost) - depth
            ends[i, [side, 2 + side]] = steepest, lowest
        return ends

    def refresh(self, time: float) -> None:
        planes = self.shape[0]
        block = max(1, NODES_RENEWED_AT_ONCE * planes // len(self.start))
        self.check([self.renew(time, k, min(k + block, planes)) for k in range(0, planes, block)])

    def renew(self, time: float, first: int, last: int) -> Facts:
        """Bounds of a time at some places of the first axis; what is known of the start there."""
        plane = len(self.start) // self.shape[0]
        nodes = slice(first * plane, last * plane)
        start, lower, upper = self._at(time, nodes)
        for bound, new in ((self.lower, lower), (self.upper, upper)):
            if bound is not None and new is not None:
                bound[nodes] = new
        planes = self.part.own
        low, high = max(planes.start, first), min(planes.stop, last)
        if low >= high:
            return NOTHING
        mine = start.reshape(last - first, *self.shape[1:])[low - first : high - first]
        at_first, at_last = self.part.ends
        ends = touched(mine, (at_first and low == planes.start, at_last and high == planes.stop))
        return replace(
            NOTHING, nan=bool(np.isnan(mine.min())), ends=ends, highest=float(mine.max())
        )

    def check(self, parts: Sequence[Facts]) -> None:
        """Refuse bounds, renewed at all places, of a start that no march can go on with."""
        facts = merged(parts)
        check_start(self.posed, facts)
        self.highest = max(self.highest, facts.highest)

    def _begin_at(self, time: float) -> None:
        start, self.lower, self.upper = self._at(time)
        self.start = start
        if start is self.lower or start is self.upper:  # the march overwrites it in place
            self.start = self._empty(len(start))
            self.start[:] = start

    def _at(self, time: float, of: slice = ALL) -> tuple[Array, Array | None, Array | None]:
        """The initial value and the obstacles at a time, at all nodes or at some."""
        posed, room = self.posed, None if self.room is None else self.room[of]
        first, *others = (margin(time, of) for margin in self.margins)
        shrinks = posed.problem.limit == "shrink"
        lower = None if shrinks else first
        upper: Array | None = first if shrinks else (others[0] if others else None)
        if posed.beyond == "lost" and room is not None:
            upper = room if upper is None else np.minimum(upper, room, out=self._empty(len(room)))
        elif posed.beyond == "won" and room is not None:
            lower = np.negative(room, out=self._empty(len(room)))
            (np.minimum if shrinks else np.maximum)(first, lower, out=lower)
        start = upper if shrinks or lower is None else lower
        assert start is not None
        if upper is not None and upper is not start:
            start = np.minimum(start, upper, out=self._empty(len(start)) if of is ALL else None)
        lower = None if posed.limit == "grow" or posed.problem.limit == "exact" else lower
        upper = None if posed.limit == "shrink" else upper
        return start, lower, upper

    def _room_inside(self, ends: Sequence[tuple[int, int]], cell: float) -> Array:
        """The distance to the nearest open end, less half a cell, as steep as the start value."""
        shape, band = self.posed.grid.shape, self.posed.marching.band
        kind = self.start.dtype
        room = self._empty(len(self.start)).reshape(self.shape)
        room[:] = min(band, float(max(shape)) * cell)
        for i, end in ends:
            places = np.arange(shape[i], dtype=kind)
            places = places if end == 0 else places[::-1]
            places = places[self.part.nodes] if i == 0 else places
            line = np.maximum((places - 0.5) * cell, -band).astype(kind)
            rows = line.reshape([-1 if k == i else 1 for k in range(len(shape))])
            np.minimum(room, rows, out=room)
        return room.ravel()


def open_ends(posed: Posed, reached: Ends) -> list[tuple[int, int]]:
    """The ends of the grid beyond which the value is extrapolated: the axis, and 0 or -1.

    If the set only shrinks, ends that it does not reach initially are left out.
    """
    return [
        (i, end)
        for i, axis in enumerate(posed.grid.axes)
        if axis.ends in ("contained", "extrapolated")
        for end in (0, -1)
        if posed.limit != "shrink" or (i, end) in reached
    ]


def largest_change(values: Array) -> float:
    """The largest difference between neighbours, at the nodes in the set or next to it."""

    def largest(ahead: Array, behind: Array) -> float:
        near = (ahead > 0) | (behind > 0)
        return float(np.abs(ahead - behind)[near].max(initial=0.0))

    change = 0.0
    for k, slab in enumerate(values):  # slab by slab, to save memory
        if k:
            change = max(change, largest(slab, values[k - 1]))
        for i in range(slab.ndim):
            rows = np.moveaxis(slab, i, 0)
            change = max(change, largest(rows[1:], rows[:-1]))
    return change


NODES_LOOKED_AT_AT_ONCE = 1 << 20
"""Nodes that are looked at together, to save memory."""


class Record:
    """Filled at every one of `stops` [s]; `arrays` and `restore` carry it over an interruption."""

    def __init__(self, posed: Posed, first: Array, room: Room) -> None:
        self.posed, self._room = posed, room
        self.found: dict[float, Array] = {}
        self.arrival: Array | None = None
        self.then = 0.0
        if posed.arrival_steps:
            self.arrival = room.empty(len(first), np.float64)
            for part in _parts(len(first)):
                self.arrival[part] = np.where(first[part] > 0, 0.0, math.nan)
            self.before = room.copy(first)
        self.keep(0.0, first)

    def keep(self, time: float, values: Array) -> None:
        if self.posed.several and time in self.posed.asked:
            self.found[time] = self._room.copy(values)
        if self.arrival is not None and time > self.then:
            for part in _parts(len(values)):
                now, was, arrival = values[part], self.before[part], self.arrival[part]
                new = (now > 0) & np.isnan(arrival)
                share = -was[new] / (now[new] - was[new])
                arrival[new] = self.then + share * (time - self.then)
            self.before[:] = values
            self.then = time

    def arrays(self) -> dict[str, Array]:
        """All that is kept so far."""
        records: dict[str, Array] = {named(t): v for t, v in self.found.items()}
        if self.arrival is not None:
            records |= {"arrival": self.arrival, "before": self.before}
        return records

    def restore(self, saved: Callable[[str], Any | None], nodes: slice, then: float) -> None:
        """saved: what was kept, over the grid, by name; nodes: those of this record."""
        for time in self.posed.asked:
            if (values := saved(named(time))) is not None:
                count, kind = nodes.stop - nodes.start, self.posed.marching.precision
                self.found[time] = self._room.empty(count, kind)
                _fill(self.found[time], values, nodes)
        if self.arrival is not None:
            for name, array in (("arrival", self.arrival), ("before", self.before)):
                values = saved(name)
                assert values is not None
                _fill(array, values, nodes)
            self.then = then


def stops(posed: Posed) -> list[float]:
    """The times [s] at which a march is recorded."""
    if not posed.arrival_steps:
        return sorted(posed.asked)
    steps = np.linspace(0, posed.horizon, posed.arrival_steps + 1)[1:]
    close = 1e-9 * posed.horizon  # the same time but for rounding
    new = [float(t) for t in steps if min(abs(t - s) for s in posed.asked) > close]
    return sorted([*posed.asked, *new])


def named(time: float) -> str:
    """What the values of a time are called among the arrays of a record."""
    return f"at_{time!r}"


def _fill(array: Array, values: Any, nodes: slice) -> None:
    """With these of the values, some at a time."""
    for part in _parts(len(array)):
        stop = min(nodes.start + part.stop, nodes.stop)
        array[part] = values[nodes.start + part.start : stop]


def _parts(count: int) -> list[slice]:
    return [slice(k, k + NODES_LOOKED_AT_AT_ONCE) for k in range(0, count, NODES_LOOKED_AT_AT_ONCE)]


Values = npt.NDArray[Any]

SAID = "said.json"
_GENERATION = re.compile(r"[0-9a-f]{16}")

Written = tuple[int, list[str]]
"""What a part has written: the place of the first axis that it begins at, and names of arrays."""


class PartFiles:
    """The folder of the checkpoint of a march."""

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()  # whoever reads and writes there may be in another folder

    def said(self) -> dict[str, Any] | None:
        """What it says of itself; None where no generation is complete."""
        if not (self.path / SAID).exists():
            return None
        said: dict[str, Any] = json.loads((self.path / SAID).read_text("utf-8"))
        return said

    def begin(self) -> Path:
        """A folder for a new generation; it is made where the parent of `path` exists."""
        new = self.path / secrets.token_hex(8)
        try:
            self.path.mkdir(exist_ok=True)
            discarded_at_the_end(new).mkdir()
        except OSError as error:
            raise OutputError(f"{self.path} cannot be written ({error.strerror})") from None
        return new

    def finish(self, said: Mapping[str, Any], new: Path, written: Sequence[Written]) -> None:
        """All parts have written this generation: it holds from now on."""
        names = sorted({name for _, arrays in written for name in arrays})
        contents = {
            "generation": new.name,
            "parts": [first for first, _ in written],
            "arrays": names,
        }
        kept_at_the_end(new)  # before it holds: an interruption may come at any time
        with atomic_file(self.path / SAID) as partial:
            partial.write_text(json.dumps({**said, **contents}), "utf-8")
        for other in self.path.iterdir():
            if _GENERATION.fullmatch(other.name) and other != new:
                self.remove(other)

    def remove(self, generation: Path) -> None:
        """Remove a generation that does not hold."""
        shutil.rmtree(generation, ignore_errors=True)
        kept_at_the_end(generation)


def write_part(generation: Path, first: int, arrays: Mapping[str, Values]) -> Written:
    """Write the arrays of a part whose own nodes begin at place `first` of the first axis."""
    for name, values in arrays.items():
        path = _file(generation, first, name)
        try:
            with path.open("wb") as file:
                np.save(file, np.asarray(values))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(f"{path} cannot be written ({error.strerror or error})") from None
    return first, list(arrays)


@contextmanager
def readable(path: Path, expected: str = "") -> Iterator[None]:
    """Refuse what is at a path where it cannot be read as a checkpoint."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        raise SimulationError(
            f"{path} cannot be read as a checkpoint",
            expected=expected,
            remedy="remove it to begin anew, or choose another file",
        ) from None


def read_parts(path: Path, plane: int) -> Callable[[str], Any | None]:
    """The arrays of a checkpoint by name, over the whole grid, of which slices are read.

    plane: the number of nodes at a place of the first axis.
    """
    if path.is_file():
        arrays = np.load(path, allow_pickle=False)
        return lambda name: arrays.get(name)
    said = json.loads((path / SAID).read_text("utf-8"))
    folder = path / said["generation"]

    def array_of(name: str) -> _Joined | None:
        if name not in said["arrays"]:
            return None
        files = {first * plane: _file(folder, first, name) for first in said["parts"]}
        return _Joined({k: np.load(f, mmap_mode="r", allow_pickle=False) for k, f in files.items()})

    return array_of


class _Joined:
    """Arrays by their first place, of which slices are taken as if they were one."""

    def __init__(self, arrays: Mapping[int, Values]) -> None:
        self._arrays = arrays

    def __getitem__(self, wanted: slice) -> Values:
        pieces = []
        for begin, array in sorted(self._arrays.items()):
            first, last = max(wanted.start - begin, 0), min(wanted.stop - begin, len(array))
            if first < last:
                pieces.append(array[first:last])
        if sum(map(len, pieces)) != wanted.stop - wanted.start:
            raise ValueError("some of the values are missing")
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)


def _file(generation: Path, first: int, name: str) -> Path:
    return generation / f"{first}-{name}.npy"


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
        of_part = obstacles.begin(facts)
        if least is not None:
            planes = least.reshape(posed.grid.axes[0].count, -1)[self.part.nodes]
            np.minimum(obstacles.start, planes.ravel(), out=obstacles.start)
            of_part = replace(of_part, deepest=obstacles.facts().deepest)
        mirror = reflected(posed, self.part)
        self.march = march_of(
            posed, self._h, posed.grid, part=self.part, threads=self._threads, reflected=mirror
        )
        self._values = obstacles.start
        self.record = Record(posed, self._mine(self._values), self._room)
        return of_part

    def code(self) -> str:
        """What the compiled march is called."""
        return self.march.name

    def fastest(self, times: Sequence[float]) -> tuple[Array, float]:
        """The largest speeds at these times t, and the largest sum of them over the steps."""
        return self.march.fastest(times)

    def open(self) -> None:
        """Make ready for the stages."""
        arrays = (self._values, self._obstacles.upper, self._obstacles.lower, self._room)
        if self.part.whole:
            self._sweeping = self.march.sweeping(*arrays)
        else:
            self._sweeping = Slab(self.march, *arrays, self.part, self._stages)
        self._sweeping.__enter__()

    def close(self, complete: bool = True) -> None:
        """End the stages; complete: between two steps, so that the values are those of a time."""
        sweeping, self._sweeping = self._sweeping, None
        if sweeping is not None:
            sweeping.__exit__(None if complete else Exception, None, None)

    def carry_out(self, orders: Sequence[StageOrder]) -> list[StageAnswer]:
        """Stages that follow one another without an exchange of halos."""
        sweeping = self._sweeping
        assert sweeping is not None
        if isinstance(sweeping, Streaming) and sweeping.streams:
            return sweeping.step(orders, self._obstacles)
        return list(carried_out(sweeping, orders, self._obstacles))

    def edges(self, wanted: Sequence[int]) -> Edges:
        assert isinstance(self._sweeping, Slab)
        return self._sweeping.edges(wanted)

    def take(self, edges: Sequence[Edges]) -> None:
        assert isinstance(self._sweeping, Slab)
        self._sweeping.take(edges)

    def now(self) -> Array:
        """The values at the part's own nodes, between two steps; they change with the next."""
        return self._mine(self._values if self._sweeping is None else self._sweeping.values())

    def _mine(self, values: Array) -> Array:
        planes = self.part.own
        return values[planes.start * self._plane : planes.stop * self._plane]

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
        plane, planes = self._plane, self.part.own_nodes
        with readable(path, "" if self.part.whole else "a checkpoint that all machines share"):
            saved = read_parts(path, plane)
            values = saved("values")
            if values is None:
                raise KeyError("values")
            for j, k in enumerate(self.part.nodes.tolist()):
                self._values[j * plane : (j + 1) * plane] = values[k * plane : (k + 1) * plane]
            self.record.restore(saved, slice(planes.start * plane, planes.stop * plane), then)
        if self.posed.varies:  # what it has come to by now, when it may have been larger than now
            largest = float(self._mine(self._values).max())
            self._obstacles.highest = max(self._obstacles.highest, largest)
