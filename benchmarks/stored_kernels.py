"""What a kernel in a file and a table in a file cost.

    python benchmarks/stored_kernels.py [--nodes 31] [--text]

A kernel of six states is written, layer by layer, that no memory need hold; then it is opened, one
state, a slice and a filter ask for what they need, and the bytes read are counted. The table of a
law is exported to C as text and as a file. Numbers are in docs/kernel_store.md.
"""

import argparse
import os
import resource
import shutil
import subprocess
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import netCDF4
import numpy as np

import holdfast as hf
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.problem import definition
from holdfast.analysis.reachability.value_function import to_value_function
from holdfast.analysis.simulation.files import chunks_of

NAMES = tuple("abcdef")


def system():
    """Three double integrators."""
    states = tuple(hf.Quantity(n, "m") for n in NAMES)
    inputs = tuple(hf.Quantity(f"u{i}", "m/s^2") for i in range(3))
    symbols = {n: hf.symbol(n) for n in (*NAMES, "u0", "u1", "u2")}
    rates = {}
    for i, (x, v) in enumerate((("a", "b"), ("c", "d"), ("e", "f"))):
        rates |= {x: symbols[v], v: symbols[f"u{i}"]}
    bounds = hf.Box((-1,) * 3, (1,) * 3)
    return hf.System("six", states, inputs, rates, input_bounds=bounds, empirical="numbers")


def layer(axes, k, some):
    """A smooth value over some layers of the first axis, cut off below zero."""
    square = 0.0
    for i, nodes in enumerate(axes):
        own = nodes[k : k + some] if i == 0 else nodes
        shape = [1] * len(axes)
        shape[i] = len(own)
        square = square + (own.reshape(shape) ** 2 * (1 + 0.3 * i)).astype(np.float32)
    return np.maximum(1 - np.sqrt(square), -0.4).astype(np.float32)


def written(folder, nodes):
    """A file as `ValueFunction.save` writes it, of values that are made as they are written."""
    grid = hf.grid(system(), dict.fromkeys(NAMES, (-1.0, 1.0)), nodes)
    small = hf.grid(system(), dict.fromkeys(NAMES, (-1.0, 1.0)), 2)
    report = Report(
        kind="viability-kernel", system="six", converged=True, cell=2 / nodes, disturbances="min",
        holdfast_version=hf.__version__, definition=definition(system()),
    )  # fmt: skip
    like = to_value_function(small, np.zeros((2,) * 6, np.float32), report).dataset
    path = folder / f"six_{nodes}.nc"
    shape = (nodes,) * 6
    chunks = chunks_of(shape, NAMES)
    axes = [a.nodes for a in grid.axes]
    with netCDF4.Dataset(path, "w") as file:
        file.setncatts({**like.attrs, "format_version": 2})
        for axis in grid.axes:
            file.createDimension(axis.name, nodes)
            made = file.createVariable(axis.name, "f8", (axis.name,))
            made.setncatts(like[axis.name].attrs)
            made[:] = axis.nodes
        value = file.createVariable(
            "value", "f4", NAMES, fill_value=np.nan, zlib=True, complevel=1, shuffle=True,
            fletcher32=True, chunksizes=chunks,
        )  # fmt: skip
        value.set_auto_maskandscale(False)
        value.set_var_chunk_cache(0, 1, 0.0)
        value.setncatts({**like["value"].attrs, "highest": [1.0]})
        for k in range(0, nodes, chunks[0]):
            value[k : k + chunks[0]] = layer(axes, k, chunks[0])
    return path


def timed(what, work, stored=None, repeat=1):
    before = 0 if stored is None else stored.bytes_read
    begin = time.perf_counter()
    for _ in range(repeat):
        answer = work()
    took = (time.perf_counter() - begin) / repeat
    read = "" if stored is None else f", {(stored.bytes_read - before) / 2**20:.2f} MiB read"
    print(f"{what}: {took * 1e3:,.3f} ms{read}", flush=True)
    return answer


