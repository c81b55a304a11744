"""Scalar functions: a small part of Python, read once and printed for LLVM and for C.

What a leaf cannot be, because it has loops whose length depends on numbers, is written as Python
functions of numbers and arrays, such as `simulation/quadratic_program.py` and
`level_set/sweep.py`. LLVM compiles the text (`scalar_llvm.py`); an exported law contains it as C
(`c_printer.py`); Python runs it as it is, except for the functions of `MACHINE`.

A parameter is `int`, `float`, `bool`, `Value` (a float in the precision of a march), or an array of
one dimension: `Floats`, `Wholes`, `Flags` (bytes), `Values`, and `Table` (floats that may be stored
in single precision). A function returns one of the numbers, or nothing. Its statements are
assignments of numbers and of parts of arrays (`rows[k:]`), `if`, `while`, `for ... in range(...)`,
`break`, `continue`, `return`, and calls; its expressions consist of arithmetic, comparisons, `and`,
`or`, `not`, `a if b else c`, the functions of `BUILT_IN`, functions of the same text or that it
imports by name, and constants. Python's `%` and `//` are for numbers that are not negative.
`math.floor` gives a float. A function whose body is its docstring is one that a program defines.

Kernels of a device are such functions too. A block of threads, or all blocks, share the numbers of
a range: `over_threads`, `over_blocks` and `over_all` in the place of `range`.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from importlib import import_module, resources
from types import FunctionType, MappingProxyType
from typing import Any, TypeAlias

from holdfast.maths.expressions.traversal import syntax_tree


def uncertain(
    statements: Iterable[ast.stmt], assigned: set[str], variables: Collection[str]
) -> Iterator[ast.Name]:
    """The uses of variables that may have no value yet. `assigned` becomes those with one."""

    def read(node: ast.AST) -> Iterator[ast.Name]:
        for one in ast.walk(node):
            if isinstance(one, ast.Name) and one.id in variables and one.id not in assigned:
                yield one

    for node in statements:
        match node:
            case ast.If(test=test, body=body, orelse=other):
                yield from read(test)
                ways = (set(assigned), set(assigned))
                for way, part in zip(ways, (body, other), strict=True):
                    yield from uncertain(part, way, variables)
                ends = [w for w, part in zip(ways, (body, other), strict=True) if not leaves(part)]
                assigned |= set.intersection(*ends) if ends else ways[0]
            case ast.While(test=test, body=body):
                yield from read(test)
                yield from uncertain(body, set(assigned), variables)
            case ast.For(target=target, iter=bounds, body=body):
                yield from read(bounds)
                yield from uncertain(body, {*assigned, ast.unparse(target)}, variables)
            case ast.Assign(targets=targets, value=value):
                yield from read(value)
                for target in targets:
                    parts = target.elts if isinstance(target, ast.Tuple) else [target]
                    assigned |= {p.id for p in parts if isinstance(p, ast.Name)}
                    yield from read(target)
            case _:
                yield from read(node)


def leaves(statements: Sequence[ast.stmt]) -> bool:
    """Whether what follows the statements is never reached."""
    last = statements[-1] if statements else None
    return isinstance(last, ast.Break | ast.Continue) or returns(statements)


def returns(statements: Sequence[ast.stmt]) -> bool:
    """Whether the statements always end with a return."""
    match statements[-1] if statements else None:
        case ast.Return():
            return True
        case ast.If(body=body, orelse=other):
            return returns(body) and returns(other)
        case ast.While(test=ast.Constant(value=True), body=body):
            return not breaks(body)
    return False


def breaks(statements: Sequence[ast.stmt]) -> bool:
    """Whether the loop that has these statements may be left by a break."""
    return any(
        isinstance(one, ast.Break)
        or (isinstance(one, ast.If) and (breaks(one.body) or breaks(one.orelse)))
        for one in statements
    )


INT, FLOAT, VALUE, BOOL, NONE = "int", "float", "Value", "bool", "None"
FLOATS, WHOLES, FLAGS, VALUES, TABLE = "Floats", "Wholes", "Flags", "Values", "Table"
ARRAYS: Mapping[str, str] = {
    FLOATS: FLOAT, WHOLES: INT, FLAGS: INT, VALUES: VALUE, TABLE: FLOAT,
}  # fmt: skip
"""The kinds of arrays, and of their entries."""
KINDS = {INT, FLOAT, VALUE, BOOL, NONE, *ARRAYS}

MACHINE: Mapping[str, str] = {
    "table_at": TABLE, "values_at": VALUES, "address": INT, "call": NONE, "copy": NONE,
    "take": INT, "look": INT, "wait": NONE, "add": NONE, "most": NONE, "private_floats": FLOATS,
    "private_wholes": WHOLES, "private_values": VALUES, "shared_floats": FLOATS,
    "shared_wholes": WHOLES, "floats_at": FLOATS, "any_lane": BOOL, "leaf": NONE, "part": NONE,
}  # fmt: skip
"""What has a meaning in machine code alone, and the kind of the result.

