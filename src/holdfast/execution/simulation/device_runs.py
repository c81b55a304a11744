"""Runs of a closed loop on a graphics processor, one for each thread.

The loop (`loop.py`) and its leaves are printed as C++ in the place of LLVM: the same calls,
branches and repetitions in the same order, the same operations, none of them fused. So a run has
the bits that it has on the processor. w are the numbers of a run and s its whole numbers, which
belong to a thread; its records and its rings are columns of arrays of all runs, `pitch` numbers
apart.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import resources
from typing import NamedTuple

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.c_printer import Body, c_functions, scalars_c
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.loop_text import LEAF, LOG, RING, Instructions, LoopText
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.codegen.scalar_reader import scalars
from holdfast.execution.device.program import Device
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.blocks import (
    NOTED,
    BlockNumbers,
    Numbers,
    rings_of,
    write_notes,
    write_records,
)
from holdfast.execution.simulation.layout import FORGOTTEN, LATE, RECORDS, Layout, shape_of
from holdfast.execution.simulation.loop import SINGLE, Kind, built_as
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.execution.simulation.settings import Settings, Trajectories
from holdfast.execution.table_in_parts import in_memory

PLACES = ("t", "q", "x", "p")
"""The arguments of a leaf."""


class CppLoopText(LoopText):
    """The text of the functions of a loop; `leaves` prints those that they call."""

    @contextmanager
    def function(self, name: str, *, internal: bool = False) -> Iterator[Instructions]:
        body = CppInstructions(self)
        yield body
        head = f"HF_CALLED void {name}(hf_run r)"
        self.functions.append("\n".join([head, "{", *body.lines, "}"]))

    @property
    def text(self) -> str:
        return "\n\n".join(self.functions) + "\n"


class CppInstructions(Instructions):
    """The instructions of a function; a row is one number."""

    def call(self, leaf: str, *, out: int, t: int = 0, q: int = 0, x: int = 0, p: int = 0) -> None:
        self.text.number(leaf)
        places = ", ".join(self._at(place) for place in (t, q, x, p, out))
        self._line(f"{LEAF}{leaf}({places});")

    def part(self, name: str, number: int) -> None:
        self.text.number(name)
        self._line(f"hf_{name}(r.s, r.w, {number});")

    def function(self, name: str) -> None:
        self._line(f"{name}(r);")

    def copy(self, source: int, target: int, rows: int) -> None:
        self._line(f"hf_copy({self._at(source)}, {self._at(target)}, {rows});")

    def append(self, source: int, rows: int) -> None:
        self._line(f"hf_append(r, &r.s[{LOG}], {self._at(source)}, {rows});")

    def late(self, ring: int, source: int, target: int, rows: int) -> None:
        entry = f"&r.s[{RING + 3 * ring}]"
        self._line(f"hf_late(r, {entry}, {self._at(source)}, {self._at(target)}, {rows});")

    @contextmanager
    def if_any(self, row: int) -> Iterator[None]:
        with self._block(f"if (r.w[{row}] != 0.0)"):
            yield

    @contextmanager
    def while_any(self, row: int) -> Iterator[None]:
        with self._block(f"while (r.w[{row}] != 0.0)"):
            yield

    @contextmanager
    def repeat(self, times: int | str) -> Iterator[None]:
        count = f"n{self._label()}"
        self._line(f"hf_int {count} = {times};")
        self._line("do {")
        yield
        self._line(f"}} while (--{count} > 0);")

    @contextmanager
    def if_positive(self, value: str) -> Iterator[None]:
        with self._block(f"if ({value} > 0)"):
            yield

    def return_unless_any(self, row: int) -> None:
        self._line(f"if (!(r.w[{row}] != 0.0)) return;")

    def entry(self, number: int) -> str:
        return f"r.s[{number}]"

    def one_less(self, value: str) -> str:
        return f"({value} - 1)"

    @contextmanager
    def _block(self, head: str) -> Iterator[None]:
        self._line(f"{head} {{")
        yield
        self._line("}")

    def _at(self, place: int) -> str:
        return f"&r.w[{place}]"


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
        part = slice(begin, min(begin + together, runs))
        many = part.stop - part.start
        per_run = np.empty((len(rows.given), many))
        n, of_plant = starts.shape[1], len(numbers.varied_plant)
        per_run[:n], per_run[n] = starts[part].T, first + np.arange(part.start, part.stop)
        per_run[n + 1 : n + 1 + of_plant] = numbers.own_plant[part].T
        per_run[n + 1 + of_plant :] = numbers.own_gains[part].T
        log = xp.zeros((records, layout.record, many))
        noted = xp.zeros((len(rows.noted), many))
        room = xp.zeros((max(rings, 1), many))
        kernels.run(
            "hf_simulate", device.blocks, np.int64(many), np.int64(many), w, s,
            xp.asarray(per_run), np.int64(records), np.int64(rings), log, room, noted,
        )  # fmt: skip
        notes = device.fetched(noted)
        places = dict(zip(rows.noted, notes, strict=True))
        write_notes(result, places, part, len(program.inputs))
        of_runs = device.fetched(log).transpose(2, 0, 1)[..., np.newaxis]
        done = np.full(many, records)
        write_records(result, layout, of_runs, done, part, 0, safeguarded=program.safeguarded)
        if progress is not None:
            progress(part.stop / runs)


def _rows(layout: Layout, numbers: Numbers) -> _Rows:
    at, counts = layout.at, layout.counts
    per_run = [*range(at["q"], at["q"] + counts["q"]), at["run"]]
    per_run += [at["plant"] + int(k) for k in numbers.varied_plant]
    per_run += [at["gains"] + int(k) for k in numbers.varied_gains]
    noted = {(name, k): at[name] + k for name in NOTED for k in range(counts[name])}
    return _Rows(tuple(per_run), noted)


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
    program: ClosedLoopProgram, kind: Kind, per_run: tuple[int, ...], noted: tuple[int, ...]
) -> str:
    """The kernel `hf_simulate` of a program."""
    shape = shape_of(program, width=1)
    loop = built_as(CppLoopText(1), shape, kind)
    layout, at = loop.layout, loop.layout.at
    by_name = {**loop.leaves, **program.leaves}
    leaves = leaves_cpp({name: by_name[name] for name in loop.called if name in by_name})
    parts = [name.removesuffix(SINGLE) for name in loop.called if name not in by_name]
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
    parsed = scalars("simulation/parts")
    printed = re.sub(r"^static ", "HF_CALLED ", scalars_c(parsed, parts), flags=re.MULTILINE)
    take = [f"    w[{place}] = given[{k} * pitch];" for k, place in enumerate(per_run)]
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
