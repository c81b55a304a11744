"""Parameter sweeps (campaigns) on a Dask cluster, and the connection to one."""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any

import distributed

from holdfast.errors import HoldfastError, ScenarioError

CONNECTION_TIMEOUT = "20s"
_client: Any = distributed.Client  # it has no types


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
