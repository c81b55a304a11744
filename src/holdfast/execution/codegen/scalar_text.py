"""Functions in a small part of Python as the text of LLVM: whole numbers, addresses, loops.

It is for loops that contain no program, such as the sweep of a march, which so need no analysis of
types by Numba. An argument has a type of `TYPES`, a variable that of its first value; `Values` and
`Value` are in the precision of the text. There are arithmetic, comparisons, `if`, `while`, `for`
over `range`, entries of arrays, assignments of one or several names, calls of functions above, and

| call | what it is |
|---|---|
| `min`, `max`, `abs`, `float` | as in Python |
| `address(a, k)` | where the entry k of an array is, as a whole number |
| `values_at(k)`, `reals_at(k)`, `wholes_at(k)`, `flags_at(k)` | the array at an address |
| `call(k, ...)` | the machine code at an address is called with whole numbers |
| `copy(a, i, count, b, j)` | count entries of a from i on are copied to b from j on |
| `take(a)`, `look(a)` | a[0] by an atomic operation; `take` increments it |

Whole numbers are divided with the quotient rounded to zero: no operand is below zero.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence

from holdfast.errors import DefinitionError
from holdfast.execution.codegen.scalar_values import WHOLE, Instructions, Typed, plain

TYPES = ("Whole", "Value", "Values", "Reals", "Wholes", "Flags")


class ScalarText:
    """The functions of a module.

    real: the type of `Value`, "double" or "float"; entries: functions that are called from outside.
    """

    def __init__(self, source: str, real: str, entries: Sequence[str]) -> None:
        self.real, self.entries = real, entries
        self.constants: dict[str, int] = {}
        self.functions: dict[str, tuple[str, list[str]]] = {}
        self.parts: list[str] = []
        for node in ast.parse(source).body:
            if isinstance(node, ast.FunctionDef):
                self.parts.append(_Function(self, node).text)
            elif isinstance(node, ast.Assign):
                self._constant(node)

    @property
    def text(self) -> str:
        bits = {"double": 64, "float": 32}[self.real]
        declared = [
            f"declare {self.real} @llvm.fabs.f{bits}({self.real})",
            "declare void @llvm.memmove.p0.p0.i64(ptr, ptr, i64, i1)",
        ]
        return "\n\n".join([*self.parts, *declared]) + "\n"

    def type_of(self, annotation: ast.expr | None) -> str:
        """Of an argument; an array is a pointer with the type of its entries."""
        name = annotation.id if isinstance(annotation, ast.Name) else ""
        kinds = {
            "Whole": WHOLE, "Value": self.real, "Values": f"*{self.real}", "Reals": "*double",
            "Wholes": "*i64", "Flags": "*i8",
        }  # fmt: skip
        if name not in kinds:
            raise DefinitionError(f"the type '{name}' of an argument is not one of {TYPES}")
        return kinds[name]

    def _constant(self, node: ast.Assign) -> None:
        (target,) = node.targets
        if isinstance(target, ast.Tuple):  # of a range
            assert isinstance(node.value, ast.Call)
            found = range(*map(self.number, node.value.args))
            for name, value in zip(target.elts, found, strict=True):
                assert isinstance(name, ast.Name)
                self.constants[name.id] = value
            return
        assert isinstance(target, ast.Name)
        self.constants[target.id] = self.number(node.value)

    def number(self, node: ast.expr) -> int:
        """A whole number that is known here."""
        if isinstance(node, ast.Constant) and isinstance(node.value, int):
            return node.value
        if isinstance(node, ast.Name) and node.id in self.constants:
            return self.constants[node.id]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -self.number(node.operand)
        if isinstance(node, ast.BinOp):
            a, b = self.number(node.left), self.number(node.right)
            known: dict[type, Callable[[int, int], int]] = {
                ast.Add: int.__add__, ast.Sub: int.__sub__, ast.Mult: int.__mul__,
                ast.FloorDiv: int.__floordiv__, ast.LShift: int.__lshift__,
            }  # fmt: skip
            return known[type(node.op)](a, b)
        raise DefinitionError(f"'{ast.unparse(node)}' is not a number that is known here")


class _Function(Instructions):
    """One function."""

    def __init__(self, module: ScalarText, node: ast.FunctionDef) -> None:
        super().__init__(module)
        self.module = module
        self._loops: list[tuple[str, str]] = []
        kinds = [module.type_of(a.annotation) for a in node.args.args]
        self.result = module.type_of(node.returns) if node.returns is not None else "void"
        module.functions[node.name] = (self.result, kinds)
        for argument, kind in zip(node.args.args, kinds, strict=True):
            self.store(argument.arg, (f"%{argument.arg}", kind))
        self._block(node.body)
        if self.open:
            self.end("ret void" if self.result == "void" else "unreachable")
        given = ", ".join(
            f"{plain(k)} %{a.arg}" for a, k in zip(node.args.args, kinds, strict=True)
        )
        own = "" if node.name in module.entries else "internal "
        self.text = "\n".join(
            [
                f"define {own}{plain(self.result)} @{node.name}({given}) nounwind {{",
                "entry:",
                *self.allocated,
                *self.lines,
                "}",
            ]
        )

    def _block(self, body: list[ast.stmt]) -> None:
        for node in body:
            if self.open:
                getattr(self, f"_{type(node).__name__.lower()}", self._unknown)(node)

    def _unknown(self, node: ast.AST) -> None:
        raise DefinitionError(f"'{ast.unparse(node)}' is not a statement of these functions")

    def _pass(self, node: ast.Pass) -> None:
        pass

    def _expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):  # which is the docstring
            self.value(node.value)

    def _assign(self, node: ast.Assign) -> None:
        (target,) = node.targets
        if isinstance(target, ast.Tuple):
            assert isinstance(node.value, ast.Tuple)
            found = [self.value(v) for v in node.value.elts]
            for to, value in zip(target.elts, found, strict=True):
                self._put(to, value)
        else:
            self._put(target, self.value(node.value))

    def _augassign(self, node: ast.AugAssign) -> None:
        before = ast.parse(ast.unparse(node.target), mode="eval").body
        self._put(node.target, self.value(ast.BinOp(before, node.op, node.value)))

    def _put(self, target: ast.expr, value: Typed) -> None:
        if isinstance(target, ast.Name):
            self.store(target.id, value)
            return
        assert isinstance(target, ast.Subscript)
        place, kind = self.place(target)
        name, of = value
        if kind == "i8" and of == WHOLE:
            name = self.new(f"trunc i64 {name} to i8")
        elif kind == "double" and of == "float":
            name = self.new(f"fpext float {name} to double")
        elif kind == "float" and of == "double":
            name = self.new(f"fptrunc double {name} to float")
        elif kind in ("double", "float") and of == WHOLE:
            name = self.new(f"sitofp i64 {name} to {kind}")
        elif kind != of:
            raise DefinitionError(f"{of} stored as {kind}: {ast.unparse(target)}")
        self.line(f"store {kind} {name}, ptr {place}")

    def _if(self, node: ast.If) -> None:
        yes, no, end = self.labels("then", "else", "end")
        self.branch(node.test, yes, no)
        open_after = False
        for label, body in ((yes, node.body), (no, node.orelse)):
            self.begin(label)
            self._block(body)
            if self.open:
                open_after = True
                self.end(f"br label %{end}")
        if open_after:
            self.begin(end)

    def _while(self, node: ast.While) -> None:
        head, body, end = self.labels("head", "body", "end")
        self.end(f"br label %{head}")
        self.begin(head)
        self.branch(node.test, body, end)
        self.begin(body)
        self._inside(node.body, head, end)
        self.begin(end)

    def _for(self, node: ast.For) -> None:
        assert isinstance(node.target, ast.Name)
        assert isinstance(node.iter, ast.Call)
        given = node.iter.args
        start = self.value(given[0]) if len(given) > 1 else ("0", WHOLE)
        stop = self.value(given[1] if len(given) > 1 else given[0])
        step = self.module.number(given[2]) if len(given) > 2 else 1
        head, body, following, end = self.labels("head", "body", "next", "end")
        counter = self.allocate(WHOLE)
        self.line(f"store i64 {start[0]}, ptr {counter}")
        self.end(f"br label %{head}")
        self.begin(head)
        now = self.new(f"load i64, ptr {counter}")
        goes = self.new(f"icmp {'slt' if step > 0 else 'sgt'} i64 {now}, {stop[0]}")
        self.end(f"br i1 {goes}, label %{body}, label %{end}")
        self.begin(body)
        self.store(node.target.id, (now, WHOLE))
        self._inside(node.body, following, end)
        self.begin(following)
        self.line(f"store i64 {self.new(f'add i64 {now}, {step}')}, ptr {counter}")
        self.end(f"br label %{head}")
        self.begin(end)

    def _inside(self, body: list[ast.stmt], following: str, end: str) -> None:
        self._loops.append((following, end))
        self._block(body)
        self._loops.pop()
        if self.open:
            self.end(f"br label %{following}")

    def _break(self, node: ast.Break) -> None:
        self.end(f"br label %{self._loops[-1][1]}")

    def _continue(self, node: ast.Continue) -> None:
        self.end(f"br label %{self._loops[-1][0]}")

    def _return(self, node: ast.Return) -> None:
        if node.value is None:
            self.end("ret void")
            return
        name, kind = self.whole(self.value(node.value))
        if kind != self.result:
            raise DefinitionError(f"{kind} returned as {self.result}: {ast.unparse(node)}")
        self.end(f"ret {plain(kind)} {name}")
