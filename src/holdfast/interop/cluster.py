"""Parameter sweeps (campaigns) on a Dask cluster, and the connection to one."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import distributed
import distributed.comm as distributed_comm

from holdfast.errors import HoldfastError, ScenarioError

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