table_at(k), values_at(k), floats_at(k): the array at an address. address(a, k): that of an entry.
call(k, ...): the machine code at an address, with whole numbers. copy(a, i, count, b, j): count
entries of a from i on to b from j on. take(a), look(a): a[0] by an atomic operation; `take`
increments it. What a thread has written before `take` another sees after it has seen that number.

In kernels of a device: wait(): until all threads of the block are here. add(a, k, n): n to a[k], by
an atomic operation. most(a, k, x): a[k] are the bits of the largest number, none of them negative.
private_floats(n), ...: a new array of so many, of a thread; shared_floats(n), ...: of a block.

In loops over blocks of runs: any_lane(a, i, count): whether one of count entries from i on, a
constant number, is not 0. leaf(name, k, t=..., q=..., x=..., p=..., out=...): the leaf `name`, or
the k-th of this name, with places in w (0 by default). part(name, s, w, k): another function of a
block. The function that calls these has `w`, and `leaves` where their addresses are.
"""

RANGES = ("range", "over_threads", "over_blocks", "over_all")

BUILT_IN: Mapping[str, str] = {
    "min": "", "max": "", "abs": "", "int": INT, "float": FLOAT, "math.sqrt": FLOAT,
    "math.floor": FLOAT, "math.isnan": BOOL, "math.isfinite": BOOL, **MACHINE,
}  # fmt: skip
"""What may be called, and the kind of the result if it is always the same."""

Number: TypeAlias = int | float
WHOLE = ast.Mod | ast.FloorDiv | ast.RShift | ast.LShift | ast.BitAnd | ast.BitOr


@dataclass
class ScalarFunction:
    """A function: the kinds of its parameters, of its local variables and of its result."""

    name: str
    node: ast.FunctionDef
    parameters: dict[str, str]
    result: str
    variables: dict[str, str] = field(default_factory=dict)
    kinds: dict[ast.expr, str] = field(default_factory=dict)
    calls: dict[ast.Call, str] = field(default_factory=dict)
    constants: dict[str, Number] = field(default_factory=dict)
    """Of the file in which it stands."""
    written: set[str] = field(default_factory=set)
    """Arrays, by the names of parameters and variables, of which an entry is assigned."""
    leaves: dict[str, None] = field(default_factory=dict)
    """The leaves and parts that it calls."""

    @property
    def body(self) -> list[ast.stmt]:
        """Its statements without the docstring."""
        return self.node.body[1:] if ast.get_docstring(self.node) else self.node.body

    @property
    def text(self) -> str:
        return ast.get_docstring(self.node) or ""

    def kind(self, name: str) -> str:
        return self.variables.get(name) or self.parameters[name]

    def number(self, node: ast.expr) -> Number | None:
        """The number that an expression always is; None for others."""
        if isinstance(node, ast.Constant):
            return node.value if isinstance(node.value, int | float) else None
        if isinstance(node, ast.Name) and (node.id in self.parameters or node.id in self.variables):
            return None
        if not isinstance(node, _MAY_BE_FIXED):
            return None
        names = {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}
        if names & (self.parameters.keys() | self.variables.keys()):
            return None
        return constant(node, self.constants)


@dataclass
class Scalars:
    """The functions and constants of a text, with those of the texts that it imports."""

    functions: dict[str, ScalarFunction]
    constants: dict[str, Number]

    def needed(self, roots: Iterable[str]) -> list[ScalarFunction]:
        """The functions that these call, each before those that call it."""
        ordered: dict[str, ScalarFunction] = {}

        def add(name: str) -> None:
            if name not in ordered:
                for called in self.functions[name].calls.values():
                    if called in self.functions:
                        add(called)
                ordered[name] = self.functions[name]

        for name in roots:
            add(name)
        return list(ordered.values())

    def called(self, roots: Iterable[str]) -> list[str]:
        """The leaves and parts that these call, in the order of their addresses."""
        return list(dict.fromkeys(name for one in self.needed(roots) for name in one.leaves))


def constant(node: ast.expr, numbers: Mapping[str, Number]) -> Number | None:
    """The number that an expression is, whatever the arguments are; None for others."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            number = constant(inner, numbers)
            return None if number is None else -number
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _FOLDED:
            a, b = constant(left, numbers), constant(right, numbers)
            return None if a is None or b is None else _FOLDED[type(op)](a, b)
        case ast.Attribute(value=ast.Name(id="math"), attr="inf" | "nan" | "pi" as name):
            return float(getattr(math, name))
        case ast.Attribute():
            return numbers.get(ast.unparse(node))
        case ast.Name(id=name):
            return numbers.get(name)
    return None


