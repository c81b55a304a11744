"""Scalar functions as the text of LLVM, optimised and compiled: machine code, called from Python.

Other machine code calls them through their addresses.
"""

from __future__ import annotations

import ast
import ctypes
import math
import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from holdfast.execution.codegen.scalar_reader import (
    ARRAYS,
    BOOL,
    FLAGS,
    FLOAT,
    FLOATS,
    INT,
    MACHINE,
    NONE,
    TABLE,
    VALUE,
    WHOLES,
    ScalarFunction,
    Scalars,
    common,
    scalars,
)
from holdfast.execution.leaf import Machine, compiled_text

_TESTS = {
    ast.Lt: ("slt", "olt"), ast.LtE: ("sle", "ole"), ast.Gt: ("sgt", "ogt"),
    ast.GtE: ("sge", "oge"), ast.Eq: ("eq", "oeq"), ast.NotEq: ("ne", "une"),
}  # fmt: skip
_ARITHMETIC = {
    ast.Add: ("add", "fadd"), ast.Sub: ("sub", "fsub"), ast.Mult: ("mul", "fmul"),
    ast.Div: ("", "fdiv"), ast.Mod: ("srem", ""), ast.FloorDiv: ("sdiv", ""),
    ast.RShift: ("ashr", ""), ast.LShift: ("shl", ""), ast.BitAnd: ("and", ""),
    ast.BitOr: ("or", ""),
}  # fmt: skip
_CONTRACTED = (ast.Add, ast.Sub, ast.Mult)
SIZES = {"double": 8, "float": 4, "i64": 8, "i8": 1}


LEAF = "leaf_"
"""How the name of a leaf begins where it is called by its name."""


class LeafCalls(NamedTuple):
    """How leaves and parts are called: with rows of `width` lanes, by their addresses in the order
    `called`; direct: by their names, as functions of the same module."""

    width: int = 1
    called: Sequence[str] = ()
    direct: bool = False


NO_LEAVES = LeafCalls()


