"""Scalar functions: a small part of Python, read once and printed for LLVM and for C.

What a leaf cannot be, because it has loops whose length depends on numbers, is written as Python
functions of numbers and arrays, such as `simulation/quadratic_program.py` and
`level_set/sweep.py`. LLVM compiles the text (`scalar_llvm.py`); an exported law contains it as C
(`scalar_c.py`); Python runs it as it is, except for the functions of `MACHINE`.

A parameter is `int`, `float`, `bool`, `Value` (a float in the precision of a march), or an array of
one dimension: `Floats`, `Wholes`, `Flags` (bytes), `Values`, and `Table` (floats that may be stored
in single precision). A function returns one of the numbers, or nothing. Its statements are
assignments of numbers and of parts of arrays (`rows[k:]`), `if`, `while`, `for ... in range(...)`,
`break`, `continue`, `return`, and calls; its expressions consist of arithmetic, comparisons, `and`,
`or`, `not`, `a if b else c`, the functions of `BUILT_IN`, functions of the same text or that it
imports by name, and constants. Python's `%` and `//` are for numbers that are not negative.
`math.floor` gives a float.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

INT, FLOAT, VALUE, BOOL, NONE = "int", "float", "Value", "bool", "None"
FLOATS, WHOLES, FLAGS, VALUES, TABLE = "Floats", "Wholes", "Flags", "Values", "Table"
ARRAYS: Mapping[str, str] = {
    FLOATS: FLOAT, WHOLES: INT, FLAGS: INT, VALUES: VALUE, TABLE: FLOAT,
}  # fmt: skip
"""The kinds of arrays, and of their entries."""
KINDS = {INT, FLOAT, VALUE, BOOL, NONE, *ARRAYS}

MACHINE: Mapping[str, str] = {
    "table_at": TABLE, "values_at": VALUES, "address": INT, "call": NONE, "copy": NONE,
    "take": INT, "look": INT,
}  # fmt: skip
"""What has a meaning in machine code alone, and the kind of the result.

table_at(k), values_at(k): the array at an address. address(a, k): of an entry. call(k, ...): the
machine code at an address, with whole numbers. copy(a, i, count, b, j): count entries of a from i
on to b from j on. take(a), look(a): a[0] by an atomic operation; `take` increments it.
"""
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
        own = self.parameters.keys() | self.variables.keys()
        return constant(node, {k: v for k, v in self.constants.items() if k not in own})


@dataclass
class Scalars:
    """The functions and constants of a text, with those of the texts that it imports."""

    functions: dict[str, ScalarFunction]
    constants: dict[str, Number]

    def needed(self, roots: Iterable[str]) -> list[ScalarFunction]:
        """The functions that these call, each before those that call it."""
        found: dict[str, ScalarFunction] = {}

        def add(name: str) -> None:
            if name not in found:
                for called in self.functions[name].calls.values():
                    if called in self.functions:
                        add(called)
                found[name] = self.functions[name]

        for name in roots:
            add(name)
        return list(found.values())


def constant(node: ast.expr, known: Mapping[str, Number]) -> Number | None:
    """The number that an expression is, whatever the arguments are; None for others."""
    match node:
        case ast.Constant(value=int() | float() as value):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            found = constant(inner, known)
            return None if found is None else -found
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _FOLDED:
            a, b = constant(left, known), constant(right, known)
            return None if a is None or b is None else _FOLDED[type(op)](a, b)
        case ast.Attribute(value=ast.Name(id="math"), attr="inf" | "nan" | "pi" as name):
            return float(getattr(math, name))
        case ast.Attribute():
            return known.get(ast.unparse(node))
        case ast.Name(id=name):
            return known.get(name)
    return None


_FOLDED: Mapping[type[ast.operator], Callable[[Number, Number], Number]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv, ast.LShift: operator.lshift,
}  # fmt: skip


def common(kinds: Collection[str]) -> str:
    """The kind of a result of numbers of these kinds."""
    return next((k for k in (VALUE, FLOAT) if k in kinds), INT)