_MAY_BE_FIXED = ast.Name | ast.Attribute | ast.BinOp | ast.UnaryOp
_FOLDED: Mapping[type[ast.operator], Callable[[Number, Number], Number]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv, ast.LShift: operator.lshift,
}  # fmt: skip


def common(kinds: Collection[str]) -> str:
    """The kind of a result of numbers of these kinds."""
    return next((k for k in (VALUE, FLOAT) if k in kinds), INT)


@cache
def scalars(name: str) -> Scalars:
    """The functions of a file of `holdfast.execution`, such as "interpolate"."""
    return read(text_of(name))


Fixed: TypeAlias = Number | str | tuple[Number, ...]
"""What is known of a program before it runs."""


def text_of(name: str) -> str:
    """The text of a file of `holdfast.execution`, such as "interpolate"."""
    return (resources.files("holdfast.execution") / f"{name}.py").read_text("utf-8")


def read(text: str, fixed: Mapping[str, Fixed] = MappingProxyType({})) -> Scalars:
    """The functions of a text. Raises `SyntaxError` for what is no part of the language.

    The text of a star import is to stand above: a text has several versions of some functions.
    fixed: values of attributes, such as "shape.states", for which the text is read (`_Fixing`).
    """
    library = Scalars({}, {})
    fixing = _Fixing(fixed)
    for node in syntax_tree(text).body:
        if fixed and isinstance(node, ast.FunctionDef):
            node = fixing.visit(node)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(_ROOM):
            for one in node.names if node.names[0].name != "*" else ():
                _import(library, node.module or "", one.name)
        elif isinstance(node, ast.Assign):
            library.constants |= _constants(node, library.constants)
        elif isinstance(node, ast.FunctionDef) and _is_scalar(node):
            _Reader(library, node)
    return library


_ROOM = "holdfast.execution."

LEAF_PLACES = ("t", "q", "x", "p", "out")
"""The arguments of a leaf, as places in w."""