class Instructions:
    """Those of a function, in order. Variables are on the stack; LLVM's passes take registers.

    single: whether a `Value` is in single precision. fused: whether products and sums may be
    contracted.
    """

    def __init__(
        self, library: Scalars, function: ScalarFunction, *, single: bool, fused: bool,
        leaves: LeafCalls,
    ) -> None:  # fmt: skip
        self.known, self.function, self.single, self.fused = library, function, single, fused
        self.leaves = leaves
        self.types = {INT: "i64", FLOAT: "double", BOOL: "i1", NONE: "void"}
        self.types |= {VALUE: "float" if single else "double", **dict.fromkeys(ARRAYS, "ptr")}
        self.lines: list[str] = []
        self.slots: list[str] = []
        self.count = 0

    def entry(self, array: str) -> str:
        """The type of the entries of an array."""
        if array == TABLE:
            return self.types[VALUE]
        return "i8" if array == FLAGS else self.types[ARRAYS[array]]

    def kind(self, node: ast.expr) -> str:
        return self.function.kinds[node]

    def value(self, node: ast.expr) -> str:
        kind = self.kind(node)
        if isinstance(node, ast.Constant) and isinstance(node.value, bool):
            return "true" if node.value else "false"
        value = self.function.number(node)
        if value is not None:
            return str(value) if kind == INT else _hexadecimal(float(value))
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Slice):
            return self._loaded(node)
        match node:
            case ast.Name(id=name):
                return self.named(f"load {self.types[kind]}, ptr %x.{name}")
            case ast.Subscript(slice=ast.Slice()):
                return self.place(node)
            case ast.BinOp(left=left, op=op, right=right):
                return self.binary(op, self.value(left), self.kind(left), right)[0]
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return self.named(f"xor i1 {self.truth(inner)}, true")
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                operand = self.value(inner)
                return self.named(
                    f"sub i64 0, {operand}" if kind == INT else f"fneg {self.types[kind]} {operand}"
                )
            case ast.Compare(left=left, ops=tests, comparators=others):
                return self._compared(left, tests, others)
            case ast.BoolOp(op=op, values=values):
                return self._joined(isinstance(op, ast.And), values)
            case ast.IfExp(test=test, body=a, orelse=b):
                return self._chosen(kind, test, a, b)
            case ast.Call(args=arguments):
                return self._called(self.function.calls[node], kind, arguments)
        raise AssertionError(ast.dump(node))

    def _loaded(self, node: ast.Subscript) -> str:
        assert isinstance(node.value, ast.Name)
        array = self.function.kind(node.value.id)
        of = self.entry(array)
        loaded = self.named(f"load {of}, ptr {self.place(node)}, align {SIZES[of]}")
        if of == "i8":
            return self.named(f"zext i8 {loaded} to i64")
        target = self.types[ARRAYS[array]]
        return loaded if of == target else self.named(f"fpext {of} {loaded} to {target}")

    def binary(self, op: ast.operator, left: str, kind: str, right: ast.expr) -> tuple[str, str]:
        other, of = self.value(right), self.kind(right)
        shared = common({kind, of} | ({FLOAT} if isinstance(op, ast.Div) else set()))
        real = shared != INT
        a, b = self.converted(left, kind, shared), self.converted(other, of, shared)
        contract = "contract " if self.fused and real and isinstance(op, _CONTRACTED) else ""
        how = _ARITHMETIC[type(op)][real]
        return self.named(f"{how} {contract}{self.types[shared]} {a}, {b}"), shared

    def _compared(
        self, left: ast.expr, tests: Sequence[ast.cmpop], others: Sequence[ast.expr]
    ) -> str:
        values = [(self.value(one), self.kind(one)) for one in (left, *others)]
        holds = ""
        for (a, ka), test, (b, kb) in zip(values, tests, values[1:], strict=False):
            kind = common({ka, kb})
            real = kind != INT
            text = f"{'fcmp' if real else 'icmp'} {_TESTS[type(test)][real]} {self.types[kind]}"
            one = self.named(f"{text} {self.converted(a, ka, kind)}, {self.converted(b, kb, kind)}")
            holds = self.named(f"and i1 {holds}, {one}") if holds else one
        return holds

    def _joined(self, every: bool, values: Sequence[ast.expr]) -> str:
        at, (end,) = self.slot("i1"), self.labels("end")
        for one in values:
            truth, (more,) = self.truth(one), self.labels("more")
            self.line(f"store i1 {truth}, ptr {at}")
            self.branch(truth, *((more, end) if every else (end, more)))
            self.begin(more)
        self.jump(end)
        self.begin(end)
        return self.named(f"load i1, ptr {at}")

    def _chosen(self, kind: str, test: ast.expr, a: ast.expr, b: ast.expr) -> str:
        at, (one, two, end) = self.slot(self.types[kind]), self.labels("one", "two", "end")
        self.branch(self.truth(test), one, two)
        for label, node in ((one, a), (two, b)):
            self.begin(label)
            value = self.converted(self.value(node), self.kind(node), kind)
            self.line(f"store {self.types[kind]} {value}, ptr {at}")
            self.jump(end)
        self.begin(end)
        return self.named(f"load {self.types[kind]}, ptr {at}")

    def _called(self, name: str, kind: str, arguments: Sequence[ast.expr]) -> str:
        if name in ("leaf", "part"):
            return self._elsewhere(name, ast.literal_eval(arguments[0]), arguments[1:])
        values = [self.value(a) for a in arguments]
        kinds = [self.kind(a) for a in arguments]
        if name in self.known.functions:
            called = self.known.functions[name]
            operands = ", ".join(
                f"{self.types[declared]} {self.converted(v, k, declared)}"
                for v, k, declared in zip(values, kinds, called.parameters.values(), strict=True)
            )
            text = f"call {self.types[called.result]} @{name}({operands})"
            if called.result != NONE:
                return self.named(text)
            self.line(text)
            return ""
        if name in MACHINE:
            return self._machine(name, values, arguments)
        wanted = kind if name in ("abs", "min", "max") else FLOAT
        if name != "int":
            values = [self.converted(v, k, wanted) for v, k in zip(values, kinds, strict=True)]
        match name:
            case "float":
                return values[0]
            case "int":
                return self._whole(values[0], kinds[0])
            case "math.sqrt" | "math.floor":
                return self.named(f"call double @llvm.{name[5:]}.f64(double {values[0]})")
            case "abs" if kind == INT:
                less = self.named(f"sub i64 0, {values[0]}")
                negative = self.named(f"icmp slt i64 {values[0]}, 0")
                return self.named(f"select i1 {negative}, i64 {less}, i64 {values[0]}")
            case "abs":
                of = self.types[kind]
                bits = {"double": 64, "float": 32}[of]
                return self.named(f"call {of} @llvm.fabs.f{bits}({of} {values[0]})")
            case "math.isnan":
                return self.named(f"fcmp uno double {values[0]}, 0.0")
            case "math.isfinite":
                size = self.named(f"call double @llvm.fabs.f64(double {values[0]})")
                return self.named(f"fcmp olt double {size}, {_hexadecimal(math.inf)}")
            case "min" | "max":  # as in Python: the first, unless the second is beyond it
                of, real = self.types[kind], kind != INT
                test = {"min": ("slt", "olt"), "max": ("sgt", "ogt")}[name][real]
                compare = "fcmp" if real else "icmp"
                beyond = self.named(f"{compare} {test} {of} {values[1]}, {values[0]}")
                return self.named(f"select i1 {beyond}, {of} {values[1]}, {of} {values[0]}")
        raise AssertionError(name)

    def _elsewhere(self, kind: str, name: str, arguments: Sequence[ast.expr]) -> str:
        """Call a leaf, of places in w, or a part, of arrays and a number."""
        values = [self.value(a) for a in arguments]
        if kind == "leaf":
            w = self.named("load ptr, ptr %x.w")
            passed = [f"ptr {self._offset(FLOATS, w, v)}" for v in values]
            passed += [f"i64 {self.leaves.width}"] * 2
        else:
            passed = [f"ptr {values[0]}", f"ptr {values[1]}", f"i64 {values[2]}"]
        if self.leaves.direct:
            where = f"@{LEAF if kind == 'leaf' else ''}{name}"
        else:
            first, place = self.named("load ptr, ptr %x.leaves"), self.leaves.called.index(name)
            where = self.named(f"load ptr, ptr {self._offset(WHOLES, first, str(place))}")
        self.line(f"call void {where}({', '.join(passed)})")
        return ""

    def _machine(self, name: str, values: list[str], arguments: Sequence[ast.expr]) -> str:
        match name:
            case "any_lane":
                count = values[2]
                lanes = f"<{count} x double>"
                place = self._offset(FLOATS, values[0], values[1])
                flags = self.named(f"load {lanes}, ptr {place}, align 8")
                flags = self.named(f"fcmp une {lanes} {flags}, zeroinitializer")
                bits = self.named(f"bitcast <{count} x i1> {flags} to i{count}")
                return self.named(f"icmp ne i{count} {bits}, 0")
            case "address":
                array = self.kind(arguments[0])
                place = self._offset(array, values[0], values[1])
                return self.named(f"ptrtoint ptr {place} to i64")
            case "call":
                where = self.named(f"inttoptr i64 {values[0]} to ptr")
                self.line(f"call void {where}({', '.join(f'i64 {v}' for v in values[1:])})")
                return ""
            case "copy":
                array = self.kind(arguments[0])
                source = self._offset(array, values[0], values[1])
                target = self._offset(array, values[3], values[4])
                size = self.named(f"mul i64 {values[2]}, {SIZES[self.entry(array)]}")
                operands = f"ptr {target}, ptr {source}, i64 {size}, i1 false"
                self.line(f"call void @llvm.memmove.p0.p0.i64({operands})")
                return ""
            case "take":
                return self.named(f"atomicrmw add ptr {values[0]}, i64 1 acq_rel")
            case "look":
                return self.named(f"load atomic i64, ptr {values[0]} acquire, align 8")
            case "table_at" | "values_at" | "floats_at":
                return self.named(f"inttoptr i64 {values[0]} to ptr")
        raise ValueError(f"'{name}' is for kernels of a device")

    def _offset(self, array: str, first: str, index: str) -> str:
        return self.named(f"getelementptr {self.entry(array)}, ptr {first}, i64 {index}")

    def _whole(self, value: str, kind: str) -> str:
        return value if kind == INT else self.named(f"fptosi double {value} to i64")

    def truth(self, node: ast.expr) -> str:
        value = self.value(node)
        return self.named(f"icmp ne i64 {value}, 0") if self.kind(node) == INT else value

    def converted(self, value: str, kind: str, wanted: str) -> str:
        of, to = self.types[kind], self.types[wanted]
        if of == to:
            return value
        how = {
            ("i64", "double"): "sitofp", ("i64", "float"): "sitofp", ("float", "double"): "fpext",
            ("double", "float"): "fptrunc", ("i1", "i64"): "zext",
        }[of, to]  # fmt: skip
        return self.named(f"{how} {of} {value} to {to}")

    def place(self, node: ast.expr) -> str:
        assert isinstance(node, ast.Subscript)
        assert isinstance(node.value, ast.Name)
        array = self.named(f"load ptr, ptr %x.{node.value.id}")
        index = node.slice.lower if isinstance(node.slice, ast.Slice) else node.slice
        if index is None:
            return array
        return self._offset(self.function.kind(node.value.id), array, self.value(index))

    # -- lines

    def slot(self, of: str) -> str:
        """A place on the stack, which belongs to the whole function."""
        self.count += 1
        self.slots.append(f"  %s{self.count} = alloca {of}")
        return f"%s{self.count}"

    def named(self, text: str) -> str:
        self.count += 1
        self.line(f"%v{self.count} = {text}")
        return f"%v{self.count}"

    def labels(self, *names: str) -> list[str]:
        self.count += 1
        return [f"{name}.{self.count}" for name in names]

    def branch(self, condition: str, one: str, two: str) -> None:
        self.line(f"br i1 {condition}, label %{one}, label %{two}")

    def jump(self, label: str) -> None:
        self.line(f"br label %{label}")

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")

    def line(self, text: str) -> None:
        self.lines.append(f"  {text}")


