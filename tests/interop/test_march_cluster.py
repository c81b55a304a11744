"""A march on the worker processes of a Dask cluster."""

import asyncio
import os
import signal
import socket
import threading
from types import SimpleNamespace

import pytest

from holdfast.analysis.reachability.divided_march import PartsLostError
from holdfast.analysis.reachability.problem import Marching
from holdfast.errors import SimulationError
from holdfast.execution.level_set.slab import layers
from tests.divided_marches import basin, kernel, same

distributed = pytest.importorskip("distributed")

from holdfast.interop import march_cluster as module  # noqa: E402
from holdfast.interop.march_cluster import march_cluster  # noqa: E402

WHOLE = layers((9, 9, 9), 3, "extrapolated").parts(1, 1)[0]


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as found:
        yield found


@pytest.mark.few("step")
@pytest.mark.parametrize("exchange", ["stage", "step"])
def test_two_processes_have_the_answer_of_one(cluster, exchange):
    with march_cluster(cluster.scheduler_address, exchange=exchange) as workers:
        same(kernel(), kernel(cluster=workers))


@pytest.mark.heavy
def test_a_worker_killed_costs_what_was_done_since_the_checkpoint(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "REJOINS", 0.0)  # the other goes on alone
    told, killed = [], []

    def progress(share):
        told.append(share)
        if len(told) == 4:
            worker = next(iter(cluster.workers.values()))
            os.kill(worker.pid, signal.SIGKILL)
            killed.append(worker.pid)

    with march_cluster(cluster.scheduler_address) as workers:
        found = basin(cluster=workers, checkpoint=tmp_path, checkpoint_every=0, progress=progress)
        assert killed
        same(basin(), found, "computed_share")
        first = [share for share in told if share <= 0.5]  # of two marches
        assert len(first) <= found.report.steps + 1  # with a checkpoint of every step
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


def test_a_server_of_another_kind_is_not_waited_for(monkeypatch):
    """As that of the dashboard of a scheduler."""
    monkeypatch.setattr(module, "CONNECTION_TIMEOUT", "0.2s")
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        said = "what answers there is no server of Dask; expected the address of a scheduler"
        with pytest.raises(SimulationError, match=said), march_cluster(address):
            pass
    with pytest.raises(SimulationError, match="TLS expects a"), march_cluster("tls://a:1"):
        pass


def test_a_cluster_that_has_been_left_is_refused():
    left = module.MarchCluster(SimpleNamespace(status="closed"), "tcp://a:1", "auto")
    with pytest.raises(SimulationError, match=r"cluster tcp://a:1 has been closed; march within"):
        kernel(cluster=left)


def test_what_a_worker_cannot_do_is_told_and_is_no_loss():
    """A full disk of its own is not a connection that is lost."""

    def write():
        raise OSError(28, "No space left on device")

    held = module.HeldPart("a", ["tcp://a:1"], 0)
    told = asyncio.run(module._told(held, write))
    held.thread.shutdown()
    assert isinstance(told, SimulationError)
    assert "worker tcp://a:1 cannot go on (OSError: [Errno 28] No space left on" in str(told)


@pytest.mark.parametrize("there", [True, False])
def test_a_worker_that_takes_on_no_task_is_told_from_one_that_is_lost(there):
    def wait(timeout):
        raise TimeoutError

    name = "tcp://a:1"
    client = SimpleNamespace(
        submit=lambda *_, **__: SimpleNamespace(exception=wait),
        nthreads=lambda: {name: 1} if there else {},
    )
    parts = module.ClusterParts(client, "tcp://s:1", "march", [name], [WHOLE], 1)
    with pytest.raises(SimulationError if there else PartsLostError) as refused:
        parts.build(SimpleNamespace(marching=Marching()))
    assert f"worker {name} " + ("has taken on no task" if there else "was lost") in str(
        refused.value
    )


@pytest.mark.few("None-4")
@pytest.mark.parametrize(("asked", "has"), [(None, 4), (2, 2)])
def test_a_part_has_the_threads_of_its_worker_or_those_asked_for(asked, has, monkeypatch):
    made = []
    monkeypatch.setattr(module, "MarchPart", lambda *_, threads, **__: made.append(threads))
    worker = SimpleNamespace(address="tcp://a:1", state=SimpleNamespace(nthreads=4))
    posed = SimpleNamespace(marching=Marching(threads=asked))
    given = ("march", posed, [WHOLE], [worker.address], 1)
    asyncio.run(module.build(*given, dask_worker=worker))
    module._held.pop(("march", worker.address)).thread.shutdown()
    assert made == [has]


@pytest.mark.heavy
def test_workers_with_too_little_memory_or_another_version_are_refused(cluster, monkeypatch):
    with march_cluster(cluster.scheduler_address) as workers:
        monkeypatch.setattr(module, "part_memory", lambda posed, part: 10**13)
        with pytest.raises(SimulationError, match=r"takes 9.31e\+03 GiB, and worker tcp.* has"):
            kernel(cluster=workers)
        monkeypatch.setattr(module, "__version__", "0.0.1")
        with pytest.raises(SimulationError, match=r"has holdfast .*; expected holdfast 0\.0\.1"):
            kernel(cluster=workers)


@pytest.mark.heavy
def test_marches_at_the_same_time_do_not_mix(cluster):
    found = {}

    def march(name, problem):
        with march_cluster(cluster.scheduler_address) as workers:
            found[name] = problem(cluster=workers)

    threads = [
        threading.Thread(target=march, args=given)
        for given in (("kernel", kernel), ("basin", basin))
    ]
    for one in threads:
        one.start()
    for one in threads:
        one.join(120)
    same(kernel(), found["kernel"])
    same(basin(), found["basin"])
