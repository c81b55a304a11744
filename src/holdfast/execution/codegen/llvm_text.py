"""Steps as the text of an LLVM function over columns: eight values of each step at a time.

The function has no calls and no branches but those of rare cases, so that its steps become vector
instructions of the processor. No instruction has a flag that would let LLVM contract or reorder it,
except for leaves that ask for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value
from holdfast.execution.codegen.llvm_body import LANES, Body, Format, Module, repeated


def leaves_text(leaves: Mapping[str, Leaf], lanes: int = LANES) -> str:
    """The text of a module with these functions, of so many values of a step at a time."""
    module = Module(Format(lanes))
    return module.text([_leaf(module, name, leaf) for name, leaf in leaves.items()])


@dataclass(frozen=True)
class Leaf:
    """A function of columns: row i of an argument is its column `i * stride`, and so of the result.

    All rows of `LANES` values are read before one is written, so that the result may be in place of
    an argument.

    arguments: the names of the arrays, with the inputs of the steps in their rows. results: the
    rows of the array that is filled. uniform: arguments, of doubles, whose rows are one number
    each. single: other arrays are in single precision. algebraic: the steps are arithmetic alone,
    so that they have the precision of the arrays. fused: LLVM may contract a product and a sum.
    read: steps whose values are inputs, by their numbers.
    """

    steps: Steps
    arguments: Mapping[str, Sequence[str]]
    results: Sequence[Value]
    uniform: frozenset[str] = frozenset()
    single: bool = False
    algebraic: bool = False
    fused: bool = False
    read: Mapping[int, str] = field(default_factory=dict)


def _leaf(module: Module, name: str, leaf: Leaf) -> str:
    lanes = module.double.lanes
    kind = Format(lanes, fused=leaf.fused)
    if leaf.single and leaf.algebraic:
        kind = Format(2 * lanes, "float", leaf.fused)
    stored = "float" if leaf.single else "double"
    body = Body(module, leaf.steps, leaf.results, kind, read=leaf.read)
    lines = []
    for array, inputs in leaf.arguments.items():
        for row, given in enumerate(inputs):
            number = body.inputs.get(given)
            if number is None:
                continue
            if array in leaf.uniform:
                lines += _uniform(kind, f"%{array}", row, f"%v{number}")
            else:
                lines += _place(f"%{array}", row, f"i{number}", stored)
                lines += _loaded(kind, stored, f"%i{number}.at", f"%v{number}")
    lines += body.lines
    for row, value in enumerate(leaf.results):
        lines += _place("%out", row, f"o{row}", stored)
        found = body.names[value.number]
        if stored != kind.real:
            lines.append(
                f"  %o{row}.v = fptrunc {kind.vector(FLOAT)} {found} to {_of(kind, stored)}"
            )
            found = f"%o{row}.v"
        lines.append(f"  store {_of(kind, stored)} {found}, ptr %o{row}.at, align {_SIZE[stored]}")
    arrays = "".join(f"ptr %{array}, " for array in leaf.arguments)
    return "\n".join(
        [
            f"define void @{name}({arrays}ptr %out, i64 %stride, i64 %count) nounwind {{",
            "entry:",
            "  br label %loop",
            "loop:",
            f"  %lane = phi i64 [ 0, %entry ], [ %next, %{body.label} ]",
            *lines,
            f"  %next = add nuw nsw i64 %lane, {kind.lanes}",
            "  %more = icmp ult i64 %next, %count",
            "  br i1 %more, label %loop, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )


_SIZE = {"float": 4, "double": 8}


def _of(kind: Format, stored: str) -> str:
    return f"<{kind.lanes} x {stored}>"


def _place(array: str, row: int, name: str, stored: str) -> list[str]:
    return [
        f"  %{name}.row = mul i64 %stride, {row}",
        f"  %{name}.lane = add i64 %{name}.row, %lane",
        f"  %{name}.at = getelementptr {stored}, ptr {array}, i64 %{name}.lane",
    ]


def _loaded(kind: Format, stored: str, place: str, name: str) -> list[str]:
    load = f"load {_of(kind, stored)}, ptr {place}, align {_SIZE[stored]}"
    if stored == kind.real:
        return [f"  {name} = {load}"]
    wide = f"fpext {_of(kind, stored)} {name}.s to {kind.vector(FLOAT)}"
    return [f"  {name}.s = {load}", f"  {name} = {wide}"]


def _uniform(kind: Format, array: str, row: int, name: str) -> list[str]:
    own = f"{name}.d"
    lines = [
        f"  {name}.p = getelementptr double, ptr {array}, i64 {row}",
        f"  {own} = load double, ptr {name}.p, align 8",
    ]
    if kind.real == "float":
        lines.append(f"  {own}f = fptrunc double {own} to float")
        own += "f"
    return [*lines, *repeated(kind, name, own)]