def _hexadecimal(value: float) -> str:
    (pattern,) = struct.unpack("<Q", struct.pack("<d", value))
    return f"0x{pattern:016X}"


_DECLARED = (
    "declare double @llvm.sqrt.f64(double)",
    "declare double @llvm.floor.f64(double)",
    "declare double @llvm.fabs.f64(double)",
    "declare float @llvm.fabs.f32(float)",
    "declare void @llvm.memmove.p0.p0.i64(ptr, ptr, i64, i1)",
)


def scalars_text(
    library: Scalars,
    roots: Sequence[str],
    *,
    single: bool = False,
    fused: bool = False,
    leaves: LeafCalls = NO_LEAVES,
    packed: bool = False,
) -> str:
    """The text of a module of these functions and of those that they call.

    single: whether a `Value`, and an entry of a `Table`, is in single precision. fused: whether
    LLVM may contract a product and a sum. packed: whether the functions are called, as "packed_"
    and their names, with the address of what they take: addresses and whole numbers, one after the
    other.
    """
    functions = library.needed(roots)
    internal = [f.name for f in functions if packed or f.name not in roots]
    bodies = [
        _Printer(
            library, f, single=single, fused=fused, leaves=leaves, internal=f.name in internal
        ).text()
        for f in functions
    ]
    stubs = [_unpacks(library.functions[name]) for name in roots] if packed else []
    return "\n\n".join([*bodies, *stubs, *_DECLARED]) + "\n"


