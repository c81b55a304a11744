"""Runs of a closed loop on a graphics processor, one for each thread.

The loop (`loop.py`) and its leaves are printed as C++ in the place of LLVM, the same operations in
the same order, none of them fused: a run has the bits that it has on the processor.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import NamedTuple

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.loop_cpp import CppLoopText, leaves_cpp
from holdfast.execution.codegen.loop_text import LOG, RING
from holdfast.execution.codegen.scalar_c import scalars_c
from holdfast.execution.codegen.scalar_reader import scalars
from holdfast.execution.device.program import Device
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.block_numbers import BlockNumbers, Numbers, rings_of
from holdfast.execution.simulation.kind import Kind
from holdfast.execution.simulation.layout import FORGOTTEN, LATE, RECORDS, Layout, shape_of
from holdfast.execution.simulation.loop import SINGLE, built_as
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.simulation.trajectories import Trajectories
from holdfast.execution.simulation.written import NOTED, write_notes, write_records
from holdfast.execution.table_in_parts import in_memory

MOST_BYTES = 1 << 31
"""Memory of the device for the runs of one launch."""

MOST_RUNS = 1 << 18
"""Runs of one launch: between two of them the progress is told, and an interrupt is noticed."""


class _Rows(NamedTuple):
    """Places in w. given: what differs between runs; noted: what is read at their end."""

    given: tuple[int, ...]
    noted: dict[tuple[str, int], int]


def simulate_on(
    device: Device,
    program: ClosedLoopProgram,
    kind: Kind,
    starts: Array,
    settings: Settings,
    numbers: Numbers,
    result: Trajectories,
    first: int,
    progress: Progress | None,
) -> None:
    """Fill `result`; `first`: the number of the first run among those that share the seed."""
    layout = Layout(shape_of(program, width=1))
    rows = _rows(layout, numbers)
    kernels = device.program(_text(program, kind, rows.given, tuple(rows.noted.values())))
    xp, runs = device.arrays, len(starts)
    records = settings.samples // settings.stride + 1
    rings = sum(slots * size for slots, size in rings_of(program, settings, 1).values())
    each = 8 * (len(rows.given) + records * layout.record + rings + len(rows.noted))
    together = max(1, min(runs, MOST_RUNS, MOST_BYTES // each))
    w, s = _first(layout, program, settings, starts, numbers)
    held = []  # the table stays on the device while its address is used
    if program.table is not None:
        held.append(xp.asarray(in_memory(program.table[0])))
        for k in layout.tables:
            s[k] = device.address(held[0])
    w, s = xp.asarray(w), xp.asarray(s)
    for begin in range(0, runs, together):
        own = slice(begin, min(begin + together, runs))
        many = own.stop - own.start
        given = np.empty((len(rows.given), many))
        n, of_plant = starts.shape[1], len(numbers.varied_plant)
        given[:n], given[n] = starts[own].T, first + np.arange(own.start, own.stop)
        given[n + 1 : n + 1 + of_plant] = numbers.own_plant[own].T
        given[n + 1 + of_plant :] = numbers.own_gains[own].T
        log = xp.zeros((records, layout.record, many))
        noted = xp.zeros((len(rows.noted), many))
        room = xp.zeros((max(rings, 1), many))
        kernels.run(
            "hf_simulate", device.blocks, np.int64(many), np.int64(many), w, s,
            xp.asarray(given), np.int64(records), np.int64(rings), log, room, noted,
        )  # fmt: skip
        found = device.fetched(noted)
        places = dict(zip(rows.noted, found, strict=True))
        write_notes(result, places, own, len(program.inputs))
        of_runs = device.fetched(log).transpose(2, 0, 1)[..., np.newaxis]
        done = np.full(many, records)
        write_records(result, layout, of_runs, done, own, 0, safeguarded=program.safeguarded)
        if progress is not None:
            progress(own.stop / runs)


def _rows(layout: Layout, numbers: Numbers) -> _Rows:
    at, counts = layout.at, layout.counts
    given = [*range(at["q"], at["q"] + counts["q"]), at["run"]]
    given += [at["plant"] + int(k) for k in numbers.varied_plant]
    given += [at["gains"] + int(k) for k in numbers.varied_gains]
    noted = {(name, k): at[name] + k for name in NOTED for k in range(counts[name])}
    return _Rows(tuple(given), noted)


def _first(
    layout: Layout, program: ClosedLoopProgram, settings: Settings, starts: Array, numbers: Numbers
) -> tuple[Array, Array]:
    """w and s of the first run before its first sample; what differs is set by the kernel."""
    block = BlockNumbers(layout, program, settings, 1)
    block.set_numbers(starts, numbers, 0, 0)
    s = block.s[0].copy()
    s[LOG] = 0
    for ring in (LATE, FORGOTTEN):
        s[RING + 3 * ring + 2] -= layout.size
    return block.w[0, : layout.size].copy(), s


def _text(
    program: ClosedLoopProgram, kind: Kind, given: tuple[int, ...], noted: tuple[int, ...]
) -> str:
    """The kernel `hf_simulate` of a program."""
    shape = shape_of(program, width=1)
    loop = built_as(CppLoopText(1), shape, kind)
    layout, at = loop.layout, loop.layout.at
    own = {**loop.leaves, **program.leaves}
    leaves = leaves_cpp({name: own[name] for name in loop.called if name in own})
    parts = [name.removesuffix(SINGLE) for name in loop.called if name not in own]
    single = any(name.endswith(SINGLE) for name in loop.called)
    numbers = {
        "SIZE": layout.size, "ENTRIES": layout.entries, "LATE": RING + 3 * LATE, "Q": at["q"],
        "STATES": shape.states, "WATCHED": shape.constraints, "WORST": at["worst"],
        "C0": at["c0"], "TOLERANCE": at["tolerance"], "OUTCOME": at["outcome"],
        "EXIT_TIME": at["exit_time"], "EXIT_CONSTRAINT": at["exit_constraint"],
        "RECORDS": RECORDS, "LEFT": f"{float(Outcome.LEFT)}",
    }  # fmt: skip
    head = [f"#define HF_{name} {value}" for name, value in numbers.items()]
    head += [
        f"typedef {'float' if single else 'double'} hf_table;",
        "#define hf_table_at(address) ((const hf_table *)(address))",
    ]
    known = scalars("simulation/parts")
    printed = re.sub(r"^static ", "HF_CALLED ", scalars_c(known, parts), flags=re.MULTILINE)
    take = [f"    w[{place}] = given[{k} * pitch];" for k, place in enumerate(given)]
    give = [f"    noted[{k} * pitch] = w[{place}];" for k, place in enumerate(noted)]
    copies = [
        "HF_FUNCTION void hf_given(double *w, const double *given, hf_int pitch)",
        "{", *take, "}", "",
        "HF_FUNCTION void hf_noted(const double *w, double *noted, hf_int pitch)",
        "{", *give, "}", "",
    ]  # fmt: skip
    before, behind = _own("device_runs.h"), _own("device_simulate.h")
    return "\n".join([*head, before, printed, leaves, loop.text, *copies, behind])


def _own(name: str) -> str:
    return (resources.files(__package__) / name).read_text("utf-8")