def filters(lazy, whole):
    """A step of a filter, over the file and over a table in memory."""
    state, command = np.array([0.21, 0.02, 0.13, -0.04, 0.31, 0.05]), [0.5, -0.4, 0.2]
    keeps = {}
    for name, value in (("file", lazy), ("memory", whole)):
        if value is None:
            continue
        keeps[name] = hf.SafetyFilter(system(), value, margin=0.05)
        timed(f"first step, {name}", lambda n=name: keeps[n].step(state, command), value.stored)
        timed(f"next steps, {name}", lambda n=name: keeps[n].step(state, command), None, 2000)
    rng = np.random.default_rng(0)
    if len(keeps) == 2:
        for _ in range(200):
            at = rng.uniform(-0.4, 0.4, 6)
            a, b = (keep.step(at, command) for keep in keeps.values())
            assert a.input.tobytes() == b.input.tobytes()
        print("200 random states: the same bits")

    def drive():
        at, keep = state.copy(), keeps["file"]
        for _ in range(500):
            u = keep.step(at, command).input
            at = at + 0.02 * np.array([at[1], u[0], at[3], u[1], at[5], u[2]])

    timed("500 steps along a path, file", drive, lazy.stored)


def simulated(lazy, whole):
    """Runs under a filter: over the file, as its own rule decides, and over a table in memory."""
    swing = hf.Law("swing", system().states, {
        f"u{i}": hf.parse_expression(f"{0.6 - 0.1 * i}*sin(t)", {"t": hf.TIME}) for i in range(3)
    }, empirical="numbers")  # fmt: skip
    for runs in (16, 160):
        starts = np.random.default_rng(1).uniform(-0.3, 0.3, (runs, 6))
        found = {}
        for name, value in (("file", lazy), ("memory", whole)):
            if value is None:
                continue
            law = hf.safety_law(system(), value, swing, margin=0.05)
            options = {"horizon": 10.0, "sample_time": 0.02, "record_every": 0.1, "starts": starts}

            def run(law=law, options=options):
                return hf.simulate(system(), law, **options).arrays["state"].values

            hf.simulate(system(), law, **{**options, "horizon": 0.1, "starts": starts[:1]})
            found[name] = timed(f"{runs} runs of 500 samples, {name}", run, value.stored)
        if len(found) == 2:
            assert found["file"].tobytes() == found["memory"].tobytes()


def exported(value, folder, *, text):
    """The law in C, its table as text and in a file: sizes and compile times."""
    law = hf.safety_law(system(), value, None)
    for where in ("file", "text") if text else ("file",):
        begin = time.perf_counter()
        source = folder / f"{where}.c"
        source.write_text(hf.export_c(system(), law, "six", table=where))
        if where == "file":
            hf.export_c_table(law, folder / "six.bin")
        wrote = time.perf_counter() - begin
        begin = time.perf_counter()
        subprocess.run(
            ["gcc", "-std=c99", "-O2", "-c", str(source), "-o", f"{source}.o"], check=True
        )
        took = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
        size = source.stat().st_size / 2**20
        print(
            f"C, table in the {where}: written {wrote:.1f} s, source {size:.3f} MiB, "
            f"compiled {took:.2f} s, compiler up to {peak:,.0f} MiB"
        )
    print(f"six.bin: {(folder / 'six.bin').stat().st_size / 2**20:.1f} MiB")


def main():
    given = argparse.ArgumentParser()
    given.add_argument("--nodes", type=int, default=31)
    given.add_argument("--c-nodes", type=int, default=12)
    given.add_argument("--text", action="store_true", help="export the table as text too")
    options = given.parse_args()
    _ = hf.load, hf.SafetyFilter, system()  # loaded, so that the first call is timed alone
    folder = Path(tempfile.mkdtemp(prefix="stored-"))
    try:
        with ProcessPoolExecutor(1) as other:  # so that its memory does not count
            path = timed("writing", lambda: other.submit(written, folder, options.nodes).result())
        logical = 4 * options.nodes**6
        print(f"{logical / 2**30:.2f} GiB of values, file {os.path.getsize(path) / 2**20:.1f} MiB")
        timed("opening, and loading xarray and what it loads", lambda: hf.load(path, lazy=True))
        lazy = timed("opening", lambda: hf.load(path, lazy=True))
        timed("one state", lambda: lazy.at([[0.1] * 6]), lazy.stored)
        timed("the same state", lambda: lazy.at([[0.1] * 6]), lazy.stored)
        timed("its slopes", lambda: lazy.gradient([[0.1] * 6]), lazy.stored)
        held = {"c": 0.03, "d": 0.04, "e": 0.01, "f": 0.02}
        timed("a slice", lambda: lazy.slice(**held), lazy.stored)
        whole = None
        if logical < 2**30:
            whole = timed("all in memory", lambda: hf.load(path, lazy=False))
        filters(lazy, whole)
        simulated(lazy, whole)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"the largest memory of this process: {peak:,.0f} MiB")
        small = written(folder, options.c_nodes)
        exported(hf.load(small, lazy=False), folder, text=options.text)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
