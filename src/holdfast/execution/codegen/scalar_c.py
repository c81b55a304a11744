"""Scalar functions as C99, with the same operations in the same order as the compiled ones."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable, Sequence

from holdfast.execution.codegen.scalar_reader import (
    ARRAYS,
    BOOL,
    FLOAT,
    FLOATS,
    INT,
    NONE,
    TABLE,
    WHOLES,
    ScalarFunction,
    Scalars,
)

_TYPES = {INT: "long", FLOAT: "double", BOOL: "int", NONE: "void"}
_ELEMENTS = {FLOATS: "double", WHOLES: "long", TABLE: "hf_table"}
_OPERATORS = {
    ast.Add: ("+", 5), ast.Sub: ("-", 5), ast.Mult: ("*", 6), ast.Div: ("/", 6), ast.Mod: ("%", 6),
    ast.FloorDiv: ("/", 6), ast.RShift: (">>", 0), ast.LShift: ("<<", 0), ast.BitAnd: ("&", 0),
    ast.BitOr: ("|", 0), ast.Lt: ("<", 3),
    ast.LtE: ("<=", 3), ast.Gt: (">", 3), ast.GtE: (">=", 3), ast.Eq: ("==", 3),
    ast.NotEq: ("!=", 3), ast.And: ("&&", 2), ast.Or: ("||", 1),
}  # fmt: skip
"""The operator and how strongly it binds; 0: always in parentheses."""
_CALLED = {
    "abs": "fabs", "int": "(long)", "float": "(double)", "math.sqrt": "sqrt",
    "math.floor": "floor", "math.isnan": "isnan", "math.isfinite": "isfinite",
}  # fmt: skip
_ATOM, _PREFIX = 9, 7


def scalars_c(known: Scalars, roots: Sequence[str]) -> str:
    """The text of these functions and of those that they call, named hf_ and their name.

    An entry of a `Table` has the type hf_table, which the text before it has to define.
    """
    text = "\n".join(_Printer(known, f).text() for f in known.needed(roots))
    helpers = [f"static {body}\n" for name, body in _HELPERS.items() if f"hf_{name}(" in text]
    return "\n".join([*helpers, text])


_HELPERS = {
    "min": "double hf_min(double a, double b) {\n    return b < a ? b : a;\n}",
    "max": "double hf_max(double a, double b) {\n    return b > a ? b : a;\n}",
    "min_whole": "long hf_min_whole(long a, long b) {\n    return b < a ? b : a;\n}",
    "max_whole": "long hf_max_whole(long a, long b) {\n    return b > a ? b : a;\n}",
    "abs_whole": "long hf_abs_whole(long a) {\n    return a < 0 ? -a : a;\n}",
}
"""As Python has them: `min` and `max` give the first, unless the second is beyond it."""


class _Printer:
    def __init__(self, known: Scalars, function: ScalarFunction) -> None:
        self.known, self.function = known, function
        self.lines: list[str] = []
        self.depth = 1

    def text(self) -> str:
        f = self.function
        parameters = ", ".join(self._declared(n) for n in f.parameters)
        heading = f"static {_TYPES[f.result]} hf_{f.name}({parameters}) {{"
        self._head()
        self._all(f.body)
        comment = " ".join(f.text.partition("\n\n")[0].split())
        return "\n".join([*_wrapped(comment), *_folded(heading), *self.lines, "}", ""])

    def _declared(self, name: str) -> str:
        kind = self.function.kind(name)
        if kind not in ARRAYS:
            return f"{_TYPES[kind]} {name}"
        const = "" if name in self.function.written else "const "
        return f"{const}{_ELEMENTS[kind]} *{name}"

    def _head(self) -> None:
        """The variables, a line for each kind."""
        found: dict[str, list[str]] = {}
        for name, kind in self.function.variables.items():
            of = self._declared(name)[: -len(name)]
            zero = "NULL" if kind in ARRAYS else "0.0" if kind == FLOAT else "0"
            star = "*" if kind in ARRAYS else ""
            found.setdefault(of.rstrip("*"), []).append(f"{star}{name} = {zero}")
        for of, names in found.items():
            self._line(f"{of}{', '.join(names)};")

    # -- statements

    def _all(self, statements: Iterable[ast.stmt]) -> None:
        for one in statements:
            self._statement(one)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                for name, one in zip(names, values, strict=True):
                    self._assign(name, self._text(one))
            case ast.Assign(targets=targets, value=value):
                self._assign(targets[0], self._text(value))
                for target in targets[1:]:
                    self._assign(target, self._text(targets[0]))
            case ast.AugAssign(target=target, op=op, value=value):
                symbol = _OPERATORS[type(op)][0]
                self._line(f"{self._text(target)} {symbol}= {self._text(value)};")
            case ast.If(test=test, body=body, orelse=other):
                self._line(f"if ({self._text(test)}) {{")
                self._inside(body)
                while len(other) == 1 and isinstance(other[0], ast.If):
                    self._line(f"}} else if ({self._text(other[0].test)}) {{")
                    self._inside(other[0].body)
                    other = other[0].orelse
                if other:
                    self._line("} else {")
                    self._inside(other)
                self._line("}")
            case ast.While(test=test, body=body):
                self._line(f"while ({self._text(test)}) {{")
                self._inside(body)
                self._line("}")
            case ast.For(target=ast.Name(id=name), iter=ast.Call(args=bounds), body=body):
                first, last = (bounds[0], bounds[1]) if len(bounds) > 1 else (None, bounds[0])
                start = self._text(first) if first is not None else "0"
                below = f"{name} < {self._text(last, 4)}"
                turn = f"{name}++"
                if len(bounds) > 2 and self.function.number(bounds[2]) == -1:
                    below, turn = f"{name} > {self._text(last, 4)}", f"{name}--"
                self._line(f"for ({name} = {start}; {below}; {turn}) {{")
                self._inside(body)
                self._line("}")
            case ast.Return(value=value):
                self._line("return;" if value is None else f"return {self._text(value)};")
            case ast.Expr(value=value):
                self._line(f"{self._text(value)};")
            case ast.Break():
                self._line("break;")
            case ast.Continue():
                self._line("continue;")

    def _inside(self, body: list[ast.stmt]) -> None:
        self.depth += 1
        self._all(body)
        self.depth -= 1

    def _assign(self, target: ast.expr, value: str) -> None:
        self._line(f"{self._text(target)} = {value};")

    # -- expressions

    def _text(self, node: ast.expr, least: int = 0) -> str:
        text, strength = self._found(node)
        return f"({text})" if strength < least else text

    def _found(self, node: ast.expr) -> tuple[str, int]:
        if isinstance(node, ast.Constant) and isinstance(node.value, bool):
            return str(int(node.value)), _ATOM
        value = self.function.number(node)
        if value is not None:
            return _number(value), _ATOM if value >= 0 else _PREFIX
        match node:
            case ast.Name(id=name):
                return name, _ATOM
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Slice(lower=lower)):
                return (name, _ATOM) if lower is None else (f"{name} + {self._text(lower, 5)}", 5)
            case ast.Subscript(value=ast.Name(id=name), slice=place):
                return f"{name}[{self._text(place)}]", _ATOM
            case ast.BinOp(left=left, op=op, right=right):
                symbol, strength = _OPERATORS[type(op)]
                a, b = self._text(left, strength), self._text(right, strength + 1)
                if isinstance(op, ast.Div) and self.function.kinds[left] == INT:
                    a = f"(double){self._text(left, _PREFIX)}"
                return (
                    (f"{a} {symbol} {b}", strength) if strength else (f"({a} {symbol} {b})", _ATOM)
                )
            case ast.UnaryOp(op=op, operand=inner):
                sign = "!" if isinstance(op, ast.Not) else "-"
                least = _ATOM if sign == "-" else _PREFIX  # two signs would be another operator
                return f"{sign}{self._text(inner, least)}", _PREFIX
            case ast.Compare(left=left, ops=tests, comparators=others):
                pairs = zip((left, *others), tests, others, strict=False)
                texts = [
                    f"{self._text(a, 4)} {_OPERATORS[type(t)][0]} {self._text(b, 4)}"
                    for a, t, b in pairs
                ]
                return (texts[0], 3) if len(texts) == 1 else (f"({' && '.join(texts)})", _ATOM)
            case ast.BoolOp(op=op, values=values):
                symbol, strength = _OPERATORS[type(op)]
                return f" {symbol} ".join(self._text(v, 3) for v in values), strength
            case ast.IfExp(test=test, body=a, orelse=b):
                return f"{self._text(test, 1)} ? {self._text(a, 1)} : {self._text(b, 1)}", 0
            case ast.Call(args=arguments):
                return self._called(self.function.calls[node], arguments)
        raise AssertionError(ast.dump(node))

    def _called(self, name: str, arguments: Sequence[ast.expr]) -> tuple[str, int]:
        if name in ("min", "max", "abs"):
            whole = all(self.function.kinds[a] == INT for a in arguments)
            name += "_whole" if whole else ""
        if name in ("int", "float"):
            return f"{_CALLED[name]}{self._text(arguments[0], _PREFIX)}", _PREFIX
        called = _CALLED.get(name) or f"hf_{name}"
        return f"{called}({', '.join(self._text(a) for a in arguments)})", _ATOM

    def _line(self, text: str) -> None:
        self.lines += _folded("    " * self.depth + text)


def _number(value: float) -> str:
    if isinstance(value, int) or math.isfinite(value):
        return repr(value)
    return "NAN" if math.isnan(value) else "INFINITY" if value > 0 else "-INFINITY"


def _folded(line: str, width: int = 100) -> list[str]:
    """The line, or several that end after a comma or before an operator."""
    indent = " " * (len(line) - len(line.lstrip()) + 8)
    found = []
    while len(line) > width:
        ends = [line.rfind(", ", 0, width) + 1]
        ends += [line.rfind(f" {op} ", 0, width) for op in ("&&", "||", "?", ":", "+", "-", ">")]
        cut = max(ends)
        if cut <= len(indent):
            break
        found.append(line[:cut].rstrip())
        line = indent + line[cut:].lstrip()
    return [*found, line]


def _wrapped(text: str) -> list[str]:
    """A comment."""
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + len(word) < 96:
            lines[-1] += f" {word}"
        else:
            lines.append(f"{' * ' if lines else '/* '}{word}")
    return [*lines[:-1], f"{lines[-1]} */"] if lines else []
