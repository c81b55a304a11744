"""A part of a march in a worker of a Dask cluster: what the worker does when it is asked.

The values stay in the worker. They are no result of a task, so Dask neither moves nor recomputes
them; a lease, which is one, ends with the connection of whoever asked for the march, and they go
with it. Every request says which of the march it is, so that none is answered twice, or by a worker
that has begun anew. Edges go from worker to worker. What is handed over is a copy, of which the
last two are kept: a neighbour asks for one while the next is made.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from distributed.protocol.serialize import Serialize

from holdfast._version import __version__
from holdfast.analysis.reachability.march_part import MarchPart
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import HoldfastError, SimulationError
from holdfast.execution.level_set.slab import Edges, Part
from holdfast.execution.level_set.sweeping import StageAnswer, StageOrder
from holdfast.execution.working_room import Memory

_serialized: Any = Serialize  # it has no types

EDGES = "holdfast_edges"
"""The request of one worker to another."""


@dataclass(frozen=True)
class Hello:
    """What a worker says of itself: its version of holdfast, threads, bytes of memory."""

    version: str
    threads: int
    memory: int


@dataclass(frozen=True)
class Lost:
    """The answer of a worker that has no such part, or no such neighbour, any more."""

    why: str


class Lease:
    """Kept by the scheduler for whoever began a march; the part goes with it."""

    def __init__(self, march: str, name: str) -> None:
        self.march, self.name = march, name

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a part of a march stays in its worker")

    def __del__(self) -> None:
        release(self.march, self.name)


class HeldPart:
    """A part, with its neighbours by the addresses of their workers."""

    def __init__(self, march: str, addresses: Sequence[str], place: int) -> None:
        self.march, self.addresses, self.place = march, addresses, place
        self.thread = ThreadPoolExecutor(1, thread_name_prefix="holdfast-part")
        self.rounds = 0
        self.handed: dict[int, dict[int, Edges]] = {}

    def build(self, posed: Posed, parts: Sequence[Part], stages: int, threads: int) -> None:
        self.parts = parts
        own = parts[self.place]
        self.part = MarchPart(posed, own, stages=stages, threads=threads, room=Memory())
        self.wanted = own.wanted(parts) if len(parts) > 1 else []
        self.asked = {
            k: which
            for k, other in enumerate(parts)
            for place, which in other.wanted(parts)
            if place == self.place and len(parts) > 1
        }

    def carry_out(self, orders: Sequence[StageOrder], found: list[Edges]) -> list[StageAnswer]:
        """Stages, after what the others have handed over."""
        self.handed.pop(self.rounds - 1, None)  # all have it, as they have been asked again
        if found:
            self.part.take(found)
            found.clear()  # the memory is needed for what is handed over next
        answers = self.part.carry_out(orders)
        self.rounds += 1
        self.handed[self.rounds] = {
            k: self.part.edges(which).copy() for k, which in self.asked.items()
        }
        return answers


_held: dict[tuple[str, str], HeldPart] = {}
"""The parts in this process, by march and by the address of their worker."""


def hello(dask_worker: Any) -> Hello:
    """What a worker is, once it can hand over edges."""

    async def edges(march: str, rounds: int, place: int) -> Any:
        held = _held.get((march, dask_worker.address))
        if held is None or rounds not in held.handed:
            return None
        return _serialized(held.handed[rounds][place])

    dask_worker.handlers[EDGES] = edges
    memory = dask_worker.memory_manager.memory_limit or 0
    return Hello(__version__, dask_worker.state.nthreads, int(memory))


async def build(
    march: str,
    posed: Posed,
    parts: Sequence[Part],
    addresses: Sequence[str],
    stages: int,
    dask_worker: Any,
) -> Any:
    """Make the part of this worker."""
    held = HeldPart(march, addresses, addresses.index(dask_worker.address))
    _held[march, dask_worker.address] = held
    threads = posed.marching.threads or dask_worker.state.nthreads
    return await _told(held, held.build, posed, parts, stages, threads)


async def ask(march: str, rounds: int, method: str, given: Sequence[Any], dask_worker: Any) -> Any:
    """What the part answers to a method of `MarchPart`, after so many rounds of stages."""
    held = _held.get((march, dask_worker.address))
    if held is None or held.rounds != rounds:
        return Lost("it has begun anew")
    return await _told(held, getattr(held.part, method), *given)


async def carry_out(march: str, rounds: int, orders: Sequence[StageOrder], dask_worker: Any) -> Any:
    """One round: the edges of the others, then stages."""
    held = _held.get((march, dask_worker.address))
    if held is None or held.rounds != rounds:
        return Lost("it has begun anew")
    found: list[Edges] = []
    if rounds > 0:
        try:
            asked = (
                dask_worker.rpc(held.addresses[k]).holdfast_edges(
                    march=march, rounds=rounds, place=held.place
                )
                for k, _ in held.wanted
            )
            found = list(await asyncio.gather(*asked))
        except OSError as error:
            return Lost(f"a neighbour is gone ({type(error).__name__})")
        if any(edges is None for edges in found):
            return Lost("a neighbour has begun anew")
    return await _told(held, held.carry_out, orders, found)


async def _told(held: HeldPart, function: Any, *given: Any) -> Any:
    """What it gives, or the error that it raises, in the thread of the part.

    An `OSError` of its own is not one of the connection to it, which says that it is lost.
    """
    loop = asyncio.get_running_loop()
    try:
        return await loop.run_in_executor(held.thread, function, *given)
    except HoldfastError as error:
        return error
    except (OSError, MemoryError) as error:
        return SimulationError(
            f"worker {held.addresses[held.place]} cannot go on ({type(error).__name__}: {error})",
            remedy="look at its log",
        )


def release(march: str, name: str) -> None:
    """Let go of the part of a march, if there is one; what it is doing is done first."""
    held = _held.pop((march, name), None)
    if held is not None:
        held.thread.submit(_ended, held)
        held.thread.shutdown(wait=False)


def _ended(held: HeldPart) -> None:
    if hasattr(held, "part"):
        held.part.close(False)
