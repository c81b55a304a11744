"""Functions of a simulation loop as the text of LLVM: calls of leaves, branches and repetitions.

Such a function has the arguments `w`, the numbers of a block of runs; `s`, whole numbers of the
block; `leaves`, the addresses of leaves and parts; and `stop`, which another thread may set.
A row is `width` values of w, one for each run of the block; a flag is a row of 1 and 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

WIDTH = 16
"""Runs that advance together, the lanes of a block, on a processor with wide registers."""

LOG, LANES_OF_BLOCK, RING = 0, 1, 2
"""Entries of s: the place in w of the next row of the log; the width; from RING on three for each
ring: the next slot, the number of slots, and the place of the first."""

LEAF = "leaf_"
"""How the name of a leaf begins where it is called by its name."""

ARGUMENTS = "ptr %w, ptr %s, ptr %leaves, ptr %stop"


class LoopText:
    """The text of the functions of one loop; `called` are the leaves and parts, in the order of
    their addresses. direct: they are called by their names, as functions of the same module."""

    def __init__(self, width: int, *, direct: bool = False) -> None:
        self.width, self.direct = width, direct
        self.called: list[str] = []
        self.functions: list[str] = []

    @contextmanager
    def function(self, name: str, *, internal: bool = False) -> Iterator[Instructions]:
        """A function to be filled; `internal`: only functions of this text call it."""
        body = Instructions(self)
        yield body
        head = f"define {'internal ' if internal else ''}void @{name}({ARGUMENTS}) nounwind {{"
        lines = ["entry:", *body.counters, *body.lines, "  ret void", "}"]
        self.functions.append("\n".join([head, *lines]))

    @property
    def text(self) -> str:
        return "\n\n".join([*self.functions, f"declare void @{_COPY}(ptr, ptr, i64, i1)"]) + "\n"

    def number(self, name: str) -> int:
        """The place of the address of a leaf or a part."""
        if name not in self.called:
            self.called.append(name)
        return self.called.index(name)


class Instructions:
    """The instructions of a function, in order. Arguments named after rows are places in w."""

    def __init__(self, text: LoopText) -> None:
        self.text, self.width = text, text.width
        self.lines: list[str] = []
        self.counters: list[str] = []
        self._values = 0

    def call(self, leaf: str, *, out: int, t: int = 0, q: int = 0, x: int = 0, p: int = 0) -> None:
        """Call a leaf with the places of its arguments and of its results."""
        places = ", ".join(f"ptr {self._at(place)}" for place in (t, q, x, p, out))
        self._line(
            f"call void {self._address(leaf, LEAF)}({places}, i64 {self.width}, i64 {self.width})"
        )

    def part(self, name: str, number: int) -> None:
        """Call a part, a function of s, w and the place in s of what belongs to it."""
        self._line(f"call void {self._address(name)}(ptr %s, ptr %w, i64 {number})")

    def function(self, name: str) -> None:
        """Call a function of the same text."""
        self._line(f"call void @{name}(ptr %w, ptr %s, ptr %leaves, ptr %stop)")

    def copy(self, source: int, target: int, rows: int) -> None:
        """w[target...] = w[source...]."""
        self._copied(self._at(source), self._at(target), rows)

    def append(self, source: int, rows: int) -> None:
        """Copy rows to the log."""
        entry = self._entry(LOG)
        place = self._value(f"load i64, ptr {entry}")
        self._copied(self._at(source), self._pointer(place), rows)
        self._line(f"store i64 {self._value(f'add i64 {place}, {rows * self.width}')}, ptr {entry}")

    def late(self, ring: int, source: int, target: int, rows: int) -> None:
        """Store rows in a ring; the oldest rows of it to `target`."""
        at, slots, first = (self._entry(RING + 3 * ring + i) for i in range(3))
        start = self._value(f"load i64, ptr {first}")

        def slot(number: str) -> str:
            offset = self._value(f"mul i64 {number}, {rows * self.width}")
            return self._pointer(self._value(f"add i64 {start}, {offset}"))

        now, count = self._value(f"load i64, ptr {at}"), self._value(f"load i64, ptr {slots}")
        self._copied(self._at(source), slot(now), rows)
        after = self._value(f"add i64 {now}, 1")
        ends = self._value(f"icmp eq i64 {after}, {count}")
        oldest = self._value(f"select i1 {ends}, i64 0, i64 {after}")
        self._line(f"store i64 {oldest}, ptr {at}")
        self._copied(slot(oldest), self._at(target), rows)

    @contextmanager
    def if_any(self, row: int) -> Iterator[None]:
        """What follows only if the row has a value that is not 0."""
        label = self._label()
        self._line(f"br i1 {self._any(row)}, label %then{label}, label %end{label}")
        self._begin(f"then{label}")
        yield
        self._jump(f"end{label}")

    @contextmanager
    def while_any(self, row: int) -> Iterator[None]:
        """What follows as long as the row has a value that is not 0, and nobody stops the loop."""
        label = self._label()
        self._jump(f"head{label}")
        goes = self._value(f"and i1 {self._any(row)}, {self._going()}")
        self._line(f"br i1 {goes}, label %then{label}, label %end{label}")
        self._begin(f"then{label}")
        yield
        self._line(f"br label %head{label}")
        self._begin(f"end{label}")

    @contextmanager
    def repeat(self, times: int | str) -> Iterator[None]:
        """What follows so many times, at least once; `times` may be a value from `entry`."""
        label = self._label()
        self.counters.append(f"  %count{label} = alloca i64")
        self._line(f"store i64 {times}, ptr %count{label}")
        self._jump(f"then{label}")
        yield
        left = self._value(f"load i64, ptr %count{label}")
        fewer = self._value(f"sub i64 {left}, 1")
        self._line(f"store i64 {fewer}, ptr %count{label}")
        more = self._value(f"icmp sgt i64 {fewer}, 0")
        self._line(f"br i1 {more}, label %then{label}, label %end{label}")
        self._begin(f"end{label}")

    @contextmanager
    def if_positive(self, value: str) -> Iterator[None]:
        """What follows only if a whole number is above 0."""
        label = self._label()
        above = self._value(f"icmp sgt i64 {value}, 0")
        self._line(f"br i1 {above}, label %then{label}, label %end{label}")
        self._begin(f"then{label}")
        yield
        self._jump(f"end{label}")

    def return_unless_any(self, row: int) -> None:
        """Leave the function where the row is 0, or the loop is stopped."""
        label = self._label()
        goes = self._value(f"and i1 {self._any(row)}, {self._going()}")
        self._line(f"br i1 {goes}, label %then{label}, label %end{label}")
        self._begin(f"end{label}")
        self._line("ret void")
        self._begin(f"then{label}")

    def entry(self, number: int) -> str:
        """The value of an entry of s."""
        return self._value(f"load i64, ptr {self._entry(number)}")

    def one_less(self, value: str) -> str:
        return self._value(f"sub i64 {value}, 1")

    def _any(self, row: int) -> str:
        row_of, truths = f"<{self.width} x double>", f"i{self.width}"
        loaded = self._value(f"load {row_of}, ptr {self._at(row)}, align 8")
        flags = self._value(f"fcmp une {row_of} {loaded}, zeroinitializer")
        whole = self._value(f"bitcast <{self.width} x i1> {flags} to {truths}")
        return self._value(f"icmp ne {truths} {whole}, 0")

    def _going(self) -> str:
        stopped = self._value("load volatile i64, ptr %stop")
        return self._value(f"icmp eq i64 {stopped}, 0")

    def _address(self, name: str, kind: str = "") -> str:
        number = self.text.number(name)
        if self.text.direct:
            return f"@{kind}{name}"
        place = self._value(f"getelementptr i64, ptr %leaves, i64 {number}")
        return self._value(f"load ptr, ptr {place}")

    def _copied(self, source: str, target: str, rows: int) -> None:
        size = 8 * self.width * rows
        self._line(f"call void @{_COPY}(ptr {target}, ptr {source}, i64 {size}, i1 false)")

    def _at(self, place: int) -> str:
        return self._pointer(str(place))

    def _pointer(self, place: str) -> str:
        return self._value(f"getelementptr double, ptr %w, i64 {place}")

    def _entry(self, number: int) -> str:
        return self._value(f"getelementptr i64, ptr %s, i64 {number}")

    def _value(self, text: str) -> str:
        self._values += 1
        name = f"%v{self._values}"
        self._line(f"{name} = {text}")
        return name

    def _label(self) -> int:
        self._values += 1
        return self._values

    def _jump(self, label: str) -> None:
        self._line(f"br label %{label}")
        self._begin(label)

    def _begin(self, label: str) -> None:
        self.lines.append(f"{label}:")

    def _line(self, text: str) -> None:
        self.lines.append(f"  {text}")


_COPY = "llvm.memmove.p0.p0.i64"
