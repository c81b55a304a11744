"""The values of a march, in memory or on disk, and its stages, carried out by threads.

Units are nodes that are computed, or skipped, together; threads share the places of an axis among
themselves, stage after stage. A stage of a march over a small grid takes a fraction of a
millisecond, of which a thread that sleeps, or that waits for the interpreter, would take a tenth to
begin. So they go from stage to stage in compiled code, and look out for a moment before they sleep.

A step over a grid on a disk goes through the planes of the first axis with its stages close
together. Each stage follows the one before at the distance that a scheme reaches, so that the
planes between the first and the last of them are in memory, and every array is read and written
once in a step instead of once in every stage. The numbers are the same: a plane is computed when
what it depends on has been, and overwritten when nothing depends on it any more. Bounds that move
are those of its time in every stage, and a symmetry reflects a plane onto itself.

Half of a grid may tell the other half: which units are computed, and what is copied.

    values, upper, lower    (nodes,)                of the planes held, the last axis is the fastest
    u                       (1 + parameters + axes,)
    numbers                 (8 + 6 * axes,)         those of a stage, as `names_of_numbers` says
    arguments               (threads, arguments)    of a sweep; addresses and whole numbers
    counts                  (3,)                    units computed, nodes not finite, largest move
"""

from __future__ import annotations

import hashlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from queue import SimpleQueue
from types import TracebackType
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.codegen.scalar_llvm import PACKED, scalars_text
from holdfast.execution.codegen.scalar_reader import read, scalars
from holdfast.execution.leaf import compiled_text
from holdfast.execution.level_set.fold import Flags, Fold, Places
from holdfast.execution.level_set.schemes import Scheme
from holdfast.execution.level_set.stage_leaf import INFINITE, Stage
from holdfast.execution.level_set.stencils import SHARE
from holdfast.execution.resources import Memory, Room

Numbers = npt.NDArray[Any]

NumbersNeeded = tuple[int, int, int]

LINE = 64
"""Bytes of a line of the processor's cache."""


class SweepCode:
    """The addresses of its functions, `sweep` and `mirror`, for `Workers`, and what they need."""

    def __init__(self, precision: str, *, one_slope: bool) -> None:
        files = ("stencils", f"slopes_{'once' if one_slope else 'twice'}", "sweep")
        folder = resources.files(__package__)
        source = "\n".join((folder / f"{name}.py").read_text("utf-8") for name in files)
        parsed, entries = read(source), ("sweep", "mirror")
        text = scalars_text(parsed, entries, single=precision == "float32", fused=True, packed=True)
        self._machine = compiled_text(text, optimised=True)
        self.name = "sweep_" + hashlib.sha256(text.encode()).hexdigest()[:24]
        self.constants = {name: int(value) for name, value in parsed.constants.items()}
        self.kind = np.dtype(precision)
        self.one_slope = one_slope
        self.sweep, self.mirror = (self._machine.address(PACKED + name) for name in entries)

    def room(self, shape: Sequence[int], cut: Sequence[int], sizes: Sequence[int]) -> NumbersNeeded:
        """How many numbers a sweep needs: whole ones, of double precision, of values."""
        of, n, nodes = self.constants, len(shape), shape[-1]
        local, stretches = cut[1] * cut[2], cut[2]
        (along, of_row, outer), plain = sizes[:3], sizes[5]
        wholes, held = of["SLOPES"] + 2 * of["WORDS"] + 9 * n + 11, 2 * n * of["PITCH"]
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

    def memory(self, room: NumbersNeeded) -> tuple[Numbers, Numbers, Numbers]:
        """That a thread needs for sweeps; its values begin with a line of the processor's cache."""
        line = LINE // self.kind.itemsize
        values = np.zeros(room[2] + line, dtype=self.kind)
        first = -address(values) % LINE // self.kind.itemsize
        return np.zeros(room[0], dtype=np.int64), np.zeros(room[1]), values[first:]


@cache
def sweep_code(precision: str, *, one_slope: bool) -> SweepCode:
    """The code for a precision, and for schemes with one or two slopes of every interval."""
    return SweepCode(precision, one_slope=one_slope)


def address(array: Numbers) -> int:
    """Of an array of any shape, whose numbers follow one another."""
    return int(array.ctypes.data)


LONGEST = 128
"""Nodes of a stretch of a row, at most."""

SHORT = 64
"""Nodes up to which several rows are one unit."""


