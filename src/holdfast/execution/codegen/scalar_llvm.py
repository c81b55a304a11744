"""Scalar functions as the text of LLVM, to be optimised before it is compiled."""

from __future__ import annotations

import ast
import math
import struct
from collections.abc import Iterable, Sequence

from holdfast.execution.codegen.scalar_functions import (
    ARRAYS,
    BOOL,
    FLOAT,
    INT,
    NONE,
    TABLE,
    ScalarFunction,
    Scalars,
    constant,
)

_TYPES = {INT: "i64", FLOAT: "double", BOOL: "i1", NONE: "void"}
_TESTS = {
    ast.Lt: ("slt", "olt"), ast.LtE: ("sle", "ole"), ast.Gt: ("sgt", "ogt"),
    ast.GtE: ("sge", "oge"), ast.Eq: ("eq", "oeq"), ast.NotEq: ("ne", "une"),
}  # fmt: skip
_ARITHMETIC = {
    ast.Add: ("add", "fadd"), ast.Sub: ("sub", "fsub"), ast.Mult: ("mul", "fmul"),
    ast.Div: ("", "fdiv"), ast.Mod: ("srem", ""), ast.RShift: ("ashr", ""),
    ast.LShift: ("shl", ""), ast.BitAnd: ("and", ""),
}  # fmt: skip
_DECLARED = {
    "sqrt": "declare double @llvm.sqrt.f64(double)",
    "floor": "declare double @llvm.floor.f64(double)",
    "fabs": "declare double @llvm.fabs.f64(double)",
}


def scalars_text(known: Scalars, roots: Sequence[str], *, single: bool = False) -> str:
    """The text of a module of these functions and of those that they call.

    single: whether a `Table` is stored in single precision.
    """
    functions = known.needed(roots)
    bodies = [_Printer(known, f, single=single, own=f.name not in roots).text() for f in functions]
    return "\n\n".join([*bodies, *_DECLARED.values()]) + "\n"


def _type(kind: str) -> str:
    return "ptr" if kind in ARRAYS else _TYPES[kind]


