"""Sweeps and divided marches on the workers of a Dask cluster, and what a worker does when asked.

The values stay in the worker. They are no result of a task, so Dask neither moves nor recomputes
them; a lease, which is one, ends with the connection of whoever asked for the march, and they go
with it. Every request says which of the march it is, so that none is answered twice, or by a worker
that has begun anew. Edges go from worker to worker. What is handed over is a copy, of which the
last two are kept: a neighbour asks for one while the next is made.
"""

from __future__ import annotations

import asyncio
import dataclasses
import re
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import distributed
import distributed.comm as distributed_comm
from distributed.protocol.serialize import Serialize

from holdfast._version import __version__
from holdfast.analysis.reachability.divided_march import (
    Answer,
    Asked,
    MarchPart,
    PartsLostError,
    cut,
    layers_of,
)
from holdfast.analysis.reachability.one_march import part_memory
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import HoldfastError, ScenarioError, SimulationError
from holdfast.execution.level_set.slab import Edges, Part
from holdfast.execution.level_set.sweeping import StageAnswer, StageOrder
from holdfast.maths.games.hamiltonian import Hamiltonian

CONNECTION_TIMEOUT = "20s"

_client: Any = distributed.Client  # it has no types
_comm: Any = distributed_comm
_security: Any = distributed.Security


@contextmanager
def connected(address: str, error_class: type[HoldfastError], option: str) -> Iterator[Any]:
    """A client of the scheduler at this address, which has a worker.

    Raises an error of the class if no scheduler answers or no worker registers within 20 s.
    """
    if not re.search(r":\d+/?\Z", address):  # otherwise the search takes 40 s
        raise error_class(
            f"{option} {address}", expected="the address of a scheduler, such as tcp://host:8786"
        )
    try:
        _reach(address)
        client: Any = _client(address, timeout=CONNECTION_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:  # the last two of tls://
        raise error_class(
            f"{option} {address}: {error}", expected="the address of a scheduler",
            remedy="start one with `dask scheduler`, and workers with `dask worker ADDRESS`",
        ) from None  # fmt: skip
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECTION_TIMEOUT)  # that begins as this does
        except OSError:
            raise error_class(
                f"{option} {address}: it has no workers", remedy=f"dask worker {address}"
            ) from None
        yield client


def _reach(address: str) -> None:
    """Fail where no Dask server answers: a client would wait for ever for one of another kind, as
    that of the dashboard."""

    seconds = float(CONNECTION_TIMEOUT.removesuffix("s"))

    async def greet() -> None:
        arguments = _security().get_connection_args("client")
        try:
            reached = _comm.connect(address, timeout=seconds, **arguments)
            comm = await asyncio.wait_for(reached, 1.5 * seconds)
        except TimeoutError:
            raise OSError("what answers there is no server of Dask") from None
        await comm.close()

    with ThreadPoolExecutor(1) as pool:  # where a notebook has a loop of its own
        pool.submit(lambda: asyncio.run(greet())).result()


@contextmanager
def cluster_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """An executor on the cluster of the scheduler at this address, and its number of threads.

    The work of a worker that dies is repeated by the others. Raises `ScenarioError` if no
    scheduler answers or no worker registers within 20 s, or if the cluster is lost.
    """
    with connected(address, ScenarioError, "--cluster") as client:
        cores = sum(client.nthreads().values())
        try:
            yield client.get_executor(pure=False), cores
        except (distributed.KilledWorker, distributed.CancelledError, OSError) as error:
            raise ScenarioError(
                f"--cluster {address}: lost ({type(error).__name__}: {error})",
                remedy="run it again: finished cells are kept",
            ) from None


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
        part = parts[self.place]
        self.part = MarchPart(posed, part, stages=stages, threads=threads)
        self.wanted = part.wanted(parts) if len(parts) > 1 else []
        self.asked = {
            k: which
            for k, other in enumerate(parts)
            for place, which in other.wanted(parts)
            if place == self.place and len(parts) > 1
        }

    def carry_out(self, orders: Sequence[StageOrder], received: list[Edges]) -> list[StageAnswer]:
        """Stages, after what the others have handed over."""
        self.handed.pop(self.rounds - 1, None)  # all have it, as they have been asked again
        if received:
            self.part.take(received)
            received.clear()  # the memory is needed for what is handed over next
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


async def ask(
    march: str, rounds: int, method: Callable[..., Any], arguments: Sequence[Any], dask_worker: Any
) -> Any:
    """What the part answers to a method of `MarchPart`, after so many rounds of stages."""
    held = _held.get((march, dask_worker.address))
    if held is None or held.rounds != rounds:
        return Lost("it has begun anew")
    return await _told(held, method, held.part, *arguments)


