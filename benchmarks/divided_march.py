"""Marches divided among worker processes, and from a disk, beside a model: docs/large_kernels.md.

python benchmarks/divided_march.py [--nodes 12]                 scaling, in worker processes
python benchmarks/divided_march.py --disk FOLDER --nodes 13     from a disk, best with a limit:
    see `limited` for one by a control group of Linux; with --symmetric half of the grid, with
    stages that follow one another and with stages that go through the arrays one by one

The model of a step, where a worker has P planes of M nodes along the first axis, a scheme reaches g
of them, a step has S stages and e exchanges of halos (S, or 1), n workers have c threads each:

    computing    S (P + p) M u / c     p = g (S - 1) planes are computed twice if e = 1, else 0
    rounds       e (a + b n)           the coordinator asks every worker and waits for all
    edges        2 g S M w / B         both ways, w bytes a node

u is the time of a node in a stage while n processes march each a grid of their own; a + b n that of
rounds of a grid so small that it costs nothing; B is measured between two workers. The memory is
that of S arrays of P planes and their halos, of g S / e planes on either side, and of the edges of
two exchanges.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import multiprocessing
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import distributed
import numpy as np

import holdfast as hf
from holdfast.analysis.reachability.disk_estimate import disk_speed
from holdfast.execution.level_set.march import METHODS
from holdfast.execution.level_set.schemes import schemes
from holdfast.execution.level_set.sweeping import Streaming
from holdfast.interop.march_cluster import march_cluster
from holdfast.scenario.load import load_scenario

STAGES, REACH, BYTES = len(METHODS[3].stages), 3, 4
"""Of weno5 with its Runge-Kutta method, in single precision."""

STEPS = 15
"""Steps that are timed; the median counts, as the machine has other work."""

LARGE = {"31^6": (31,) * 6, "50^6": (50,) * 6}


@dataclass(frozen=True)
class Costs:
    """node: seconds of a thread for a node in a stage; fixed, each: seconds of a round, and of a
    round for every worker; bandwidth: bytes/s from worker to worker."""

    node: float
    fixed: float
    each: float
    bandwidth: float


@dataclass(frozen=True)
class Step:
    """The model: seconds of the parts of a step; bytes of edges and of memory of a worker."""

    computing: float
    rounds: float
    edges: float
    handed: float
    memory: float

    @property
    def seconds(self) -> float:
        return self.computing + self.rounds + self.edges


def modelled(
    shape: Sequence[int], workers: int, by_step: bool, costs: Costs, threads: float
) -> Step:
    """threads: of every worker; a share of one where workers share cores."""
    plane, own = math.prod(shape[1:]), math.ceil(shape[0] / workers)
    cut, exchanges = workers > 1, 1 if by_step else STAGES
    twice = REACH * (STAGES - 1) * (by_step and cut)
    halo = min(2 * REACH * STAGES // exchanges * cut, shape[0] - own)
    handed = 2 * REACH * STAGES * cut * plane * BYTES
    return Step(
        STAGES * (own + twice) * plane * costs.node / threads,
        exchanges * (costs.fixed + costs.each * workers),
        handed / costs.bandwidth,
        handed,
        (STAGES * (own + halo) + 2 * halo) * plane * BYTES,
    )


class Enough(Exception):  # noqa: N818
    """So many steps have been timed."""


def step_seconds(shape: Sequence[int], steps: int = STEPS, **options: Any) -> list[float]:
    """Seconds of the steps of a march of the kernel of the whole vehicle, all nodes computed."""
    return [step[0] for step in measured_steps(shape, steps, **options)]


def measured_steps(
    shape: Sequence[int], steps: int, *, symmetric: bool = False, **options: Any
) -> list[list[float]]:
    """The same, with the bytes that were read from disks and written to them in each.

    What is written counts when the system takes note of it, and again where it has been written.
    """
    names = ("x", "y", "psi", "u", "v", "r")
    nodes = [
        f"grid.nodes={{ {', '.join(f'{n} = {k}' for n, k in zip(names, shape, strict=True))} }}"
    ]
    scenario = load_scenario("ch7-six-states", nodes)
    found = [_now()]

    def progress(_share: float) -> None:
        found.append(_now())
        if len(found) > steps + 1:
            raise Enough

    options = {"scheme": "weno5"} | options
    if symmetric:
        options["symmetry"] = {"y": -1, "psi": -1, "v": -1, "r": -1}
    with contextlib.suppress(Enough):
        hf.viability_kernel(
            scenario.system, scenario.region, scenario.grid, 3.0, progress=progress, skip=False,
            precision="float32", disturbance={"Vx": 0.0, "Vy": 0.0}, **options,
        )  # fmt: skip
    return np.diff(found, axis=0)[1:].tolist()  # the first has the preparation


def _now() -> list[float]:
    """Seconds, and the bytes that this process has read from disks and written to them."""
    told = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return [time.perf_counter(), float(told["read_bytes"]), float(told["write_bytes"])]


@dataclass(frozen=True)
class Row:
    """What was measured, and what the model says."""

    kind: str
    workers: int
    exchange: str
    shape: list[int]
    measured: float
    model: float

    def __str__(self) -> str:
        shape = " x ".join(map(str, self.shape))
        return (
            f"| {self.kind} | {self.workers} | {self.exchange} | {shape} | {self.measured:.2f} s "
            f"| {self.model:.2f} s |"
        )


def bandwidth(client: Any) -> float:
    """Bytes/s from one worker to another, of a large array, once they know each other."""
    size, best = 64 * 2**20, 0.0
    one, other = list(client.nthreads())[:2]
    for k in range(3):
        array = client.submit(np.full, size, k, dtype=np.uint8, workers=[one], pure=False)
        distributed.wait(array)
        began = time.perf_counter()
        distributed.wait(client.submit(len, array, workers=[other], pure=False))
        best = max(best, size / (time.perf_counter() - began))
    return best


def alone(shape: Sequence[int], processes: int) -> float:
    """Seconds of a thread for a node in a stage, while so many processes march for themselves."""
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        list(pool.map(_median, [shape] * processes))  # compiled
        found = list(pool.map(_median, [shape] * processes))
    return max(found) / STAGES / math.prod(shape)


def _median(shape: Sequence[int], steps: int = STEPS, **options: Any) -> float:
    return float(np.median(step_seconds(shape, steps, **{"threads": 1} | options)))


def scaling(nodes: int) -> dict[str, Any]:
    """Strong and weak scaling with 1, 2 and 4 processes of one thread, and what 64 would take."""
    shape = (24, *(nodes,) * 5)
    times: dict[tuple[str, int, str], tuple[Sequence[int], float]] = {}
    rounds: dict[int, float] = {}
    node: dict[int, float] = {}
    across = 0.0
    for workers in (1, 2, 4):
        node[workers] = alone((12, *shape[1:]), workers)
        with (
            distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50
            ) as cluster,
            distributed.Client(cluster.scheduler_address, set_as_default=True) as client,
        ):
            if workers == 2:
                across = bandwidth(client)
            address = cluster.scheduler_address
            with march_cluster(address, exchange="stage") as place:
                tiny = (max(workers, 7), *(7,) * 5)
                rounds[workers] = _median(tiny, 40, cluster=place) / STAGES
                rounds[workers] -= node[workers] * math.prod(tiny) / workers
            for exchange in ("stage", "step")[: 1 + (workers > 1)]:
                with march_cluster(address, exchange=exchange) as place:
                    for kind, of in (("strong", shape), ("weak", (12 * workers, *shape[1:]))):
                        found = _median(of, cluster=place)
                        times[kind, workers, exchange] = of, found
                        print(kind, workers, exchange, of, f"{found:.2f} s", flush=True)
    each, fixed = np.polyfit(list(rounds), list(rounds.values()), 1)
    costs = {n: Costs(node[n], max(fixed, 0.0), max(each, 0.0), across) for n in node}
    rows = [
        Row(kind, n, exchange, list(of), found,
            modelled(of, n, exchange == "step", costs[n], 1.0).seconds)
        for (kind, n, exchange), (of, found) in times.items()
    ]  # fmt: skip
    large = {
        name: {
            exchange: asdict(step := modelled(of, 64, exchange == "step", costs[1], 16.0))
            | {"seconds": step.seconds, "one": modelled(of, 1, True, costs[1], 16.0).seconds}
            for exchange in ("stage", "step")
        }
        for name, of in LARGE.items()
    }
    return {"costs": {n: asdict(c) for n, c in costs.items()}, "rounds": rounds,
            "rows": [asdict(r) for r in rows], "large": large}  # fmt: skip


def limited(gigabytes: float) -> None:
    """Limit this process, with its share of the cache of files, by a control group (version 1).

    As root: the group is made beside that of the process, and stays.
    """
    group = Path("/sys/fs/cgroup/memory/holdfast_bench")
    group.mkdir(exist_ok=True)
    (group / "memory.limit_in_bytes").write_text(str(int(gigabytes * 1e9)))
    (group / "cgroup.procs").write_text(str(os.getpid()))


def stages_of(scheme: str) -> int:
    """Of a step with the Runge-Kutta method of a scheme."""
    return len(METHODS[schemes()[scheme].order].stages)


def from_disk(folder: str, nodes: int, gigabytes: float, scheme: str) -> dict[str, Any]:
    """Steps in memory, from a disk, and from a disk with less memory than the arrays take.

    Of few steps the shortest counts.
    """
    shape, stages = (24, *(nodes,) * 5), stages_of(scheme)
    node, arrays = BYTES * math.prod(shape), max(stages, 2)
    memory = min(step_seconds(shape, 4, scheme=scheme))
    reading, writing = disk_speed(Path(folder))
    cached = min(step_seconds(shape, 4, scheme=scheme, on_disk=folder))
    model = memory + arrays * node / reading + (arrays if stages > 1 else 1) * node / writing
    found = {"shape": list(shape), "scheme": scheme, "arrays": arrays * node, "memory": memory,
             "cached": cached, "reading": reading, "writing": writing, "model": model}  # fmt: skip
    if gigabytes:
        limited(gigabytes)
        steps = step_seconds(shape, 5, scheme=scheme, on_disk=folder)
        found |= {"limit": gigabytes * 1e9, "limited": min(steps[1:]), "steps": steps}
    return found


def half_from_disk(folder: str, nodes: int, gigabytes: float, scheme: str) -> dict[str, Any]:
    """Steps of a symmetric grid: in memory, and from a disk with less memory than it takes, with
    stages that follow one another and then with stages that each go through the arrays."""
    shape, arrays = (24, *(nodes,) * 5), max(stages_of(scheme), 2)
    given = {"scheme": scheme, "symmetric": True}
    memory = min(step_seconds(shape, 4, **given))
    if gigabytes:
        limited(gigabytes)
    following = measured_steps(shape, 5, **given, on_disk=folder)
    with mock.patch.object(Streaming, "streams", False):
        each = measured_steps(shape, 5, **given, on_disk=folder)
    found: dict[str, Any] = {"shape": list(shape), "scheme": scheme, "limit": gigabytes * 1e9,
             "arrays": arrays * BYTES * math.prod(shape), "memory": memory}  # fmt: skip
    for name, steps in (("following", following), ("each", each)):
        seconds, read, written = np.median(steps[1:], axis=0).tolist()
        found[name] = {"seconds": min(s for s, _, _ in steps[1:]), "median": seconds,
                       "read": read, "written": written}  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--nodes", type=int, default=10)
    parser.add_argument("--disk", default="")
    parser.add_argument("--limit", type=float, default=0.0, help="gigabytes of memory")
    parser.add_argument("--scheme", default="weno5")
    parser.add_argument("--symmetric", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.disk and given.symmetric:
        found = half_from_disk(given.disk, given.nodes, given.limit, given.scheme)
        print(json.dumps(found, indent=1))
    elif given.disk:
        found = from_disk(given.disk, given.nodes, given.limit, given.scheme)
        print(json.dumps(found, indent=1))
    else:
        found = scaling(given.nodes)
        for row in found["rows"]:
            print(Row(**row))
        print(json.dumps({k: found[k] for k in ("costs", "rounds", "large")}, indent=1))
    if given.json:
        known = json.loads(given.json.read_text()) if given.json.exists() else {}
        kind = f"disk, {given.scheme}" + ", symmetric" * given.symmetric
        known[kind if given.disk else "scaling"] = found
        given.json.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