class _Printer:
    def __init__(
        self, known: Scalars, function: ScalarFunction, *, single: bool, own: bool
    ) -> None:
        self.known, self.function, self.single, self.own = known, function, single, own
        self.lines: list[str] = []
        self.slots: list[str] = []
        self.count = 0
        self.loops: list[tuple[str, str]] = []

    def text(self) -> str:
        f = self.function
        arguments = ", ".join(f"{_type(kind)} %a.{name}" for name, kind in f.parameters.items())
        scope = "internal " if self.own else ""
        for name, kind in (f.parameters | f.variables).items():
            self.slots.append(f"  %x.{name} = alloca {_type(kind)}")
        for name, kind in f.parameters.items():
            self._line(f"store {_type(kind)} %a.{name}, ptr %x.{name}")
        self._all(f.body)
        end = f"ret {_TYPES[f.result]}"
        end += {"i64": " 0", "double": " 0.0", "i1": " false", "void": ""}[_TYPES[f.result]]
        return "\n".join(
            [
                f"define {scope}{_TYPES[f.result]} @{f.name}({arguments}) nounwind {{",
                "entry:",
                *self.slots,
                *self.lines,
                f"  {end}",
                "}",
            ]
        )

    # -- statements

    def _all(self, statements: Iterable[ast.stmt]) -> None:
        for one in statements:
            self._statement(one)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                found = [self._value(v) for v in values]
                for name, value, one in zip(names, values, found, strict=True):
                    self._store(name, one, self._kind(value))
            case ast.Assign(targets=targets, value=value):
                one = self._value(value)
                for target in targets:
                    self._store(target, one, self._kind(value))
            case ast.AugAssign(target=target, op=op, value=value):
                old = self._value(target)
                new, kind = self._binary(op, old, self._kind(target), value)
                self._store(target, new, kind)
            case ast.If(test=test, body=body, orelse=other):
                one, two, end = self._labels("then", "else", "end")
                self._branch(self._truth(test), one, two)
                self._block(one, body, end)
                self._block(two, other, end)
                self._begin(end)
            case ast.While(test=test, body=body):
                head, inside, end = self._labels("head", "body", "end")
                self._jump(head)
                self._begin(head)
                self._branch(self._truth(test), inside, end)
                self._loop(inside, body, head, end)
                self._jump(head)
                self._begin(end)
            case ast.For(target=ast.Name(id=name), iter=ast.Call(args=bounds), body=body):
                self._for(name, bounds, body)
            case ast.Return(value=value):
                if value is None:
                    self._line("ret void")
                else:
                    kind = self.function.result
                    given = self._as(self._value(value), self._kind(value), kind)
                    self._line(f"ret {_TYPES[kind]} {given}")
                self._begin(self._labels("after")[0])
            case ast.Expr(value=value):
                self._value(value)
            case ast.Break():
                self._jump(self.loops[-1][1])
                self._begin(self._labels("after")[0])
            case ast.Continue():
                self._jump(self.loops[-1][0])
                self._begin(self._labels("after")[0])

    def _for(self, name: str, bounds: list[ast.expr], body: list[ast.stmt]) -> None:
        head, inside, turn, end = self._labels("head", "body", "turn", "end")
        given = [self._value(b) for b in bounds]
        first, last = (given[0], given[1]) if len(given) > 1 else ("0", given[0])
        at = self._slot("i64")
        self._line(f"store i64 {first}, ptr {at}")
        self._jump(head)
        self._begin(head)
        now = self._named(f"load i64, ptr {at}")
        self._branch(self._named(f"icmp slt i64 {now}, {last}"), inside, end)
        self.loops.append((turn, end))
        self._begin(inside)
        self._line(f"store i64 {now}, ptr %x.{name}")
        self._all(body)
        self.loops.pop()
        self._jump(turn)
        self._begin(turn)
        self._line(f"store i64 {self._named(f'add i64 {now}, 1')}, ptr {at}")
        self._jump(head)
        self._begin(end)

    def _loop(self, label: str, body: list[ast.stmt], head: str, end: str) -> None:
        self.loops.append((head, end))
        self._begin(label)
        self._all(body)
        self.loops.pop()

    def _block(self, label: str, body: list[ast.stmt], end: str) -> None:
        self._begin(label)
        self._all(body)
        self._jump(end)

    def _store(self, target: ast.expr, value: str, kind: str) -> None:
        if isinstance(target, ast.Name):
            own = self.function.kind(target.id)
            self._line(f"store {_type(own)} {self._as(value, kind, own)}, ptr %x.{target.id}")
            return
        assert isinstance(target, ast.Subscript)
        assert isinstance(target.value, ast.Name)
        own = ARRAYS[self.function.kind(target.value.id)]
        found = self._as(value, kind, own)
        self._line(f"store {_TYPES[own]} {found}, ptr {self._place(target)}, align 8")

    # -- expressions

    def _kind(self, node: ast.expr) -> str:
        return self.function.kinds[node]

    def _value(self, node: ast.expr) -> str:
        kind = self._kind(node)
        if isinstance(node, ast.Constant) and isinstance(node.value, bool):
            return "true" if node.value else "false"
        local = isinstance(node, ast.Name) and (
            node.id in self.function.variables or node.id in self.function.parameters
        )
        value = None if local else constant(node, self.function.constants)
        if value is not None:
            return str(value) if kind == INT else _hexadecimal(float(value))
        match node:
            case ast.Name(id=name):
                return self._named(f"load {_type(kind)}, ptr %x.{name}")
            case ast.Subscript(slice=ast.Slice()):
                return self._place(node)
            case ast.Subscript(value=ast.Name(id=name)):
                place = self._place(node)
                if self.function.kind(name) == TABLE and self.single:
                    found = self._named(f"load float, ptr {place}, align 4")
                    return self._named(f"fpext float {found} to double")
                return self._named(f"load {_TYPES[kind]}, ptr {place}, align 8")
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self._value(left), self._kind(left), right)[0]
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return self._named(f"xor i1 {self._truth(inner)}, true")
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                given = self._value(inner)
                return self._named(f"sub i64 0, {given}" if kind == INT else f"fneg double {given}")
            case ast.Compare(left=left, ops=tests, comparators=others):
                return self._compared(left, tests, others)
            case ast.BoolOp(op=op, values=values):
                return self._joined(isinstance(op, ast.And), values)
            case ast.IfExp(test=test, body=a, orelse=b):
                return self._chosen(kind, test, a, b)
            case ast.Call(args=arguments):
                return self._called(self.function.calls[node], kind, arguments)
        raise AssertionError(ast.dump(node))

    def _binary(self, op: ast.operator, left: str, kind: str, right: ast.expr) -> tuple[str, str]:
        other, of = self._value(right), self._kind(right)
        real = FLOAT in (kind, of) or isinstance(op, ast.Div)
        own = FLOAT if real else INT
        a, b = self._as(left, kind, own), self._as(other, of, own)
        return self._named(f"{_ARITHMETIC[type(op)][real]} {_TYPES[own]} {a}, {b}"), own

    def _compared(
        self, left: ast.expr, tests: Sequence[ast.cmpop], others: Sequence[ast.expr]
    ) -> str:
        values = [(self._value(one), self._kind(one)) for one in (left, *others)]
        found = ""
        for (a, ka), test, (b, kb) in zip(values, tests, values[1:], strict=False):
            real = FLOAT in (ka, kb)
            kind = FLOAT if real else INT
            text = f"{'fcmp' if real else 'icmp'} {_TESTS[type(test)][real]} {_TYPES[kind]}"
            one = self._named(f"{text} {self._as(a, ka, kind)}, {self._as(b, kb, kind)}")
            found = self._named(f"and i1 {found}, {one}") if found else one
        return found

    def _joined(self, every: bool, values: Sequence[ast.expr]) -> str:
        at, (end,) = self._slot("i1"), self._labels("end")
        for one in values:
            found, (more,) = self._truth(one), self._labels("more")
            self._line(f"store i1 {found}, ptr {at}")
            self._branch(found, *((more, end) if every else (end, more)))
            self._begin(more)
        self._jump(end)
        self._begin(end)
        return self._named(f"load i1, ptr {at}")

    def _chosen(self, kind: str, test: ast.expr, a: ast.expr, b: ast.expr) -> str:
        at, (one, two, end) = self._slot(_type(kind)), self._labels("one", "two", "end")
        self._branch(self._truth(test), one, two)
        for label, node in ((one, a), (two, b)):
            self._begin(label)
            value = self._as(self._value(node), self._kind(node), kind)
            self._line(f"store {_type(kind)} {value}, ptr {at}")
            self._jump(end)
        self._begin(end)
        return self._named(f"load {_type(kind)}, ptr {at}")

    def _called(self, name: str, kind: str, arguments: Sequence[ast.expr]) -> str:
        values = [self._value(a) for a in arguments]
        kinds = [self._kind(a) for a in arguments]
        if name in self.known.functions:
            called = self.known.functions[name]
            given = ", ".join(
                f"{_type(own)} {self._as(v, k, own)}"
                for v, k, own in zip(values, kinds, called.parameters.values(), strict=True)
            )
            text = f"call {_TYPES[called.result]} @{name}({given})"
            if called.result != NONE:
                return self._named(text)
            self._line(text)
            return ""
        wanted = kind if name in ("abs", "min", "max") else FLOAT
        if name not in ("int", "table_at"):
            values = [self._as(v, k, wanted) for v, k in zip(values, kinds, strict=True)]
        match name:
            case "float":
                return values[0]
            case "int":
                return self._whole(values[0], kinds[0])
            case "math.sqrt" | "math.floor":
                return self._named(f"call double @llvm.{name[5:]}.f64(double {values[0]})")
            case "abs" if kind == FLOAT:
                return self._named(f"call double @llvm.fabs.f64(double {values[0]})")
            case "math.isnan":
                return self._named(f"fcmp uno double {values[0]}, 0.0")
            case "math.isfinite":
                size = self._named(f"call double @llvm.fabs.f64(double {values[0]})")
                return self._named(f"fcmp olt double {size}, {_hexadecimal(math.inf)}")
            case "table_at":
                return self._named(f"inttoptr i64 {values[0]} to ptr")
            case "min" | "max":  # as in Python: the first, unless the second is beyond it
                test = {"min": ("slt", "olt"), "max": ("sgt", "ogt")}[name][kind == FLOAT]
                compare = "fcmp" if kind == FLOAT else "icmp"
                beyond = self._named(f"{compare} {test} {_TYPES[kind]} {values[1]}, {values[0]}")
                of = _TYPES[kind]
                return self._named(f"select i1 {beyond}, {of} {values[1]}, {of} {values[0]}")
        raise AssertionError(name)

    def _whole(self, value: str, kind: str) -> str:
        return value if kind == INT else self._named(f"fptosi double {value} to i64")

    def _truth(self, node: ast.expr) -> str:
        value = self._value(node)
        return self._named(f"icmp ne i64 {value}, 0") if self._kind(node) == INT else value

    def _as(self, value: str, kind: str, wanted: str) -> str:
        if kind == INT and wanted == FLOAT:
            return self._named(f"sitofp i64 {value} to double")
        assert kind == wanted, (self.function.name, value, kind, wanted)
        return value

    def _place(self, node: ast.expr) -> str:
        assert isinstance(node, ast.Subscript)
        assert isinstance(node.value, ast.Name)
        array = self._named(f"load ptr, ptr %x.{node.value.id}")
        index = node.slice.lower if isinstance(node.slice, ast.Slice) else node.slice
        if index is None:
            return array
        kind = self.function.kind(node.value.id)
        of = "float" if kind == TABLE and self.single else _TYPES[ARRAYS[kind]]
        return self._named(f"getelementptr {of}, ptr {array}, i64 {self._value(index)}")

    # -- lines

    def _slot(self, of: str) -> str:
        """A place on the stack, which belongs to the whole function."""
        self.count += 1
        self.slots.append(f"  %s{self.count} = alloca {of}")
        return f"%s{self.count}"

    def _named(self, text: str) -> str:
        self.count += 1
        self._line(f"%v{self.count} = {text}")
        return f"%v{self.count}"

    def _labels(self, *names: str) -> list[str]:
        self.count += 1
        return [f"{name}.{self.count}" for name in names]

    def _branch(self, condition: str, one: str, two: str) -> None:
        self._line(f"br i1 {condition}, label %{one}, label %{two}")

    def _jump(self, label: str) -> None:
        self._line(f"br label %{label}")

    def _begin(self, label: str) -> None:
        self.lines.append(f"{label}:")

    def _line(self, text: str) -> None:
        self.lines.append(f"  {text}")


def _hexadecimal(value: float) -> str:
    (pattern,) = struct.unpack("<Q", struct.pack("<d", value))
    return f"0x{pattern:016X}"
