"""Functions of a simulation loop as C++, for one run at a time: the twin of `loop_text.py`.

The same calls, branches and repetitions in the same order, so that a run has the same bits. w are
the numbers of a run and s its whole numbers, which belong to a thread; its records and its rings
are columns of arrays of all runs, `pitch` numbers apart.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from holdfast.execution.codegen.c_printer import Body, c_functions
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.loop_text import LEAF, LOG, RING, Instructions, LoopText
from holdfast.execution.codegen.lowering import FUNCTIONS

PLACES = ("t", "q", "x", "p")
"""The arguments of a leaf."""


class CppLoopText(LoopText):
    """The text of the functions of a loop; `leaves` prints those that they call."""

    @contextmanager
    def function(self, name: str, *, own: bool = False) -> Iterator[Instructions]:
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
    known = {n: f"{a}[{k}]" for a, names in leaf.arguments.items() for k, n in enumerate(names)}
    given = {n: place.replace("[", "_").replace("]", "") for n, place in known.items()}
    body = Body(
        leaf.steps, leaf.results, "    ", read={k: given[n] for k, n in leaf.read.items()},
        inputs=given,
    )  # fmt: skip
    texts = [body.text(v.number) for v in leaf.results]
    lines = [*body.lines, *(f"    const double o_{i} = {text};" for i, text in enumerate(texts))]
    lines += [f"    out[{i}] = o_{i};" for i in range(len(texts))]
    whole = "\n".join(lines)
    used = [n for n, own in given.items() if _names(own, whole)]
    read = [f"    const double {given[n]} = {known[n]};" for n in used]
    arguments = ", ".join(f"const double *{a}" for a in PLACES)
    head = f"HF_CALLED void {LEAF}{name}({arguments}, double *out)"
    return "\n".join([head, "{", *read, *lines, "}"])


def _names(name: str, text: str) -> bool:
    """Whether a text has a name as a whole word."""
    return re.search(rf"\b{re.escape(name)}\b", text) is not None