class _Fixing(ast.NodeTransformer):
    """A function for one program: an attribute that is fixed, or an entry of one, is its value; of
    `if`, and of `or` and `and` whose fixed parts stand first, there remains what is done; a loop
    over `each(...)`, with a fixed number of turns, is written out."""

    def __init__(self, fixed: Mapping[str, Fixed]) -> None:
        self.fixed = dict(fixed)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        whole = f"{node.value.id}.{node.attr}" if isinstance(node.value, ast.Name) else ""
        return self._looked_up(node, whole)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self._looked_up(node, node.id)

    def _looked_up(self, node: ast.expr, name: str) -> ast.expr:
        value = self.fixed.get(name)
        return node if value is None or isinstance(value, tuple) else _constant(node, value)

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        self.generic_visit(node)
        values = self.fixed.get(ast.unparse(node.value))
        place = constant(node.slice, {})
        if isinstance(values, tuple) and place is not None:
            return _constant(node, values[int(place)])
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        value = constant(node, {})
        return node if value is None else _constant(node, value)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.op, ast.Not) and isinstance(node.operand, ast.Constant):
            return _constant(node, not node.operand.value)
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        match node:
            case ast.Compare(
                left=ast.Constant(value=a), ops=[op], comparators=[ast.Constant(value=b)]
            ) if type(op) in _COMPARED:
                return _constant(node, _COMPARED[type(op)](a, b))
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        decides = isinstance(node.op, ast.Or)
        left = []
        for value in node.values:
            if not isinstance(value, ast.Constant):
                left.append(value)
            elif bool(value.value) == decides:
                return _constant(node, decides) if not left else node
        if not left:
            return _constant(node, not decides)
        return left[0] if len(left) == 1 else ast.copy_location(ast.BoolOp(node.op, left), node)

    def visit_If(self, node: ast.If) -> list[ast.stmt]:
        test = self.visit(node.test)
        if isinstance(test, ast.Constant):
            return self._all(node.body if test.value else node.orelse)
        body, other = self._all(node.body), self._all(node.orelse)
        return [ast.copy_location(ast.If(test, body or [ast.Pass()], other), node)]

    def visit_For(self, node: ast.For) -> list[ast.stmt]:
        match node:
            case ast.For(
                target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="each"), args=turns)
            ):
                bounds = [constant(self.visit(b), {}) for b in turns]
                if None in bounds:
                    raise SyntaxError(f"the turns are not fixed: {ast.unparse(node.iter)}")
                written = []
                for k in range(*(int(b) for b in bounds if b is not None)):
                    self.fixed[name] = k
                    written += self._all([_copied(one) for one in node.body])
                self.fixed.pop(name, None)
                return written
        node.iter, node.body = self.visit(node.iter), self._all(node.body) or [ast.Pass()]
        return [node]

    def visit_While(self, node: ast.While) -> ast.While:
        node.test, node.body = self.visit(node.test), self._all(node.body) or [ast.Pass()]
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        left = self._all(node.body)
        only_text = len(left) == (ast.get_docstring(node) is not None)
        node.body = [*left, ast.Pass()] if only_text else left  # no body: another text has it
        return node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        self.generic_visit(node)
        match node:
            case ast.Call(func=ast.Name(id="leaf"), args=[ast.Constant(value=name), *number]):
                of = "".join(str(ast.literal_eval(k)) for k in number)
                places = {one.arg: one.value for one in node.keywords}
                zero = ast.copy_location(ast.Constant(0), node)
                ordered = [places.pop(a, zero) for a in LEAF_PLACES]
                if places:
                    raise SyntaxError(f"no places of a leaf: {', '.join(map(str, places))}")
                node.args, node.keywords = [_constant(node, f"{name!s}{of}"), *ordered], []
        return node

    def _all(self, statements: Iterable[ast.stmt]) -> list[ast.stmt]:
        left: list[ast.stmt] = []
        for one in statements:
            changed = self.visit(one)
            left += changed if isinstance(changed, list) else [changed]
        return left


def _copied(node: Any) -> Any:
    """A tree of its own: `deepcopy` takes ten times as long."""
    if isinstance(node, list):
        return [_copied(one) for one in node]
    if not isinstance(node, ast.AST):
        return node
    copy = type(node)(**{name: _copied(value) for name, value in ast.iter_fields(node)})
    return ast.copy_location(copy, node)


_COMPARED: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip


def _constant(node: ast.expr, value: Any) -> ast.Constant:
    return ast.copy_location(ast.Constant(value), node)


def _constants(node: ast.Assign, numbers: Mapping[str, Number]) -> dict[str, Number]:
    """The numbers that an assignment outside functions gives a name, or several from a range."""
    match node:
        case ast.Assign(targets=[ast.Name(id=name)], value=expression):
            value = constant(expression, numbers)
            return {} if value is None else {name: value}
        case ast.Assign(
            targets=[ast.Tuple(elts=names)],
            value=ast.Call(func=ast.Name(id="range"), args=bounds),
        ):
            ends = [constant(b, numbers) for b in bounds]
            if None in ends:
                raise SyntaxError(f"a range with an end that is no number: {ast.unparse(node)}")
            places = range(*(int(e) for e in ends if e is not None))
            return {ast.unparse(n): k for n, k in zip(names, places, strict=True)}
    return {}


def _import(library: Scalars, module: str, name: str) -> None:
    """Add a function, with those that it calls, a number, or the members of an enumeration."""
    value = getattr(import_module(module), name)
    if isinstance(value, FunctionType):
        library.functions |= scalars(module[len(_ROOM) :].replace(".", "/")).functions
    elif isinstance(value, int | float):
        library.constants[name] = value
    elif isinstance(value, type) and issubclass(value, IntEnum):
        library.constants |= {f"{name}.{one.name}": int(one) for one in value}


def _is_scalar(node: ast.FunctionDef) -> bool:
    """Whether it is for other targets too: functions of other values are for Python alone."""
    kinds = [*(a.annotation for a in node.args.args), node.returns]
    return all(_annotated(k) in KINDS for k in kinds) and node.name not in BUILT_IN