PACKED = "packed_"
"""How the name of a function begins that takes the address of what another takes."""


def _unpacks(function: ScalarFunction) -> str:
    """A function of the address of the arguments of another, which it calls."""
    lines, passed = ["%a = inttoptr i64 %where to ptr"], []
    for k, (name, kind) in enumerate(function.parameters.items()):
        assert kind == INT or kind in ARRAYS, f"'{name}' is no whole number and no array"
        lines += [f"%p{k} = getelementptr i64, ptr %a, i64 {k}", f"%i{k} = load i64, ptr %p{k}"]
        if kind != INT:
            lines.append(f"%v{k} = inttoptr i64 %i{k} to ptr")
        passed.append(f"i64 %i{k}" if kind == INT else f"ptr %v{k}")
    lines += [f"call void @{function.name}({', '.join(passed)})", "ret void"]
    begin = f"define void @{PACKED}{function.name}(i64 %where) nounwind {{"
    return "\n".join([begin, "entry:", *(f"  {line}" for line in lines), "}"])


class _Printer(Instructions):
    """The statements of a function."""

    def __init__(
        self,
        library: Scalars,
        function: ScalarFunction,
        *,
        single: bool,
        fused: bool,
        leaves: LeafCalls,
        internal: bool,
    ) -> None:
        super().__init__(library, function, single=single, fused=fused, leaves=leaves)
        self.own = internal
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
                computed = [self.value(v) for v in values]
                for name, value, one in zip(names, values, computed, strict=True):
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
                    returned = self.converted(self.value(value), self.kind(value), kind)
                    self.line(f"ret {self.types[kind]} {returned}")
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
        limits = [self.value(b) for b in bounds]
        first, last = (limits[0], limits[1]) if len(limits) > 1 else ("0", limits[0])
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
            into = self.function.kind(target.id)
            self.line(
                f"store {self.types[into]} {self.converted(value, kind, into)}, ptr %x.{target.id}"
            )
            return
        assert isinstance(target, ast.Subscript)
        assert isinstance(target.value, ast.Name)
        array = self.function.kind(target.value.id)
        stored, of = self.converted(value, kind, ARRAYS[array]), self.entry(array)
        if of == "i8":
            stored = self.named(f"trunc i64 {stored} to i8")
        self.line(f"store {of} {stored}, ptr {self.place(target)}, align {SIZES[of]}")


