"""Values and conditions of the functions of `scalar_text.py` as instructions of LLVM."""

from __future__ import annotations

import ast
from typing import Protocol

from holdfast.errors import DefinitionError

WHOLE, TRUTH = "i64", "i1"
_WHOLE_OPERATIONS = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.FloorDiv: "sdiv", ast.Mod: "srem",
    ast.LShift: "shl", ast.RShift: "lshr", ast.BitAnd: "and", ast.BitOr: "or",
}  # fmt: skip
_REAL_OPERATIONS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_COMPARISONS = {
    ast.Lt: ("slt", "olt"), ast.LtE: ("sle", "ole"), ast.Gt: ("sgt", "ogt"),
    ast.GtE: ("sge", "oge"), ast.Eq: ("eq", "oeq"), ast.NotEq: ("ne", "une"),
}  # fmt: skip

_ARRAYS = {
    "values_at": "*value", "reals_at": "*double", "wholes_at": "*i64", "flags_at": "*i8",
}  # fmt: skip

Typed = tuple[str, str]
"""The name of a value, and its type; that of an array is a star and the type of its entries."""


class Known(Protocol):
    """What the functions of a module share.

    real: the type of a value; constants; functions: the types of results and of arguments.
    """

    real: str
    constants: dict[str, int]
    functions: dict[str, tuple[str, list[str]]]


