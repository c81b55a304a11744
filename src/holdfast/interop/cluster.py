"""A Dask cluster to compute campaigns on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Any

import distributed

from holdfast.errors import ScenarioError

PATIENCE = "20s"
_client: Any = distributed.Client  # it has no types


@contextmanager
def cluster_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """What computes on the cluster whose scheduler is there, and how many threads it has.

    Work of a worker that dies is done again by the others. Raises `ScenarioError` where nothing
    answers within 20 s or no worker is there within them, or the cluster is lost.
    """
    if not re.search(r":\d+/?\Z", address):  # else it is looked for, for 40 s
        raise ScenarioError(
            f"--cluster {address}", expected="the address of a scheduler, such as tcp://host:8786"
        )
    try:
        client: Any = _client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ScenarioError(
            f"--cluster {address}: {error}", expected="the address of a scheduler",
            remedy="begin one with `dask scheduler`, and workers with `dask worker ADDRESS`",
        ) from None  # fmt: skip
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)  # that begins as this does
        except OSError:
            raise ScenarioError(
                f"--cluster {address}: it has no workers", remedy=f"dask worker {address}"
            ) from None
        cores = sum(client.nthreads().values())
        try:
            yield client.get_executor(pure=False), cores
        except (distributed.KilledWorker, distributed.CancelledError, OSError) as error:
            raise ScenarioError(
                f"--cluster {address}: lost ({type(error).__name__}: {error})",
                remedy="run it again: what is done is kept",
            ) from None
