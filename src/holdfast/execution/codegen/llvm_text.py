"""Steps as the text of an LLVM function over columns: eight values of each step at a time.

The function has no calls and no branches but those of rare cases, so that its steps become vector
instructions of the processor. No instruction has a flag that would let LLVM contract or reorder it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from holdfast.execution.arithmetic.steps import FLOAT, TRUTH, WHOLE, Function, Step, Steps, Value

LANES = 8
"""Values of a step that are computed together: one register of AVX-512, two of AVX2."""

_VECTOR = {
    FLOAT: f"<{LANES} x double>",
    WHOLE: f"<{LANES} x i64>",
    TRUTH: f"<{LANES} x i1>",
}
_TWO = {
    "add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "lt": "fcmp olt", "le": "fcmp ole",
    "eq": "fcmp oeq", "ne": "fcmp une", "both": "and", "either": "or", "iadd": "add",
    "isub": "sub", "imul": "mul", "iand": "and", "ior": "or", "ixor": "xor", "shl": "shl",
    "shr": "lshr", "ieq": "icmp eq",
}  # fmt: skip
_ONE = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "rint": "rint"}


@dataclass
class _Module:
    """The functions and tables that the leaves of one text share."""

    functions: dict[str, str] = field(default_factory=dict)
    tables: dict[tuple[int, ...], str] = field(default_factory=dict)
    intrinsics: set[str] = field(default_factory=set)


def leaves_text(leaves: Mapping[str, Leaf]) -> str:
    """The text of a module with these functions."""
    module = _Module()
    bodies = [_leaf(module, name, leaf) for name, leaf in leaves.items()]
    tables = [
        f"{name} = private unnamed_addr constant [{len(table)} x i64] "
        f"[{', '.join(f'i64 {w}' for w in table)}]"
        for table, name in module.tables.items()
    ]
    return (
        "\n\n".join([*tables, *module.functions.values(), *bodies, *sorted(module.intrinsics)])
        + "\n"
    )


@dataclass(frozen=True)
class Leaf:
    """A function of columns: row i of an argument is its column `i * stride`, and so of the result.

    All rows of `LANES` values are read before one is written, so that the result may be in place of
    an argument.

    arguments: the names of the arrays, with the inputs of the steps in their rows. results: the
    rows of the array that is filled.
    """

    steps: Steps
    arguments: Mapping[str, Sequence[str]]
    results: Sequence[Value]


def _leaf(module: _Module, name: str, leaf: Leaf) -> str:
    body = _Body(module, leaf.steps, leaf.results)
    lines = []
    for array, inputs in leaf.arguments.items():
        for row, given in enumerate(inputs):
            number = body.inputs.get(given)
            if number is not None:
                lines += _place(f"%{array}", row, f"i{number}")
                lines.append(f"  %v{number} = load {_VECTOR[FLOAT]}, ptr %i{number}.at, align 8")
    lines += body.lines
    for row, value in enumerate(leaf.results):
        lines += _place("%out", row, f"o{row}")
        lines.append(
            f"  store {_VECTOR[FLOAT]} {body.names[value.number]}, ptr %o{row}.at, align 8"
        )
    arrays = "".join(f"ptr %{array}, " for array in leaf.arguments)
    return "\n".join(
        [
            f"define void @{name}({arrays}ptr %out, i64 %stride) nounwind {{",
            "entry:",
            "  br label %loop",
            "loop:",
            f"  %lane = phi i64 [ 0, %entry ], [ %next, %{body.label} ]",
            *lines,
            f"  %next = add nuw nsw i64 %lane, {LANES}",
            "  %more = icmp ult i64 %next, %stride",
            "  br i1 %more, label %loop, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )


def _place(array: str, row: int, name: str) -> list[str]:
    return [
        f"  %{name}.row = mul i64 %stride, {row}",
        f"  %{name}.lane = add i64 %{name}.row, %lane",
        f"  %{name}.at = getelementptr double, ptr {array}, i64 %{name}.lane",
    ]


class _Body:
    """The lines of the steps that some results need."""

    def __init__(self, module: _Module, steps: Steps, results: Sequence[Value]) -> None:
        self.module, self.steps = module, steps
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.inputs: dict[str, int] = {}
        self.label = "loop"
        for number in steps.needed([v.number for v in results]):
            self._print(number, steps.list[number])

    def _print(self, number: int, step: Step) -> None:
        name = self.names[number] = f"%v{number}"
        a = [self.names[k] for k in step.arguments]
        kind = _VECTOR.get(step.kind, "")
        operation = step.operation
        if operation == "input":
            self.inputs[step.given] = number
        elif operation == "constant":
            self.names[number] = _constant(step)
        elif operation in _TWO:
            of = _VECTOR[self.steps.list[step.arguments[0]].kind]
            self._line(f"{name} = {_TWO[operation]} {of} {a[0]}, {a[1]}")
        elif operation in _ONE:
            function = f"@llvm.{_ONE[operation]}.v{LANES}f64"
            self.module.intrinsics.add(f"declare {kind} {function}({kind})")
            self._line(f"{name} = call {kind} {function}({kind} {a[0]})")
        elif operation == "neg":
            self._line(f"{name} = fneg {kind} {a[0]}")
        elif operation == "not":
            self._line(f"{name} = xor {kind} {a[0]}, {_splat('i1', 'true')}")
        elif operation in ("bits", "from_bits"):
            of = _VECTOR[self.steps.list[step.arguments[0]].kind]
            self._line(f"{name} = bitcast {of} {a[0]} to {kind}")
        elif operation == "choose":
            self._line(f"{name} = select {_VECTOR[TRUTH]} {a[0]}, {kind} {a[1]}, {kind} {a[2]}")
        elif operation == "entry":
            self._entry(name, a[0], step.given)
        elif operation == "rare":
            self._rare(number, a, step)
        elif operation == "result":
            self.names[number] = f"{a[0]}.{step.given}"
        else:
            raise ValueError(operation)

    def _line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def _entry(self, name: str, place: str, table: tuple[int, ...]) -> None:
        where = self.module.tables.setdefault(table, f"@table{len(self.module.tables)}")
        kind, found = _VECTOR[WHOLE], "zeroinitializer"
        for lane in range(LANES):
            own = f"{name}.{lane}"
            self._line(f"{own}.i = extractelement {kind} {place}, i32 {lane}")
            self._line(
                f"{own}.p = getelementptr [{len(table)} x i64], ptr {where}, i64 0, i64 {own}.i"
            )
            self._line(f"{own}.w = load i64, ptr {own}.p, align 8")
            into = name if lane == LANES - 1 else f"{own}.v"
            self._line(f"{into} = insertelement {kind} {found}, i64 {own}.w, i32 {lane}")
            found = into

    def _rare(self, number: int, a: Sequence[str], step: Step) -> None:
        function: Function = step.given
        count = len(function.kinds)
        when, usual, arguments = a[0], a[1 : 1 + count], a[1 + count :]
        self._function(function)
        kinds = [_VECTOR[k] for k in function.kinds]
        several, truth = f"{{ {', '.join(kinds)} }}", _VECTOR[TRUTH]
        reduce = f"@llvm.vector.reduce.or.v{LANES}i1"
        self.module.intrinsics.add(f"declare i1 {reduce}({truth})")
        given = ", ".join(f"{_VECTOR[FLOAT]} {x}" for x in arguments)
        own, before = f"%v{number}", self.label
        self._line(f"{own}.any = call i1 {reduce}({truth} {when})")
        self._line(f"br i1 {own}.any, label %rare{number}, label %join{number}")
        self.lines.append(f"rare{number}:")
        self._line(f"{own}.all = call {several} @{function.name}({given})")
        for i, kind in enumerate(kinds):
            self._line(f"{own}.{i}.new = extractvalue {several} {own}.all, {i}")
            self._line(
                f"{own}.{i}.one = select {truth} {when}, {kind} {own}.{i}.new, {kind} {usual[i]}"
            )
        self._line(f"br label %join{number}")
        self.lines.append(f"join{number}:")
        for i, kind in enumerate(kinds):
            self._line(
                f"{own}.{i} = phi {kind} [ {usual[i]}, %{before} ], "
                f"[ {own}.{i}.one, %rare{number} ]"
            )
        self.label = f"join{number}"

    def _function(self, function: Function) -> None:
        """Define a function of rare cases in the module."""
        if function.name in self.module.functions:
            return
        steps, results = function.traced(expanded=True)
        body = _Body(self.module, steps, results)
        several = f"{{ {', '.join(_VECTOR[k] for k in function.kinds)} }}"
        inputs = ", ".join(f"{_VECTOR[FLOAT]} %v{body.inputs[p]}" for p in function.parameters)
        lines = [
            f"define internal {several} @{function.name}({inputs}) noinline nounwind {{",
            "loop:",
            *body.lines,
        ]
        whole = "poison"
        for i, value in enumerate(results):
            kind = _VECTOR[function.kinds[i]]
            lines.append(
                f"  %r{i} = insertvalue {several} {whole}, {kind} {body.names[value.number]}, {i}"
            )
            whole = f"%r{i}"
        self.module.functions[function.name] = "\n".join([*lines, f"  ret {several} {whole}", "}"])


def _constant(step: Step) -> str:
    if step.kind == WHOLE:
        return _splat("i64", str(step.given))
    (pattern,) = struct.unpack("<Q", struct.pack("<d", step.given))
    return _splat("double", f"0x{pattern:016X}")


def _splat(kind: str, value: str) -> str:
    return f"<{', '.join([f'{kind} {value}'] * LANES)}>"