def layout(
    shape: Sequence[int], short: int = SHORT, longest: int = LONGEST
) -> tuple[int, int, int, int]:
    """The units of the last two axes: several whole rows, or a stretch of a single one.

    Rows in a unit, groups of rows, stretches of a row, nodes in a stretch.
    """
    rows = shape[-2] if len(shape) > 1 else 1
    groups = -(-rows // max(1, short // shape[-1]))
    stretches = -(-shape[-1] // longest)
    return -(-rows // groups), groups, stretches, -(-shape[-1] // stretches)


@dataclass(frozen=True)
class Planes:
    """Of the planes of the first axis of a grid those that are held together. nodes: the places
    along the axis that they are at, (planes,); own: those of them that are no halo; count: of the
    grid."""

    nodes: Places
    own: slice
    count: int

    @staticmethod
    def all_of(count: int) -> Planes:
        return Planes(np.arange(count), slice(0, count), count)

    @property
    def own_nodes(self) -> slice:
        """Those that are no halo, among those of the grid."""
        first = int(self.nodes[self.own.start])
        return slice(first, first + self.own.stop - self.own.start)

    @property
    def ends(self) -> tuple[bool, bool]:
        """Whether the first plane of the grid is among these, and whether the last is."""
        mine = self.own_nodes
        return mine.start == 0, mine.stop == self.count

    @property
    def whole(self) -> bool:
        return all(self.ends)


Counts = npt.NDArray[np.float64]

READS = 300_000
"""How often a thread looks whether others have gone on before it sleeps: some 100 microseconds."""

NAP, LONGEST_NAP = 5e-5, 5e-3
"""Seconds that the first sleeps where another takes longer than that, each time twice as long."""

MOST_ARGUMENTS = 32
"""Of a function that threads carry out, at most."""


@cache
def _loops() -> tuple[Callable[..., None], ...]:
    """`serve`, `lead` and `gather` of `worker_loop.py`."""
    names, text = ("serve", "lead", "gather"), scalars("level_set/worker_loop")
    machine = compiled_text(scalars_text(text, names), optimised=True)
    return tuple(machine.function(n, len(text.functions[n].parameters)) for n in names)


class Workers:
    """Threads of which the caller is one; to be used in a `with` statement.

    Each takes slices that follow one another, and when it has done with them one after the other
    of what is left, so that all end at about the same time.
    """

    def __init__(self, threads: int, places: int) -> None:
        self.threads, line = threads, LINE // 8
        self._taken = np.zeros(SHARE * threads, dtype=np.int64)
        self._slices = np.zeros(len(self._taken) + 1, dtype=np.int64)
        self._begun = np.zeros(1, dtype=np.int64)
        self._ended = np.zeros((threads - 1, line), dtype=np.int64)
        self._counts, self._sums = np.zeros((threads, line)), np.zeros(4)
        shared = address(self._taken), address(self._slices), 0
        heads = [[0, *shared, k, address(of)] for k, of in enumerate(self._counts)]
        self._orders = np.zeros((threads, len(heads[0]) + MOST_ARGUMENTS), dtype=np.int64)
        self._orders[:, : len(heads[0])] = heads
        self._rest = self._orders[:, len(heads[0]) :]
        self.share(0, places)
        self._serve, lead, gather = _loops()
        begun, others = address(self._begun), address(self._ended)
        self._lead = partial(
            lead, begun, address(self._orders), address(self._taken), len(self._taken),
            address(self._counts), self._counts.size,
        )  # fmt: skip
        self._gather = partial(
            gather, begun, others, threads - 1, address(self._counts), address(self._sums), READS
        )
        # Of queues that are written in C a call is whole, also where an interrupt comes.
        self._wakes: list[SimpleQueue[None]] = [SimpleQueue() for _ in range(1, threads)]
        self._closed = False
        self._others = [
            threading.Thread(target=self._work, args=(k,), name=f"holdfast-march-{k}", daemon=True)
            for k in range(1, threads)
        ]

    def share(self, first: int, last: int) -> None:
        """The places that are shared in the stages to come."""
        count = min(len(self._taken), last - first)
        slices = first + np.arange(count + 1) * (last - first) // max(count, 1)
        self._slices[: count + 1] = slices
        self._orders[:, 3] = count

    def __enter__(self) -> Workers:
        try:
            for other in self._others:
                other.start()
        except BaseException:  # be it an interrupt
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._wait()
        finally:  # all are told before any is waited for: an interrupt may come at any time
            self._closed = True
            for wakes in self._wakes:
                wakes.put(None)
        for other in self._others:
            if other.ident is not None:
                other.join()

    def _work(self, thread: int) -> None:
        """What another thread does."""
        other = thread - 1
        places = map(address, (self._begun, self._ended[other], self._orders[thread]))
        serve = partial(self._serve, *places, READS)
        while not self._closed:
            serve()
            self._wakes[other].get()

    def _wake(self, stage: int) -> None:
        """Those that have not ended a stage, and do not look for it; one that is woken twice looks
        once more."""
        for other, (ended, away) in enumerate(self._ended[:, :2].tolist()):
            if away and ended < stage:
                self._wakes[other].put(None)

    def run(self, function: int, arguments: Numbers) -> Counts:
        """All threads carry out a function; what they count: two sums and the largest, shape (3,).

        function: the address of one that takes its arguments packed: `taken`, `slices`,
        `slice_count`, `thread`, `counts` and then these, addresses or whole numbers, of shape
        (threads, arguments), or (arguments,) where all have the same.
        """
        self._orders[:, 0] = function
        self._rest[:, : arguments.shape[-1]] = arguments
        self._wake(int(self._begun[0]) + 1)
        try:
            self._lead()
        finally:  # none works on the caller's arrays when this ends, be it by an interrupt
            self._wait()
        return self._sums[:3].copy()

    def _wait(self) -> None:
        """Until all have ended what has begun; an interrupt that comes meanwhile is raised then."""
        interrupt: BaseException | None = None
        nap = NAP
        while True:
            try:
                self._gather()
                if self._sums[3]:
                    break
                self._wake(int(self._begun[0]))  # one that fell asleep just before it began
                time.sleep(nap)
                nap = min(2 * nap, LONGEST_NAP)
            except KeyboardInterrupt as error:
                interrupt = error
        if interrupt is not None:
            raise interrupt


class HasStages(Protocol):
    @property
    def stages(self) -> int:
        """Of a step."""


class HasLeaves(Protocol):
    def stage(self, *, lower: bool, upper: bool) -> Stage:
        """The arithmetic of a stage; lower, upper: whether there are such bounds at nodes."""

    def found(self, *, lower: bool, upper: bool) -> tuple[Places, Places, Places]:
        """The addresses of leaves, with a stage and one that measures, shape (4,); the sizes of a
        sweep, shape (6,)."""


class Marched(Protocol):
    """What the holder of its values reads of a march (`march.py`). axes: (axes, nodes of the
    longest); shape, kinds: (axes,); cut: (4,)."""

    code: SweepCode
    scheme: Scheme
    precision: str
    fold: Fold | None
    axes: npt.NDArray[np.float64]
    shape: Places
    cut: Places
    kinds: Places
    nodes: int
    units: int
    places: int
    threads: int

    @property
    def method(self) -> HasStages:
        """Of the steps."""

    @property
    def leaves(self) -> HasLeaves:
        """What the sweep calls."""


class MarchArrays:
    """arrays[0] are the values at the beginning of a step and at its end, the others those of its
    stages, each (nodes,). flags: of every stage the units that are to be computed, shape (stages,
    units), of a single stage (2, units).

    What is in no unit that is computed stays as it is, in every array.
    """

    flags: Flags

    def __init__(
        self,
        march: Marched,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        another: Callable[[Array], Array],
    ) -> None:
        """upper, lower: bounds at every node. another: gives the arrays for values of stages."""
        stages = march.method.stages
        self.march, self.stages = march, stages
        # The last of several stages reads the beginning at its own node alone, and overwrites it.
        self.arrays = [values, *(another(values) for _ in range(max(stages - 1, 1)))]
        self.flags = np.ones((max(stages, 2), march.units), dtype=np.uint8)
        plain, measured, self.sizes = march.leaves.found(
            lower=lower is not None, upper=upper is not None
        )
        self._leaves = {False: plain, True: measured}
        self.kept = upper, lower
        self._arrays_turned = self._flags_turned = False
        self._arguments: dict[tuple[int, bool, bool, bool], Numbers] = {}
        self._memory: list[tuple[Numbers, Numbers, Numbers]] = []
        self._of_stage: tuple[Numbers, Numbers] | None = None
        self._room = march.code.room(march.shape.tolist(), march.cut.tolist(), self.sizes.tolist())

    def out(self, s: int) -> Array:
        """What comes out of a stage, shape (nodes,)."""
        return self.arrays[(s + 1) % len(self.arrays)]

    def marks(self, s: int) -> tuple[Flags, Flags, Flags]:
        """The units to be computed in a stage, those in the next, both (units,), and which of the
        later ones, (later, units)."""
        flags, stages = self.flags, self.stages
        last = s == stages - 1
        return flags[s], flags[(s + 1) % len(flags)], flags[1:stages] if last else flags[:0]

    def swept(self, workers: Workers, s: int, u: Array, numbers: Array, measures: bool) -> Counts:
        """A stage of the units at the places that the workers share; counts of the shape (3,)."""
        if self._of_stage is None:
            self._of_stage = u.copy(), numbers.copy()
            room = range(workers.threads)
            self._memory = [self.march.code.memory(self._room) for _ in room]
        for buffer, new in zip(self._of_stage, (u, numbers), strict=True):
            buffer[:] = new
        stage = s, measures, self._arrays_turned, self._flags_turned
        if stage not in self._arguments:
            self._arguments[stage] = self._arguments_of(s, measures)
        return workers.run(self.march.code.sweep, self._arguments[stage])

    def _arguments_of(self, s: int, measures: bool) -> Numbers:
        """Those of a sweep in every such stage, for every thread, shape (threads, arguments)."""
        march, arrays, out = self.march, self.arrays, self.out(s)
        here, there, later = self.marks(s)
        before = arrays[0] if self.stages == 1 else out
        assert self._of_stage is not None
        same = [
            *map(address, (*self._of_stage, arrays[s], arrays[0], out, before)),
            *(0 if bound is None else address(bound) for bound in self.kept), len(out),
            *map(address, (here, there, later)), len(later), march.units,
            address(march.shape), len(march.shape), address(march.cut), address(march.kinds),
            address(self._leaves[measures]), address(self.sizes),
            address(march.axes), march.axes.shape[1],
        ]  # fmt: skip
        return np.array([[*map(address, of_thread), *same] for of_thread in self._memory])

    def ended(self, s: int) -> None:
        """After a stage: of a method with a single one the arrays change places."""
        if self.stages == 1:
            self.exchange()
            self.flags = self.flags[::-1]
            self._flags_turned = not self._flags_turned

    def exchange(self) -> None:
        """The arrays of a method with a single stage change places."""
        self.arrays.reverse()
        self._arrays_turned = not self._arrays_turned


class Bounds(Protocol):
    """Bounds at nodes that move."""

    def refresh(self, time: float) -> None:
        """Have them be those of a time t."""

    def renew(self, time: float, first: int, last: int) -> Any:
        """The same at some places of the first axis; what there is to know of them there."""

    def check(self, renewals: Sequence[Any]) -> None:
        """Refuse what no march can go on with, once a stage has renewed all of them."""


@dataclass(frozen=True)
class StageOrder:
    """s: which stage of a step; u: what is the same at all nodes; numbers, measures: as a stage
    takes them, of the shapes in the table of this module. time: that of the bounds at nodes from
    this stage on, where they move; again: whether everything is computed, also what is settled."""

    s: int
    u: Array
    numbers: Array
    measures: bool
    time: float | None
    again: bool


@dataclass(frozen=True)
class StageAnswer:
    """Units computed, nodes that are not finite and the first of them among those of the grid, the
    largest move, whether nothing is left to be computed."""

    computed: int
    wrong: int
    first: int
    move: float
    fixed: bool


NOT_YET = StageAnswer(0, 0, 0, 0.0, False)
"""The answer to an order that is carried out with a later one, whose answer is that to both."""


class Stages(Protocol):
    """What carries out the stages of the steps of a march, wherever."""

    def stage(self, order: StageOrder) -> StageAnswer:
        """One of them, or `NOT_YET`."""


class Within(NamedTuple):
    """The values are no lower and no higher; distances from zero below `nearest` are rounding: the
    speed of the set is not relative to less (`stage_leaf.py`)."""

    floor: float = -math.inf
    ceiling: float = math.inf
    nearest: float = 0.0


ANYWHERE = Within()


def joined(answers: Sequence[Sequence[StageAnswer]]) -> StageAnswer:
    """Of all parts, and of stages that follow one another: where it is not finite, of the first."""
    stages = list(zip(*answers, strict=True))
    wrong = next((k for k, of in enumerate(stages) if any(a.wrong for a in of)), len(stages) - 1)
    bad = [a for a in stages[wrong] if a.wrong]
    return StageAnswer(
        sum(a.computed for of in stages for a in of),
        sum(a.wrong for a in bad),
        min((a.first for a in bad), default=0),
        max(a.move for a in stages[-1]),
        all(a.fixed for a in stages[-1]),
    )


TOGETHER = 1 << 20
"""Nodes that are looked at together."""


class StagesHere:
    """Stages of a march on this machine, by its processor or another device."""

    flags: Any
    bounds: Bounds | None = None
    """Those that move, if any do."""

    def stage(self, order: StageOrder) -> StageAnswer:
        """Carry out a stage of a step."""
        if order.again:
            self.flags[:] = 1
        if order.time is not None:
            assert self.bounds is not None
            self.bounds.refresh(order.time)
            self._bounds_moved()
        computed, wrong, move = self._carry_out(order)
        first = self.not_finite() if wrong else 0
        return StageAnswer(int(computed), int(wrong), first, float(move), self.fixed)

    def _bounds_moved(self) -> None:
        """The bounds at nodes are others now."""

    def _carry_out(self, order: StageOrder) -> Counts:
        """Units computed, nodes not finite, the largest move."""
        raise NotImplementedError

    def not_finite(self) -> int:
        """The first of the grid's nodes that the last stage has made not finite."""
        raise NotImplementedError

    @property
    def fixed(self) -> bool:
        """Whether nothing is left to be computed."""
        return not bool(self.flags[0].any())


class Sweeping(StagesHere, MarchArrays):
    """Used in a `with` statement. Others do the same elsewhere (`device_sweeping.py`)."""

    def __init__(
        self,
        march: Marched,
        values: Array,
        upper: Array | None,
        lower: Array | None,
        room: Room | None = None,
        bounds: Bounds | None = None,
    ) -> None:
        """room: for the values of stages."""
        super().__init__(march, values, upper, lower, (room or Memory()).copy)
        self._values, self.bounds = values, bounds
        self._workers = Workers(march.threads, march.places)

    def __enter__(self) -> Sweeping:
        self._workers.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        try:
            if kind is None and self.values() is not self._values:
                self._values[:] = self.arrays[0]
        finally:
            self._workers.__exit__(kind, error, at)

    def _carry_out(self, order: StageOrder) -> Counts:
        s = order.s
        self._narrow(s, self.marks(s)[0])
        counts = self.swept(self._workers, s, order.u, order.numbers, order.measures)
        self._out = self.out(s)
        self._reflect(self._out)
        self.ended(s)
        return counts

    def _narrow(self, s: int, here: Flags) -> None:
        """Of the units to be computed those that are computed here."""
        if self.march.fold is not None:
            self.march.fold.narrow(here)

    def _reflect(self, values: Array) -> None:
        """Of the half that is not computed, what the next stage reads."""
        if self.march.fold is not None:
            self._mirror(values, self.march.fold.needed)

    def not_finite(self) -> int:
        return first_not_finite(self._out)

    def values(self) -> Array:
        """The values at the nodes, shape (nodes,), between two steps; they change with the next."""
        if self.march.fold is not None:
            self._mirror(self.arrays[0], self.march.fold.rest)
        return self.arrays[0]

    def largest(self) -> float:
        return float(self.values().max())

    def on_one_side(self, limit: str) -> bool:
        return on_one_side(self.values(), limit)

    def _mirror(self, values: Array, chosen: Array) -> None:
        """Of the half that is not computed, what lies at those places."""
        fold, shape = self.march.fold, self.march.shape
        tried = np.zeros((self.march.threads, 1), dtype=np.int64)
        assert fold is not None
        same = [
            address(values), len(values), address(shape), len(shape), address(fold.places),
            fold.places.shape[1], fold.axis, address(chosen), len(chosen),
        ]  # fmt: skip
        arguments = np.array([[address(of_thread), *same] for of_thread in tried])
        self._workers.run(self.march.code.mirror, arguments)


def on_one_side(values: Array, limit: str) -> bool:
    """Whether nothing is left of a set that shrinks, or nothing is left for one that grows."""
    parts = (values[k : k + TOGETHER] for k in range(0, len(values), TOGETHER))  # to save memory
    return not any((v > 0 if limit == "shrink" else v <= 0).any() for v in parts)


def not_finite(values: Array) -> Array:
    """Where values of either precision are no number, or as good as infinite, shape (nodes,)."""
    return ~(np.abs(values) < np.float64(INFINITE))


def first_not_finite(values: Array) -> int:
    """The place of the first; some at a time, to save memory."""
    for first in range(0, len(values), TOGETHER):
        wrong = not_finite(values[first : first + TOGETHER])
        if wrong.any():
            return first + int(np.argmax(wrong))
    return 0


NODES = 1_000_000
"""Nodes that a stage computes before the next follows, at least."""


def streams(states: int, stages: int, reflects_first: bool) -> bool:
    """Whether the stages of a step may follow one another so.

    reflects_first: whether a symmetry has a plane of the first axis reflected onto another.
    """
    return states > 2 and stages > 1 and not reflects_first


class Streaming(Sweeping):
    """A sweeping whose arrays are on a disk."""

    def __init__(self, *arrays: Any) -> None:
        super().__init__(*arrays)
        self._waiting: list[StageOrder] = []

    @property
    def streams(self) -> bool:
        """Whether its stages may follow one another so."""
        fold = self.march.fold
        return streams(len(self.march.shape), self.stages, fold is not None and fold.axis == 0)

    def stage(self, order: StageOrder) -> StageAnswer:
        """The stages of a step are carried out with the last of them."""
        if not self.streams:
            return super().stage(order)
        self._waiting.append(order)
        if order.s < self.stages - 1:
            return NOT_YET
        orders, self._waiting = self._waiting, []
        return joined([self._step(orders)])

    def _step(self, orders: Sequence[StageOrder]) -> list[StageAnswer]:
        """All stages of a step."""
        if orders[0].again:
            self.flags[:] = 1
        march, many = self.march, len(orders)
        planes, reach = int(march.shape[0]), int(self.sizes[3])
        around = bool(march.kinds[0] == 1)
        block = max(2 * march.threads, -(-NODES // (march.nodes // planes)))
        ends = [planes + s * reach * around for s in range(many)]
        done = [end - planes for end in ends]
        answers = [NOT_YET] * many
        renewals: list[list[Any]] = [[] for _ in orders]
        while done[-1] < ends[-1]:
            for s, order in enumerate(orders):
                ready = ends[s] if s == 0 or done[s - 1] == ends[s - 1] else done[s - 1] - reach
                last = min(ready, done[s] + block)
                if last <= done[s]:
                    continue
                for low, high in _unrolled(done[s], last, planes):
                    if order.time is not None:
                        assert self.bounds is not None
                        renewals[s].append(self.bounds.renew(order.time, low, high))
                    answers[s] = _added(answers[s], self._planes(order, low, high))
                done[s] = last
        self._workers.share(0, planes)
        return self._answers(answers, renewals)

    def _planes(self, order: StageOrder, low: int, high: int) -> Counts:
        """A stage of some planes."""
        march, s = self.march, order.s
        planes = int(march.shape[0])
        units, nodes = march.units // planes, march.nodes // planes
        self._narrow(s, self.marks(s)[0][low * units : high * units])
        self._workers.share(low, high)
        counts = self.swept(self._workers, s, order.u, order.numbers, order.measures)
        self._workers.share(0, high - low)
        self._reflect(self.out(s)[low * nodes : high * nodes])
        return counts

    def _answers(
        self, answers: list[StageAnswer], renewals: Sequence[Sequence[Any]]
    ) -> list[StageAnswer]:
        """Those of the stages, up to the first at which the march ends."""
        for s, answer in enumerate(answers):
            if self.bounds is not None and renewals[s]:
                self.bounds.check(renewals[s])
            if answer.wrong:
                first = first_not_finite(self.out(s))
                return [*answers[:s], StageAnswer(0, answer.wrong, first, 0.0, False)]
        last = answers[-1]
        return [*answers[:-1], StageAnswer(last.computed, 0, 0, last.move, self.fixed)]


def _unrolled(first: int, last: int, planes: int) -> list[tuple[int, int]]:
    """The same planes of a ring, at most all of it, as one or two ranges of the axis."""
    around = first // planes * planes
    first, last = first - around, last - around
    if last <= planes:
        return [(first, last)]
    return [(first, planes), (0, last - planes)]


def _added(answer: StageAnswer, counts: Counts) -> StageAnswer:
    return StageAnswer(
        answer.computed + int(counts[0]),
        answer.wrong + int(counts[1]),
        0,
        max(answer.move, float(counts[2])),
        False,
    )