async def carry_out(march: str, rounds: int, orders: Sequence[StageOrder], dask_worker: Any) -> Any:
    """One round: the edges of the others, then stages."""
    held = _held.get((march, dask_worker.address))
    if held is None or held.rounds != rounds:
        return Lost("it has begun anew")
    received: list[Edges] = []
    if rounds > 0:
        try:
            asked = (
                dask_worker.rpc(held.addresses[k]).holdfast_edges(
                    march=march, rounds=rounds, place=held.place
                )
                for k, _ in held.wanted
            )
            received = list(await asyncio.gather(*asked))
        except OSError as error:
            return Lost(f"a neighbour is gone ({type(error).__name__})")
        if any(edges is None for edges in received):
            return Lost("a neighbour has begun anew")
    return await _told(held, held.carry_out, orders, received)


async def _told(held: HeldPart, function: Any, *arguments: Any) -> Any:
    """What it gives, or the error that it raises, in the thread of the part.

    An `OSError` of its own is not one of the connection to it, which says that it is lost.
    """
    loop = asyncio.get_running_loop()
    try:
        return await loop.run_in_executor(held.thread, function, *arguments)
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


REJOINS = 10.0
"""Seconds in which a worker that was lost may be back; then the others go on without it."""

SETTLES = 0.5
"""Seconds after which the scheduler knows that a worker is gone: it would be asked in vain."""

TIMEOUT = 30.0
"""Seconds in which every worker takes on a task."""

MESSAGE = 5e-3
"""Seconds that a round of messages takes."""

UPDATE = 40e-9
"""Seconds that a node takes a thread in a stage."""


@contextmanager
def march_cluster(address: str, *, exchange: str = "auto") -> Iterator[MarchCluster]:
    """The cluster of the scheduler at an address, for the option `cluster` of a march.

    Every worker holds a part of the grid, cut along its first axis, in its own memory, and computes
    it with its threads.

    address: of the scheduler, such as "tcp://10.0.0.1:8786". exchange: of the planes that
    neighbours read, after every "stage" or every "step"; "auto" compares the messages saved with
    the planes that are then computed twice.

    A worker that is lost costs what has been done since the last checkpoint, or the whole march
    where there is none: the march goes on with the others, or with a new one that has registered
    within 10 s. The checkpoint is written by the workers, so that its folder has to be one that all
    machines share.

    Raises `SimulationError` where no scheduler answers, or no worker registers within 20 s.
    """
    if exchange not in ("auto", "stage", "step"):
        raise SimulationError(f"exchange: {exchange!r}", expected='"stage", "step" or "auto"')
    with connected(address, SimulationError, "cluster") as client:
        yield MarchCluster(client, address, exchange)


class MarchCluster:
    """The workers of a client of Dask, as a place for the parts of marches."""

    def __init__(self, client: Any, address: str, exchange: str) -> None:
        self._client, self._address, self._exchange = client, address, exchange
        self._count = 0  # workers of the last attempt

    @contextmanager
    def parts(self, posed: Posed, h: Hamiltonian) -> Iterator[ClusterParts]:
        """The parts of a march in workers, until the end of the block."""
        workers = self._workers()
        count = cut(posed, len(workers))
        threads = posed.marching.threads or min(w.threads for w in workers.values())
        stages = self._stages(posed, count, threads)
        all_parts = layers_of(posed).parts(count, stages)
        chosen = list(workers)[: len(all_parts)]
        for name, part in zip(chosen, all_parts, strict=True):
            _check_memory(posed, name, workers[name], part_memory(posed, part))
        march = uuid.uuid4().hex
        held = ClusterParts(self._client, self._address, march, chosen, all_parts, stages)
        try:
            held.build(posed)
            yield held
        finally:
            held.release()

    def _workers(self) -> dict[str, Hello]:
        """Those that answer, by address; as many as before, where they are back in time."""
        if self._count:
            time.sleep(SETTLES)
        waited = time.monotonic() + REJOINS
        while True:
            workers = self._answering()
            if workers and (len(workers) >= self._count or time.monotonic() > waited):
                break
            if not workers and time.monotonic() > waited + REJOINS:
                raise SimulationError(
                    f"cluster {self._address}: it has no workers any more",
                    remedy=f"dask worker {self._address}; then run it again: it goes on from its "
                    "checkpoint, if it has one",
                )
            time.sleep(0.2)
        self._count = len(workers)
        for name, worker in workers.items():
            if worker.version != __version__:
                raise SimulationError(
                    f"cluster {self._address}: worker {name} has holdfast {worker.version}",
                    expected=f"holdfast {__version__}, as here",
                    remedy="install the same version for all workers",
                )
        return dict(sorted(workers.items()))

    def _answering(self) -> dict[str, Hello]:
        if self._client.status == "closed":
            raise SimulationError(
                f"the connection to cluster {self._address} has been closed",
                remedy="march within the block of `with march_cluster(...)`",
            )
        try:
            answers = self._client.run(hello, on_error="return")
        except OSError as error:
            raise _no_scheduler(self._address, error) from None
        for name, answer in answers.items():
            if isinstance(answer, ImportError):
                raise SimulationError(
                    f"cluster {self._address}: worker {name} cannot import holdfast ({answer})",
                    remedy='install it there too: pip install "holdfast[cluster]"',
                )
        return {n: a for n, a in answers.items() if isinstance(a, Hello)}

    def _stages(self, posed: Posed, count: int, threads: int) -> int:
        """From an exchange to the next: one stage, or those of a step."""
        stages = posed.method.stages
        if self._exchange != "auto":
            return stages if self._exchange == "step" else 1
        of = layers_of(posed)
        nodes = posed.grid.nodes / of.count * of.reach * stages * (stages - 1)
        twice = nodes * UPDATE / threads if count > 1 else 0.0
        return stages if twice < (stages - 1) * MESSAGE else 1