class _Reader:
    """Finds the kind of every expression of a function."""

    def __init__(self, library: Scalars, node: ast.FunctionDef) -> None:
        self.known = library
        parameters = {a.arg: _annotated(a.annotation) for a in node.args.args}
        self.function = ScalarFunction(node.name, node, parameters, _annotated(node.returns))
        library.functions[node.name] = self.function
        self.function.constants = dict(library.constants)
        self._views: list[tuple[str, str]] = []
        for statement in self.function.body:
            self._statement(statement)
        if not self.function.body:
            self.function.written = {n for n, kind in parameters.items() if kind in ARRAYS}
        elif self.function.result != NONE and not returns(self.function.body):
            raise self._refuse(node, "a way to the end without a result")
        for unknown in uncertain(self.function.body, set(parameters), self.function.variables):
            raise self._refuse(unknown, f"'{unknown.id}' may have no value")
        for _ in self._views:  # what is assigned to a part of an array is assigned to the array
            for part, whole in self._views:
                if part in self.function.written:
                    self.function.written.add(whole)

    def _refuse(self, node: ast.AST, why: str) -> SyntaxError:
        name, line = self.function.name, getattr(node, "lineno", 0)
        return SyntaxError(f"{name}, line {line}: {why}: {ast.unparse(node)}")

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                for value in values:
                    self._kind(value)
                for k, name in enumerate(names):
                    if any(_reads(later, name) for later in values[k + 1 :]):
                        raise self._refuse(node, "a value that is read after it is replaced")
                for name, value in zip(names, values, strict=True):
                    self._assign(name, value)
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    self._assign(target, value)
            case ast.AugAssign(target=target, op=op, value=value):
                self._assign(target, ast.copy_location(ast.BinOp(target, op, value), node))
            case ast.If(test=test, body=body, orelse=other):
                self._kind(test)
                self._all(body + other)
            case ast.While(test=test, body=body, orelse=[]):
                self._kind(test)
                self._all(body)
            case ast.For(
                target=ast.Name(id=name),
                iter=ast.Call(func=ast.Name(id=ranged), args=bounds),
                body=body,
                orelse=[],
            ) if ranged in RANGES:
                for bound in bounds:
                    if self._kind(bound) != INT:
                        raise self._refuse(bound, "a bound that is not whole")
                if len(bounds) > 2 and self.function.number(bounds[2]) not in (1, -1):
                    raise self._refuse(bounds[2], "a step that is not 1 or -1")
                self._set(name, INT, node)
                self._all(body)
                changed = {one for b in body for one in _assigned_in(b)}
                if name in changed or any(changed & _names(b) for b in bounds):
                    raise self._refuse(node.iter, "a bound or a counter that the loop changes")
            case ast.Return(value=value):
                kind = NONE if value is None else self._kind(value)
                if not _becomes(kind, self.function.result):
                    raise self._refuse(node, f"the result is {self.function.result}")
            case ast.Expr(value=ast.Call() as call):
                self._kind(call)
            case ast.Break() | ast.Continue() | ast.Pass():
                pass
            case _:
                raise self._refuse(node, "no statement of a scalar function")

    def _all(self, statements: Iterable[ast.stmt]) -> None:
        for one in statements:
            self._statement(one)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        kind = self._kind(value)
        if isinstance(target, ast.Name):
            self._set(target.id, kind, value)
            if kind in ARRAYS:
                self._views.append((target.id, _array_of(value)))
        elif isinstance(target, ast.Subscript) and isinstance(target.value, ast.Name):
            self._kind(target)
            self.function.written.add(target.value.id)
        else:
            raise self._refuse(target, "no place of a number")

    def _set(self, name: str, kind: str, node: ast.AST) -> None:
        declared = self.function.variables.get(name) or self.function.parameters.get(name)
        if declared is None:
            self.function.variables[name] = kind
        elif declared != kind and not (declared in (FLOAT, VALUE) and kind == INT):
            raise self._refuse(node, f"'{name}' is {declared} and {kind}")

    def _kind(self, node: ast.expr) -> str:
        kind = self.function.kinds[node] = self._found(node)
        return kind

    def _found(self, node: ast.expr) -> str:
        function = self.function
        if isinstance(node, ast.Constant) and isinstance(node.value, bool):
            return BOOL
        value = self.function.number(node)
        if value is not None:
            return INT if isinstance(value, int) else FLOAT
        match node:
            case ast.Name(id=name):
                kind = function.variables.get(name) or function.parameters.get(name)
                if kind is None:
                    raise self._refuse(node, "a name without a value")
                return kind
            case ast.Subscript(
                value=ast.Name(id=name), slice=ast.Slice(lower=lower, upper=None, step=None)
            ):
                if lower is not None:
                    self._kind(lower)
                return function.kind(name)
            case ast.Subscript(value=ast.Name(id=name), slice=place) if not isinstance(
                place, ast.Slice
            ):
                if self._kind(place) != INT or (self.function.number(place) or 0) < 0:
                    raise self._refuse(node, "an entry whose place is not a whole number from 0 on")
                return ARRAYS[function.kind(name)]
            case ast.BinOp(left=left, op=op, right=right):
                kinds = {self._kind(left), self._kind(right)}
                real = isinstance(op, ast.Add | ast.Sub | ast.Mult | ast.Div)
                if not real and (kinds & {FLOAT, VALUE} or not isinstance(op, WHOLE)):
                    raise self._refuse(node, "an operator that scalar functions lack")
                return common(kinds | ({FLOAT} if isinstance(op, ast.Div) else set()))
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                self._kind(inner)
                return BOOL
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return self._kind(inner)
            case ast.Compare(left=left, comparators=others):
                for one in (left, *others):
                    self._kind(one)
                return BOOL
            case ast.BoolOp(values=values):
                if any(self._kind(one) != BOOL for one in values):
                    raise self._refuse(node, "'and' or 'or' of numbers")
                return BOOL
            case ast.IfExp(test=test, body=a, orelse=b):
                self._kind(test)
                kinds = {self._kind(a), self._kind(b)}
                return kinds.pop() if len(kinds) == 1 else common(kinds)
            case ast.Call(func=called, args=arguments, keywords=[]):
                return self._called(node, ast.unparse(called), arguments)
        raise self._refuse(node, "no expression of a scalar function")

    def _called(self, node: ast.Call, name: str, arguments: list[ast.expr]) -> str:
        self.function.calls[node] = name
        if name in ("leaf", "part"):
            for one in arguments[1:]:
                self._kind(one)
            self.function.leaves[ast.literal_eval(arguments[0])] = None
            self.function.written |= {"w"} if name == "leaf" else {"s", "w"}
            return NONE
        kinds = [self._kind(a) for a in arguments]
        if name in MACHINE:
            if name in _WRITTEN:
                self.function.written.add(_array_of(arguments[_WRITTEN[name]]))
            return MACHINE[name]
        if name in BUILT_IN:
            if len(kinds) != 1 + (name in ("min", "max")):
                raise self._refuse(node, f"'{name}' of {len(kinds)} values")
            return BUILT_IN[name] or common(set(kinds))
        if name not in self.known.functions:
            raise self._refuse(node, "an unknown function")
        called = self.known.functions[name]
        for argument, (parameter, kind) in zip(arguments, called.parameters.items(), strict=True):
            if not _becomes(self.function.kinds[argument], kind):
                raise self._refuse(argument, f"'{parameter}' of '{name}' is {kind}")
            if parameter in called.written:
                self.function.written.add(_array_of(argument))
        return called.result


