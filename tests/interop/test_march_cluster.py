"""A march on the worker processes of a Dask cluster."""

import os
import signal

import pytest

from holdfast.errors import SimulationError
from tests.divided_marches import basin, kernel, same

distributed = pytest.importorskip("distributed")

from holdfast.interop import march_cluster as module  # noqa: E402
from holdfast.interop.march_cluster import march_cluster  # noqa: E402


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as found:
        yield found


@pytest.mark.parametrize("exchange", ["stage", "step"])
def test_two_processes_have_the_answer_of_one(cluster, exchange):
    with march_cluster(cluster.scheduler_address, exchange=exchange) as workers:
        same(kernel(), kernel(cluster=workers))


def test_a_worker_killed_costs_what_was_done_since_the_checkpoint(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "REJOINS", 0.0)  # the other goes on alone
    told, killed = [], []

    def progress(share):
        told.append(share)
        if len(told) == 8:
            worker = next(iter(cluster.workers.values()))
            os.kill(worker.pid, signal.SIGKILL)
            killed.append(worker.pid)

    with march_cluster(cluster.scheduler_address) as workers:
        found = basin(cluster=workers, checkpoint=tmp_path, checkpoint_every=0, progress=progress)
        assert killed
        same(basin(), found, "computed_share")
        assert len(told) <= found.report.steps + 1  # with a checkpoint of every step
        ended = basin(cluster=workers, checkpoint=tmp_path, progress=told.append)
        same(found, ended, "computed_share")


def test_clusters_that_cannot_be_used_are_refused():
    with (
        pytest.raises(SimulationError, match="cluster here; expected the address of a scheduler"),
        march_cluster("here"),
    ):
        pass
    with (
        pytest.raises(SimulationError, match='exchange: \'never\'; expected "stage", "step" or'),
        march_cluster("tcp://localhost:1", exchange="never"),
    ):
        pass


def test_workers_with_too_little_memory_or_another_version_are_refused(cluster, monkeypatch):
    with march_cluster(cluster.scheduler_address) as workers:
        monkeypatch.setattr(module, "part_memory", lambda posed, part: 10**13)
        with pytest.raises(SimulationError, match=r"takes 9.31e\+03 GiB, and worker tcp.* has"):
            kernel(cluster=workers)
        monkeypatch.setattr(module, "__version__", "0.0.1")
        with pytest.raises(SimulationError, match=r"has holdfast .*; expected holdfast 0\.0\.1"):
            kernel(cluster=workers)