class Instructions:
    """Those of a function, in order. Variables are in memory; LLVM's passes take registers."""

    def __init__(self, known: Known) -> None:
        self.known, self.real = known, known.real
        self.lines: list[str] = []
        self.slots: dict[str, Typed] = {}
        self.allocated: list[str] = []
        self.open = True
        self._count = 0

    def branch(self, test: ast.expr, yes: str, no: str) -> None:
        """Branch on a condition, of which no more is computed than Python would."""
        if isinstance(test, ast.BoolOp):
            for part in test.values[:-1]:
                (more,) = self.labels("more")
                both = isinstance(test.op, ast.And)
                self.branch(part, more if both else yes, no if both else more)
                self.begin(more)
            self.branch(test.values[-1], yes, no)
        elif isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
            self.branch(test.operand, no, yes)
        elif isinstance(test, ast.Constant):
            self.end(f"br label %{yes if test.value else no}")
        else:
            name, kind = self.value(test)
            if kind != TRUTH:
                name = self.new(f"icmp ne {kind} {name}, 0")
            self.end(f"br i1 {name}, label %{yes}, label %{no}")

    def _chosen(self, test: ast.expr, a: ast.expr, b: ast.expr) -> Typed:
        yes, no, end = self.labels("yes", "no", "end")
        self.branch(test, yes, no)
        slot, kind = "", ""
        for label, node in ((yes, a), (no, b)):
            self.begin(label)
            name, of = self.whole(self.value(node))
            if not slot:
                slot, kind = self.allocate(of), of
            self.line(f"store {plain(kind)} {name}, ptr {slot}")
            self.end(f"br label %{end}")
        self.begin(end)
        return self.new(f"load {plain(kind)}, ptr {slot}"), kind

    def value(self, node: ast.expr) -> Typed:
        if isinstance(node, ast.Constant):
            if isinstance(node.value, int):
                return str(int(node.value)), WHOLE
            assert isinstance(node.value, float)
            assert node.value.is_integer()
            return f"{node.value:.1f}", self.real
        if isinstance(node, ast.Name):
            return self._named(node.id)
        if isinstance(node, ast.Subscript):
            place, kind = self.place(node)
            name = self.new(f"load {kind}, ptr {place}")
            return (self.new(f"zext i8 {name} to i64"), WHOLE) if kind == "i8" else (name, kind)
        if isinstance(node, ast.BinOp):
            return self._operation(node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            name, kind = self.value(node.operand)
            negative = f"sub i64 0, {name}" if kind == WHOLE else f"fneg {kind} {name}"
            return self.new(negative), kind
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            return self._comparison(node.left, node.ops[0], node.comparators[0])
        if isinstance(node, ast.Compare):
            pairs = zip([node.left, *node.comparators], node.ops, node.comparators, strict=False)
            parts: list[ast.expr] = [ast.Compare(a, [op], [b]) for a, op, b in pairs]
            return self.value(ast.BoolOp(ast.And(), parts))
        if isinstance(node, ast.BoolOp):
            return self._chosen(node, ast.Constant(1), ast.Constant(0))
        if isinstance(node, ast.IfExp):
            return self._chosen(node.test, node.body, node.orelse)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return self._called(node.func.id, [self.value(a) for a in node.args])
        raise DefinitionError(f"'{ast.unparse(node)}' is not a value of these functions")

    def _named(self, name: str) -> Typed:
        if name in self.slots:
            slot, kind = self.slots[name]
            return self.new(f"load {plain(kind)}, ptr {slot}"), kind
        if name in self.known.constants:
            return str(self.known.constants[name]), WHOLE
        raise DefinitionError(f"'{name}' has no value")

    def _operation(self, node: ast.BinOp) -> Typed:
        (a, kind), (b, other) = self.value(node.left), self.value(node.right)
        if kind[0] == "*":  # the rest of an array
            return self.new(f"getelementptr {kind[1:]}, ptr {a}, i64 {b}"), kind
        if other == WHOLE != kind:
            b, other = self.new(f"sitofp i64 {b} to {kind}"), kind
        if kind != other:
            raise DefinitionError(f"{kind} and {other}: {ast.unparse(node)}")
        if kind == WHOLE:
            return self.new(f"{_WHOLE_OPERATIONS[type(node.op)]} i64 {a}, {b}"), WHOLE
        # product and sum may be fused
        return self.new(f"{_REAL_OPERATIONS[type(node.op)]} contract {kind} {a}, {b}"), kind

    def _comparison(self, left: ast.expr, op: ast.cmpop, right: ast.expr) -> Typed:
        (a, kind), (b, other) = self.value(left), self.value(right)
        if kind != other:
            raise DefinitionError(f"{kind} and {other} are compared")
        whole, real = _COMPARISONS[type(op)]
        if kind == WHOLE:
            return self.new(f"icmp {whole} i64 {a}, {b}"), TRUTH
        return self.new(f"fcmp {real} {kind} {a}, {b}"), TRUTH

    def _called(self, name: str, given: list[Typed]) -> Typed:
        given = [self.whole(g) for g in given]
        if name in ("min", "max"):
            return self._extreme(name, given)
        if name in _ARRAYS:
            kind = _ARRAYS[name].replace("value", self.real)
            return self.new(f"inttoptr i64 {given[0][0]} to ptr"), kind
        if name == "address":
            (array, kind), (k, _) = given
            place = self.new(f"getelementptr {kind[1:]}, ptr {array}, i64 {k}")
            return self.new(f"ptrtoint ptr {place} to i64"), WHOLE
        if name == "call":
            where = self.new(f"inttoptr i64 {given[0][0]} to ptr")
            self.line(f"call void {where}({', '.join(f'i64 {g}' for g, _ in given[1:])})")
            return "", "void"
        if name == "copy":
            return self._copied(given)
        if name in ("take", "look"):
            array, kind = given[0]
            how = (
                f"atomicrmw add ptr {array}, i64 1 monotonic"
                if name == "take"
                else f"load atomic i64, ptr {array} acquire, align 8"
            )
            return self.new(how), WHOLE
        if name == "float":
            return self.new(f"sitofp i64 {given[0][0]} to {self.real}"), self.real
        if name == "abs":
            value, kind = given[0]
            if kind == WHOLE:
                return self._extreme("max", [(self.new(f"sub i64 0, {value}"), WHOLE), given[0]])
            bits = {"double": 64, "float": 32}[kind]
            return self.new(f"call {kind} @llvm.fabs.f{bits}({kind} {value})"), kind
        if name not in self.known.functions:
            raise DefinitionError(f"the function '{name}' is not defined above")
        result, kinds = self.known.functions[name]
        if [k for _, k in given] != kinds:
            raise DefinitionError(f"'{name}' has {kinds}, and is called with {given}")
        text = f"call {plain(result)} @{name}({', '.join(f'{plain(k)} {g}' for g, k in given)})"
        if result == "void":
            self.line(text)
            return "", "void"
        return self.new(text), result

    def _extreme(self, name: str, given: list[Typed]) -> Typed:
        found, kind = given[0]
        for other, _ in given[1:]:
            sense = "lt" if name == "min" else "gt"
            how = f"icmp s{sense} i64" if kind == WHOLE else f"fcmp o{sense} {kind}"
            takes = self.new(f"{how} {other}, {found}")
            found = self.new(f"select i1 {takes}, {kind} {other}, {kind} {found}")
        return found, kind

    def _copied(self, given: list[Typed]) -> Typed:
        (source, kind), (i, _), (count, _), (target, _), (j, _) = given
        of = kind[1:]
        start = self.new(f"getelementptr {of}, ptr {source}, i64 {i}")
        to = self.new(f"getelementptr {of}, ptr {target}, i64 {j}")
        size = {"double": 8, "float": 4, "i64": 8, "i8": 1}[of]
        length = self.new(f"mul i64 {count}, {size}")
        self.line(
            f"call void @llvm.memmove.p0.p0.i64(ptr {to}, ptr {start}, i64 {length}, i1 false)"
        )
        return "", "void"

    def whole(self, value: Typed) -> Typed:
        """A truth as 1 or 0; other values as they are."""
        name, kind = value
        return (self.new(f"zext i1 {name} to i64"), WHOLE) if kind == TRUTH else value

    def place(self, node: ast.Subscript) -> Typed:
        (array, kind), (k, _) = self.value(node.value), self.value(node.slice)
        return self.new(f"getelementptr {kind[1:]}, ptr {array}, i64 {k}"), kind[1:]

    def store(self, name: str, value: Typed) -> None:
        value = self.whole(value)
        if name not in self.slots:
            self.slots[name] = (self.allocate(value[1]), value[1])
        slot, kind = self.slots[name]
        if kind != value[1]:
            raise DefinitionError(f"'{name}' is {kind}, and is given {value[1]}")
        self.line(f"store {plain(kind)} {value[0]}, ptr {slot}")

    def allocate(self, kind: str) -> str:
        self._count += 1
        self.allocated.append(f"  %slot{self._count} = alloca {plain(kind)}")
        return f"%slot{self._count}"

    def labels(self, *names: str) -> list[str]:
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def new(self, text: str) -> str:
        self._count += 1
        self.line(f"%t{self._count} = {text}")
        return f"%t{self._count}"

    def line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.open = True

    def end(self, text: str) -> None:
        self.line(text)
        self.open = False


def plain(kind: str) -> str:
    """The type in LLVM's text."""
    return "ptr" if kind[0] == "*" else kind
