"""Steps as the text of an LLVM function over columns: eight values of each step at a time.

The function has no calls and no branches but those of rare cases, so that its steps become vector
instructions of the processor. No instruction has a flag that would let LLVM contract or reorder it,
except for leaves that ask for it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from holdfast.execution.arithmetic.steps import (
    FLOAT,
    TRUTH,
    WHOLE,
    Function,
    Step,
    Steps,
    Value,
    in_single,
)

_SAME = "!invariant.load !0"

LANES = 8
"""Values of a step that are computed together: one register of AVX-512, two of AVX2."""


@dataclass(frozen=True)
class Format:
    """How the values of a leaf are computed.

    lanes: of a step; real: their type. fused: whether LLVM may contract a product and a sum.
    """

    lanes: int = LANES
    real: str = "double"
    fused: bool = False

    def vector(self, kind: str) -> str:
        of = {FLOAT: self.real, WHOLE: "i64", TRUTH: "i1"}[kind]
        return f"<{self.lanes} x {of}>"

    def splat(self, of: str, value: str) -> str:
        return f"<{', '.join([f'{of} {value}'] * self.lanes)}>"

    def constant(self, step: Step) -> str:
        if step.kind == WHOLE:
            return self.splat("i64", str(step.given))
        value = step.given
        if self.real == "float":  # written as the double that it is
            value = in_single(value)
        (pattern,) = struct.unpack("<Q", struct.pack("<d", value))
        return self.splat(self.real, f"0x{pattern:016X}")


_TWO = {
    "add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "lt": "fcmp olt", "le": "fcmp ole",
    "eq": "fcmp oeq", "ne": "fcmp une", "both": "and", "either": "or", "iadd": "add",
    "isub": "sub", "imul": "mul", "iand": "and", "ior": "or", "ixor": "xor", "shl": "shl",
    "shr": "lshr", "ieq": "icmp eq",
}  # fmt: skip
_ONE = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "rint": "rint"}


@dataclass
class Module:
    """The functions and tables that the leaves of one text share; double: their usual format."""

    double: Format = Format()
    functions: dict[str, str] = field(default_factory=dict)
    tables: dict[tuple[int, ...], str] = field(default_factory=dict)
    intrinsics: set[str] = field(default_factory=set)
    constants: dict[int, int] = field(default_factory=dict)

    def text(self, bodies: Sequence[str]) -> str:
        """These functions, and what they share."""
        tables = [
            f"{name} = private unnamed_addr constant [{len(table)} x i64] "
            f"[{', '.join(f'i64 {w}' for w in table)}]"
            for table, name in self.tables.items()
        ]
        if self.constants:
            listed = ", ".join(f"i64 {pattern}" for pattern in self.constants)
            count = len(self.constants)
            tables += [
                f"@holdfast.constants = private constant [{count} x i64] [{listed}]",
                "@holdfast.where = private global ptr @holdfast.constants",
                "!0 = !{}",
            ]
        return (
            "\n\n".join([*tables, *self.functions.values(), *bodies, *sorted(self.intrinsics)])
            + "\n"
        )


def repeated(kind: Format, name: str, number: str) -> list[str]:
    """A number in every lane."""
    vector, mask = kind.vector(FLOAT), f"<{kind.lanes} x i32> zeroinitializer"
    return [
        f"  {name}.i = insertelement {vector} poison, {kind.real} {number}, i32 0",
        f"  {name} = shufflevector {vector} {name}.i, {vector} poison, {mask}",
    ]


class Body:
    """The lines of the steps that some results need.

    input_names: of the inputs that have one. letter: the first of the names of steps. label: of the
    block of instructions in which the lines begin, then of that in which they end.
    """

    def __init__(
        self,
        module: Module,
        steps: Steps,
        results: Sequence[Value],
        form: Format | None = None,
        input_names: Mapping[str, str] | None = None,
        letter: str = "v",
        read: Mapping[int, str] = MappingProxyType({}),
        label: str = "loop",
    ) -> None:
        self.module, self.steps, self.form = module, steps, form or module.double
        self.given, self.letter = input_names or {}, letter
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.inputs: dict[str, int] = {}
        self.label = label
        self._has_table = False
        for number in steps.needed([v.number for v in results], read):
            if number in read:
                self.names[number], self.inputs[read[number]] = f"%{letter}{number}", number
            else:
                self._print(number, steps.list[number])

    def _constant(self, name: str, value: float) -> None:
        """A constant from the table of the module, which is an operand of instructions then.

        The address of the table is read, so that LLVM does not put the constants into the
        instructions: each would be moved through three registers.
        """
        (pattern,) = struct.unpack("<Q", struct.pack("<d", value))
        place = self.module.constants.setdefault(pattern, len(self.module.constants))
        table = f"%{self.letter}.constants"
        if not self._has_table:
            self._has_table = True
            self.lines.insert(0, f"  {table} = load ptr, ptr @holdfast.where, align 8, {_SAME}")
        self._line(f"{name}.p = getelementptr double, ptr {table}, i64 {place}")
        self._line(f"{name}.d = load double, ptr {name}.p, align 8, {_SAME}")
        self.lines += repeated(self.form, name, f"{name}.d")

    def _print(self, number: int, step: Step) -> None:
        name = self.names[number] = f"%{self.letter}{number}"
        a = [self.names[k] for k in step.arguments]
        form = self.form
        kind = form.vector(step.kind) if step.kind in (FLOAT, WHOLE, TRUTH) else ""
        operation = step.operation
        if operation == "input":
            self.inputs[step.given] = number
            self.names[number] = self.given.get(step.given, name)
        elif operation == "constant":
            if form.real == "double" and step.kind == FLOAT and step.given != 0.0:
                self._constant(name, step.given)
            else:
                self.names[number] = form.constant(step)
        elif operation in _TWO:
            of = form.vector(self.steps.list[step.arguments[0]].kind)
            fused = " contract" if form.fused and operation in ("add", "sub", "mul") else ""
            self._line(f"{name} = {_TWO[operation]}{fused} {of} {a[0]}, {a[1]}")
        elif operation in _ONE:
            bits = 32 if form.real == "float" else 64
            function = f"@llvm.{_ONE[operation]}.v{form.lanes}f{bits}"
            self.module.intrinsics.add(f"declare {kind} {function}({kind})")
            self._line(f"{name} = call {kind} {function}({kind} {a[0]})")
        elif operation == "neg":
            self._line(f"{name} = fneg {kind} {a[0]}")
        elif operation == "not":
            self._line(f"{name} = xor {kind} {a[0]}, {form.splat('i1', 'true')}")
        elif operation in ("bits", "from_bits"):
            of = form.vector(self.steps.list[step.arguments[0]].kind)
            self._line(f"{name} = bitcast {of} {a[0]} to {kind}")
        elif operation == "choose":
            self._line(f"{name} = select {form.vector(TRUTH)} {a[0]}, {kind} {a[1]}, {kind} {a[2]}")
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
        double = self.module.double
        kind, partial = double.vector(WHOLE), "zeroinitializer"
        for lane in range(double.lanes):
            stem = f"{name}.{lane}"
            self._line(f"{stem}.i = extractelement {kind} {place}, i32 {lane}")
            self._line(
                f"{stem}.p = getelementptr [{len(table)} x i64], ptr {where}, i64 0, i64 {stem}.i"
            )
            self._line(f"{stem}.w = load i64, ptr {stem}.p, align 8")
            into = name if lane == double.lanes - 1 else f"{stem}.v"
            self._line(f"{into} = insertelement {kind} {partial}, i64 {stem}.w, i32 {lane}")
            partial = into

    def _rare(self, number: int, a: Sequence[str], step: Step) -> None:
        function: Function = step.given
        double = self.module.double
        count = len(function.kinds)
        when, usual, arguments = a[0], a[1 : 1 + count], a[1 + count :]
        self._function(function)
        kinds = [double.vector(k) for k in function.kinds]
        several, truth = f"{{ {', '.join(kinds)} }}", double.vector(TRUTH)
        reduce = f"@llvm.vector.reduce.or.v{double.lanes}i1"
        self.module.intrinsics.add(f"declare i1 {reduce}({truth})")
        operands = ", ".join(f"{double.vector(FLOAT)} {x}" for x in arguments)
        name, before = f"%{self.letter}{number}", self.label
        self._line(f"{name}.any = call i1 {reduce}({truth} {when})")
        place = f"{self.letter}{number}"
        self._line(f"br i1 {name}.any, label %rare.{place}, label %join.{place}")
        self.lines.append(f"rare.{place}:")
        self._line(f"{name}.all = call {several} @{function.name}({operands})")
        for i, kind in enumerate(kinds):
            self._line(f"{name}.{i}.new = extractvalue {several} {name}.all, {i}")
            self._line(
                f"{name}.{i}.one = select {truth} {when}, {kind} {name}.{i}.new, {kind} {usual[i]}"
            )
        self._line(f"br label %join.{place}")
        self.lines.append(f"join.{place}:")
        for i, kind in enumerate(kinds):
            self._line(
                f"{name}.{i} = phi {kind} [ {usual[i]}, %{before} ], "
                f"[ {name}.{i}.one, %rare.{place} ]"
            )
        self.label = f"join.{place}"

    def _function(self, function: Function) -> None:
        """Define a function of rare cases in the module."""
        if function.name in self.module.functions:
            return
        steps, results = function.traced(expanded=True)
        body, double = Body(self.module, steps, results), self.module.double
        several = f"{{ {', '.join(double.vector(k) for k in function.kinds)} }}"
        inputs = ", ".join(
            f"{double.vector(FLOAT)} %v{body.inputs[p]}" for p in function.parameters
        )
        lines = [
            f"define internal {several} @{function.name}({inputs}) noinline nounwind {{",
            "loop:",
            *body.lines,
        ]
        whole = "poison"
        for i, value in enumerate(results):
            kind = double.vector(function.kinds[i])
            lines.append(
                f"  %r{i} = insertvalue {several} {whole}, {kind} {body.names[value.number]}, {i}"
            )
            whole = f"%r{i}"
        self.module.functions[function.name] = "\n".join([*lines, f"  ret {several} {whole}", "}"])


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
        for row, input_name in enumerate(inputs):
            number = body.inputs.get(input_name)
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
        register = body.names[value.number]
        if stored != kind.real:
            lines.append(
                f"  %o{row}.v = fptrunc {kind.vector(FLOAT)} {register} to {_of(kind, stored)}"
            )
            register = f"%o{row}.v"
        lines.append(
            f"  store {_of(kind, stored)} {register}, ptr %o{row}.at, align {_SIZE[stored]}"
        )
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
    scalar = f"{name}.d"
    lines = [
        f"  {name}.p = getelementptr double, ptr {array}, i64 {row}",
        f"  {scalar} = load double, ptr {name}.p, align 8",
    ]
    if kind.real == "float":
        lines.append(f"  {scalar}f = fptrunc double {scalar} to float")
        scalar += "f"
    return [*lines, *repeated(kind, name, scalar)]