_WRITTEN = {"copy": 3, "add": 0, "most": 0}
"""Which argument of a function of `MACHINE` is an array that it writes to."""


def _names(node: ast.AST) -> set[str]:
    return {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}


def _assigned_in(node: ast.AST) -> set[str]:
    """The names that a statement, or one inside it, gives another value."""
    stored = (one for one in ast.walk(node) if isinstance(one, ast.Name))
    return {one.id for one in stored if isinstance(one.ctx, ast.Store)}


def _reads(value: ast.expr, target: ast.expr) -> bool:
    """Whether a value depends on what is assigned to the target, or may depend on it."""
    name = ast.unparse(target.value) if isinstance(target, ast.Subscript) else ast.unparse(target)
    return name in _names(value)


def _becomes(kind: str, wanted: str) -> bool:
    """Whether a value of a kind is given where another is wanted."""
    numbers = (INT, FLOAT, VALUE)
    if kind == wanted or (kind == BOOL and wanted == INT):
        return True
    return kind in numbers and wanted in numbers[1:]


def _annotated(node: ast.expr | None) -> str:
    return NONE if node is None else ast.unparse(node)


def _array_of(node: ast.expr) -> str:
    """The name of the array that a view is a part of."""
    while not isinstance(node, ast.Name):
        node = node.value if isinstance(node, ast.Subscript) else ast.Name("")
    return node.id
