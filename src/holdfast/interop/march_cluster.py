"""Marches divided among the workers of a Dask cluster."""

from __future__ import annotations

import dataclasses
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from holdfast._version import __version__
from holdfast.analysis.reachability.divided_march import PartsLostError, cut
from holdfast.analysis.reachability.march_part import layers_of
from holdfast.analysis.reachability.memory_estimate import part_memory
from holdfast.analysis.reachability.problem import Posed
from holdfast.errors import HoldfastError, SimulationError
from holdfast.interop import march_worker
from holdfast.interop.cluster import connected
from holdfast.maths.games.hamiltonian import Hamiltonian

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
    it with its threads. exchange: of the planes that neighbours read, after every "stage" or every
    "step"; "auto" compares the messages saved with the planes that are then computed twice.

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
    def parts(self, posed: Posed, h: Hamiltonian) -> Iterator[Any]:
        """The parts of a march in workers, until the end of the block."""
        workers = self._workers()
        count = cut(posed, len(workers))
        threads = posed.marching.threads or min(w.threads for w in workers.values())
        stages = self._stages(posed, count, threads)
        found = layers_of(posed).parts(count, stages)
        chosen = list(workers)[: len(found)]
        for name, part in zip(chosen, found, strict=True):
            _check_memory(posed, name, workers[name], part_memory(posed, part))
        march = uuid.uuid4().hex
        held = ClusterParts(self._client, self._address, march, chosen, found, stages)
        try:
            held.build(posed)
            yield held
        finally:
            held.release()

    def _workers(self) -> dict[str, march_worker.Hello]:
        """Those that answer, by address; as many as before, where they are back in time."""
        if self._count:
            time.sleep(SETTLES)
        waited = time.monotonic() + REJOINS
        while True:
            found = self._answering()
            if found and (len(found) >= self._count or time.monotonic() > waited):
                break
            if not found and time.monotonic() > waited + REJOINS:
                raise SimulationError(
                    f"cluster {self._address}: it has no workers any more",
                    remedy=f"dask worker {self._address}; then run it again: it goes on from its "
                    "checkpoint, if it has one",
                )
            time.sleep(0.2)
        self._count = len(found)
        for name, worker in found.items():
            if worker.version != __version__:
                raise SimulationError(
                    f"cluster {self._address}: worker {name} has holdfast {worker.version}",
                    expected=f"holdfast {__version__}, as here",
                    remedy="install the same version for all workers",
                )
        return dict(sorted(found.items()))

    def _answering(self) -> dict[str, march_worker.Hello]:
        if self._client.status == "closed":
            raise SimulationError(
                f"the connection to cluster {self._address} has been closed",
                remedy="march within the block of `with march_cluster(...)`",
            )
        try:
            answers = self._client.run(march_worker.hello, on_error="return")
        except OSError as error:
            raise _no_scheduler(self._address, error) from None
        for name, answer in answers.items():
            if isinstance(answer, ImportError):
                raise SimulationError(
                    f"cluster {self._address}: worker {name} cannot import holdfast ({answer})",
                    remedy='install it there too: pip install "holdfast[cluster]"',
                )
        return {n: a for n, a in answers.items() if isinstance(a, march_worker.Hello)}

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

    here = False

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
                march_worker.Lease,
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
        given = (self._march, sent, self.parts, self._names, self.stages)
        self._answers(march_worker.build, self._names, *given)

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

    def ask(self, method: str, *given: Any) -> list[Any]:
        if method == "carry_out":
            found = self._answers(
                march_worker.carry_out, self._names, self._march, self._rounds, *given
            )
            self._rounds += 1
            return found
        asked = (self._march, self._rounds, method, given)
        return self._answers(march_worker.ask, self._names, *asked)

    def ask_one(self, place: int, method: str, *given: Any) -> Any:
        asked = (self._march, self._rounds, method, given)
        return self._answers(march_worker.ask, [self._names[place]], *asked)[0]

    def exchange(self) -> None:
        """Every part takes over the edges of the others when it is asked for the next stages."""

    def release(self) -> None:
        """Have the workers let go of their parts."""
        for lease in self._leases:
            lease.release()

    def _answers(self, function: Any, names: list[str], *given: Any) -> list[Any]:
        try:
            found = self._client.run(function, *given, workers=names, on_error="return")
        except OSError as error:
            raise _no_scheduler(self._address, error) from None
        answers = [found.get(name) for name in names]
        refused = [a for a in answers if isinstance(a, HoldfastError)]
        if refused:
            raise refused[0]
        for name, answer in zip(names, answers, strict=True):
            if isinstance(answer, (march_worker.Lost, OSError)):
                why = answer.why if isinstance(answer, march_worker.Lost) else str(answer)
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


def _check_memory(posed: Posed, name: str, worker: march_worker.Hello, needed: int) -> None:
    if worker.memory and needed > 0.7 * worker.memory:
        raise SimulationError(
            f"a part of {posed.grid.nodes:,} nodes takes {needed / 2**30:.3g} GiB, and worker "
            f"{name} has {worker.memory / 2**30:.3g}",
            expected="at most 70 % of it",
            remedy='take more workers, fewer nodes, or precision="float32"',
        )
