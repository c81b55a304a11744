"""Runs of a closed loop on a graphics processor, one for each thread.

The loop (`loop.py`) and its leaves are printed as C++ in the place of LLVM: the same operations in
the same order, none of them fused. So a run has the bits that it has on the processor. w are the
numbers of a run, shape (rows,), and s its whole numbers, which belong to a thread; its records and
its rings are columns of arrays of all runs, shape (rows, runs), so that threads that follow one
another write numbers that follow one another.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.c_printer import Body, c_functions, scalars_c
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.codegen.scalar_llvm import LEAF
from holdfast.execution.codegen.scalar_reader import Scalars, read, scalars, text_of
from holdfast.execution.device.program import Device
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.blocks import (
    NOTED,
    BlockNumbers,
    Numbers,
    Trajectories,
    rings_of,
    write_notes,
    write_records,
)
from holdfast.execution.simulation.built_loop import (
    SINGLE,
    Kind,
    Layout,
    fixed_for,
    own_leaves,
    shape_of,
)
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.table_in_parts import in_memory

PLACES = ("t", "q", "x", "p")
"""The arguments of a leaf."""


def leaves_cpp(leaves: Mapping[str, Leaf]) -> str:
    """The leaves, each a function of the places of its arguments, with the functions they call."""
    text = "\n\n".join(_leaf(name, leaf) for name, leaf in leaves.items())
    return c_functions(text, FUNCTIONS).replace("static inline", "HF_FUNCTION") + text


def _leaf(name: str, leaf: Leaf) -> str:
    """All arguments are read before a result is written: it may be in place of one."""
    places = {n: f"{a}[{k}]" for a, names in leaf.arguments.items() for k, n in enumerate(names)}
    inputs = {n: place.replace("[", "_").replace("]", "") for n, place in places.items()}
    body = Body(
        leaf.steps, leaf.results, "    ", read={k: inputs[n] for k, n in leaf.read.items()},
        inputs=inputs,
    )  # fmt: skip
    texts = [body.text(v.number) for v in leaf.results]
    lines = [*body.lines, *(f"    const double o_{i} = {text};" for i, text in enumerate(texts))]
    lines += [f"    out[{i}] = o_{i};" for i in range(len(texts))]
    whole = "\n".join(lines)
    used = [n for n, local in inputs.items() if _names(local, whole)]
    read = [f"    const double {inputs[n]} = {places[n]};" for n in used]
    arguments = ", ".join(f"const double *{a}" for a in PLACES)
    head = f"HF_CALLED void {LEAF}{name}({arguments}, double *out)"
    return "\n".join([head, "{", *read, *lines, "}"])


def _names(name: str, text: str) -> bool:
    """Whether a text has a name as a whole word."""
    return re.search(rf"\b{re.escape(name)}\b", text) is not None


MOST_BYTES = 1 << 31
"""Memory of the device for the runs of one launch."""

MOST_RUNS = 1 << 18
"""Runs of one launch: between two of them the progress is told, and an interrupt is noticed."""


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
    """Fill `result`; `first`: the number of the first run among those that share the seed. starts:
    shape (runs, states)."""
    shape = shape_of(program, width=1)
    layout = Layout(shape)
    varied_at, noted = _places(layout, numbers)
    kernels = device.program(_text(program, kind, layout))
    xp, runs = device.arrays, len(starts)
    records = settings.samples // settings.stride + 1
    rings = sum(slots * size for slots, size in rings_of(program, settings, 1).values())
    each = 8 * (len(varied_at) + records * layout.record + rings + len(noted))
    together = max(1, min(runs, MOST_RUNS, MOST_BYTES // each))
    block = BlockNumbers(layout, program, settings, 1)
    block.set_numbers(starts, numbers, 0, 0)
    w, s = block.w[0, : layout.size].copy(), block.s[0].copy()
    held = []  # the table stays on the device while its address is used
    if program.table is not None:
        held.append(xp.asarray(in_memory(program.table[0])))
        for k in layout.tables:
            s[k] = device.address(held[0])
    w, s = xp.asarray(w), xp.asarray(s)
    from_runs, to_runs = (xp.asarray(np.array(places)) for places in (varied_at, [*noted.values()]))
    for begin in range(0, runs, together):
        part = slice(begin, min(begin + together, runs))
        many = part.stop - part.start
        per_run = np.empty((len(varied_at), many))
        n, of_plant = starts.shape[1], len(numbers.varied_plant)
        per_run[:n], per_run[n] = starts[part].T, first + np.arange(part.start, part.stop)
        per_run[n + 1 : n + 1 + of_plant] = numbers.own_plant[part].T
        per_run[n + 1 + of_plant :] = numbers.own_gains[part].T
        # Runs are the fastest axis of all that a thread has in an array of all runs.
        log = xp.zeros((records, layout.record, many))
        notes = xp.zeros((len(noted), many))
        room = xp.zeros((max(rings, 1), many))
        kernels.run(
            "hf_simulate", device.blocks, np.int64(many), w, s, xp.asarray(per_run), from_runs,
            np.int64(len(varied_at)), np.int64(records), log, room, np.int64(rings), notes,
            to_runs, np.int64(len(noted)),
        )  # fmt: skip
        places = dict(zip(noted, device.fetched(notes), strict=True))
        write_notes(result, places, part, len(program.inputs))
        of_runs = device.fetched(log).transpose(2, 0, 1)[..., np.newaxis]
        done = np.full(many, records)
        write_records(result, layout, of_runs, done, part, 0, safeguarded=program.safeguarded)
        if progress is not None:
            progress(part.stop / runs)


def _places(layout: Layout, numbers: Numbers) -> tuple[list[int], dict[tuple[str, int], int]]:
    """The places in w of what differs between runs, and of what is asked for at their end."""
    at, counts = layout.at, layout.counts
    per_run = [*range(at["q"], at["q"] + counts["q"]), at["run"]]
    per_run += [at["plant"] + int(k) for k in numbers.varied_plant]
    per_run += [at["gains"] + int(k) for k in numbers.varied_gains]
    return per_run, {(name, k): at[name] + k for name in NOTED for k in range(counts[name])}


def _text(program: ClosedLoopProgram, kind: Kind, layout: Layout) -> str:
    """The kernel `hf_simulate` of a program."""
    shape = shape_of(program, width=1)
    fixed, root = fixed_for(shape, layout, kind, stoppable=False), ["simulate"]
    loop = read(text_of("simulation/loop"), fixed)
    by_name = {**own_leaves(shape, kind), **program.leaves}
    called = loop.called(root)
    leaves = leaves_cpp({name: by_name[name] for name in called if name in by_name})
    parts = [name.removesuffix(SINGLE) for name in called if name not in by_name]
    single = any(name.endswith(SINGLE) for name in called)
    library = Scalars(scalars("simulation/parts").functions | loop.functions, {})
    printed = scalars_c(library, [*parts, *root], scope="HF_CALLED", kernels=root)
    table = f"typedef {'float' if single else 'double'} hf_table;\n" + (
        "#define hf_table_at(address) ((const hf_table *)(address))\n"
    )
    return table + leaves + printed