_TYPES = {INT: ctypes.c_int64, FLOAT: ctypes.c_double, BOOL: ctypes.c_bool, NONE: None}
_DTYPES = {FLOATS: (np.float64,), WHOLES: (np.int64,), TABLE: (np.float64, np.float32)}


def called(file: str, name: str, *arguments: Any) -> Any:
    """The result of a function of a file of `holdfast.execution`, such as "interpolate".

    Arrays are contiguous, of doubles or of 64-bit integers; a `Table` may be of floats.
    """
    function = scalars(file).functions[name]
    single, passed = False, []
    for (parameter, kind), argument in zip(function.parameters.items(), arguments, strict=True):
        if kind not in ARRAYS:
            passed.append(argument)
            continue
        if argument.dtype not in _DTYPES[kind] or not argument.flags.c_contiguous:
            raise TypeError(f"'{parameter}' of '{name}' is {argument.dtype}, not {kind}")
        single |= kind == TABLE and argument.dtype == np.float32
        passed.append(argument.ctypes.data)
    return compiled(file, name, single)(*passed)


def address(file: str, name: str, *, single: bool = False) -> int:
    """The address of its machine code, for tables in double or single precision."""
    return _machine(file, name, single).address(name)


@cache
def compiled(file: str, name: str, single: bool = False) -> Callable[..., Any]:
    """A function of a file of `holdfast.execution`, which is given the addresses of arrays."""
    function = scalars(file).functions[name]
    kinds: list[Any] = [_TYPES.get(kind, ctypes.c_void_p) for kind in function.parameters.values()]
    return ctypes.CFUNCTYPE(_TYPES[function.result], *kinds)(address(file, name, single=single))


@cache
def _machine(file: str, name: str, single: bool) -> Machine:
    return compiled_text(scalars_text(scalars(file), [name], single=single), optimised=True)
