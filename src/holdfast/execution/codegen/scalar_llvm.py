"""Scalar functions as the text of LLVM, to be optimised before it is compiled."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence

from holdfast.execution.codegen.scalar_functions import (
    ARRAYS,
    ScalarFunction,
    Scalars,
)
from holdfast.execution.codegen.scalar_values import SIZES, Instructions

_DECLARED = (
    "declare double @llvm.sqrt.f64(double)",
    "declare double @llvm.floor.f64(double)",
    "declare double @llvm.fabs.f64(double)",
    "declare float @llvm.fabs.f32(float)",
    "declare void @llvm.memmove.p0.p0.i64(ptr, ptr, i64, i1)",
)


def scalars_text(
    known: Scalars, roots: Sequence[str], *, single: bool = False, fused: bool = False
) -> str:
    """The text of a module of these functions and of those that they call.

    single: whether a `Value`, and an entry of a `Table`, is in single precision. fused: whether
    LLVM may contract a product and a sum.
    """
    functions = known.needed(roots)
    bodies = [
        _Printer(known, f, single=single, fused=fused, own=f.name not in roots).text()
        for f in functions
    ]
    return "\n\n".join([*bodies, *_DECLARED]) + "\n"


class _Printer(Instructions):
    """The statements of a function."""

    def __init__(
        self, known: Scalars, function: ScalarFunction, *, single: bool, fused: bool, own: bool
    ) -> None:
        super().__init__(known, function, single=single, fused=fused)
        self.own = own
        self.loops: list[tuple[str, str]] = []

    def text(self) -> str:
        f = self.function
        arguments = ", ".join(
            f"{self.types[kind]} %a.{name}" for name, kind in f.parameters.items()
        )
        scope = "internal " if self.own else ""
        for name, kind in (f.parameters | f.variables).items():
            self.slots.append(f"  %x.{name} = alloca {self.types[kind]}")
        for name, kind in f.parameters.items():
            self.line(f"store {self.types[kind]} %a.{name}, ptr %x.{name}")
        self._all(f.body)
        of = self.types[f.result]
        end = f"ret {of}" + {"i64": " 0", "i1": " false", "void": ""}.get(of, " 0.0")
        return "\n".join(
            [
                f"define {scope}{self.types[f.result]} @{f.name}({arguments}) nounwind {{",
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
                found = [self.value(v) for v in values]
                for name, value, one in zip(names, values, found, strict=True):
                    self._store(name, one, self.kind(value))
            case ast.Assign(targets=targets, value=value):
                one = self.value(value)
                for target in targets:
                    self._store(target, one, self.kind(value))
            case ast.AugAssign(target=target, op=op, value=value):
                old = self.value(target)
                new, kind = self.binary(op, old, self.kind(target), value)
                self._store(target, new, kind)
            case ast.If(test=test, body=body, orelse=other):
                one, two, end = self.labels("then", "else", "end")
                self.branch(self.truth(test), one, two)
                self._block(one, body, end)
                self._block(two, other, end)
                self.begin(end)
            case ast.While(test=test, body=body):
                head, inside, end = self.labels("head", "body", "end")
                self.jump(head)
                self.begin(head)
                self.branch(self.truth(test), inside, end)
                self._loop(inside, body, head, end)
                self.jump(head)
                self.begin(end)
            case ast.For(target=ast.Name(id=name), iter=ast.Call(args=bounds), body=body):
                self._for(name, bounds, body)
            case ast.Return(value=value):
                if value is None:
                    self.line("ret void")
                else:
                    kind = self.function.result
                    given = self.converted(self.value(value), self.kind(value), kind)
                    self.line(f"ret {self.types[kind]} {given}")
                self.begin(self.labels("after")[0])
            case ast.Expr(value=value):
                self.value(value)
            case ast.Break():
                self.jump(self.loops[-1][1])
                self.begin(self.labels("after")[0])
            case ast.Continue():
                self.jump(self.loops[-1][0])
                self.begin(self.labels("after")[0])

    def _for(self, name: str, bounds: list[ast.expr], body: list[ast.stmt]) -> None:
        head, inside, turn, end = self.labels("head", "body", "turn", "end")
        given = [self.value(b) for b in bounds]
        first, last = (given[0], given[1]) if len(given) > 1 else ("0", given[0])
        step = self.function.number(bounds[2]) if len(bounds) > 2 else 1
        at = self.slot("i64")
        self.line(f"store i64 {first}, ptr {at}")
        self.jump(head)
        self.begin(head)
        now = self.named(f"load i64, ptr {at}")
        goes = "slt" if step == 1 else "sgt"
        self.branch(self.named(f"icmp {goes} i64 {now}, {last}"), inside, end)
        self.loops.append((turn, end))
        self.begin(inside)
        self.line(f"store i64 {now}, ptr %x.{name}")
        self._all(body)
        self.loops.pop()
        self.jump(turn)
        self.begin(turn)
        self.line(f"store i64 {self.named(f'add i64 {now}, {step}')}, ptr {at}")
        self.jump(head)
        self.begin(end)

    def _loop(self, label: str, body: list[ast.stmt], head: str, end: str) -> None:
        self.loops.append((head, end))
        self.begin(label)
        self._all(body)
        self.loops.pop()

    def _block(self, label: str, body: list[ast.stmt], end: str) -> None:
        self.begin(label)
        self._all(body)
        self.jump(end)

    def _store(self, target: ast.expr, value: str, kind: str) -> None:
        if isinstance(target, ast.Name):
            own = self.function.kind(target.id)
            self.line(
                f"store {self.types[own]} {self.converted(value, kind, own)}, ptr %x.{target.id}"
            )
            return
        assert isinstance(target, ast.Subscript)
        assert isinstance(target.value, ast.Name)
        array = self.function.kind(target.value.id)
        found, of = self.converted(value, kind, ARRAYS[array]), self.entry(array)
        if of == "i8":
            found = self.named(f"trunc i64 {found} to i8")
        self.line(f"store {of} {found}, ptr {self.place(target)}, align {SIZES[of]}")