class ClusterParts:
    """The parts of one march, each in a worker."""

    def __init__(
        self,
        client: Any,
        address: str,
        march: str,
        workers: Sequence[str],
        parts: Sequence[Any],
        stages: int,
    ) -> None:
        self.parts, self.stages = parts, stages
        self._client, self._address, self._march = client, address, march
        self._names = list(workers)
        self._rounds = 0
        self._leases: list[Any] = []

    def build(self, posed: Posed) -> None:
        marching = dataclasses.replace(
            posed.marching, cluster=None, on_disk=None, checkpoint=None, checkpoint_every=60.0
        )
        self._leases = [
            self._client.submit(
                Lease,
                self._march,
                name,
                key=f"holdfast-march-{self._march}-{k}",
                workers=[name],
                allow_other_workers=False,
                pure=False,
            )
            for k, name in enumerate(self._names)
        ]
        for name, lease in zip(self._names, self._leases, strict=True):
            self._wait_for(name, lease)
        sent = dataclasses.replace(posed, marching=marching)
        arguments = (self._march, sent, self.parts, self._names, self.stages)
        self._answers(build, self._names, *arguments)

    def _wait_for(self, name: str, lease: Any) -> None:
        """Until a worker has taken on its lease; refused where it is there and does not."""
        try:
            lease.exception(timeout=TIMEOUT)
        except OSError as error:
            if name not in self._client.nthreads():
                raise PartsLostError(_lost(self._address, name, str(error))) from None
            raise SimulationError(
                f"cluster {self._address}: worker {name} has taken on no task for {TIMEOUT:g} s",
                expected="a worker that is not busy with other tasks, nor paused as its memory is "
                "full",
                remedy="look at its log; wait for its other tasks, or start it again",
            ) from None

    def ask(
        self, method: Callable[[MarchPart, *Asked], Answer], *arguments: *Asked
    ) -> list[Answer]:
        asked = (self._march, self._rounds, method, arguments)
        return self._answers(ask, self._names, *asked)

    def ask_one(
        self, place: int, method: Callable[[MarchPart, *Asked], Answer], *arguments: *Asked
    ) -> Answer:
        asked = (self._march, self._rounds, method, arguments)
        answer: Answer = self._answers(ask, [self._names[place]], *asked)[0]
        return answer

    def carry_out(self, orders: Sequence[StageOrder]) -> list[list[StageAnswer]]:
        answers = self._answers(carry_out, self._names, self._march, self._rounds, orders)
        self._rounds += 1
        return answers

    def release(self) -> None:
        """Have the workers let go of their parts."""
        for lease in self._leases:
            lease.release()

    def _answers(self, function: Any, names: list[str], *arguments: Any) -> list[Any]:
        try:
            by_worker = self._client.run(function, *arguments, workers=names, on_error="return")
        except OSError as error:
            raise _no_scheduler(self._address, error) from None
        answers = [by_worker.get(name) for name in names]
        refused = [a for a in answers if isinstance(a, HoldfastError)]
        if refused:
            raise refused[0]
        for name, answer in zip(names, answers, strict=True):
            if isinstance(answer, (Lost, OSError)):
                why = answer.why if isinstance(answer, Lost) else str(answer)
                raise PartsLostError(_lost(self._address, name, why))
            if isinstance(answer, BaseException):
                raise answer
        return answers


def _lost(address: str, name: str, why: str) -> SimulationError:
    return SimulationError(
        f"cluster {address}: worker {name} was lost again and again ({why})",
        remedy="look at its log: it may have had too little memory; run it again: it goes on from "
        "its checkpoint, if it has one",
    )


def _no_scheduler(address: str, error: OSError) -> SimulationError:
    return SimulationError(
        f"cluster {address}: the scheduler is gone ({type(error).__name__}: {error})",
        remedy="start it again, with its workers, and run this again: it goes on from its "
        "checkpoint, if it has one",
    )


def _check_memory(posed: Posed, name: str, worker: Hello, needed: int) -> None:
    if worker.memory and needed > 0.7 * worker.memory:
        raise SimulationError(
            f"a part of {posed.grid.nodes:,} nodes takes {needed / 2**30:.3g} GiB, and worker "
            f"{name} has {worker.memory / 2**30:.3g}",
            expected="at most 70 % of it",
            remedy='take more workers, fewer nodes, or precision="float32"',
        )
