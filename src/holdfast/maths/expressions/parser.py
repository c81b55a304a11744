"""Parser of scenario-file expressions: arithmetic, declared names and listed functions.

The text is parsed to Python's syntax tree and only the nodes named below are translated;
nothing is ever evaluated as code. Conditions become level expressions: a condition holds
where its expression is >= 0 (`<` and `<=` mean the same), `and` is the least, `or` the
greatest of its parts, `not` changes the sign.
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Mapping

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import ExpressionError, suggestion
from holdfast.maths.expressions.functions import (
    FUNCTIONS,
    PROCESSES,
    greatest,
    least,
    pairwise,
    select,
)
from holdfast.maths.expressions.traversal import syntax_tree

MAX_LENGTH = 2000
MAX_DEPTH = 60
MAX_EXPONENT = 64
MAX_SIZE = 5000
MAX_TREE_DEPTH = 150

NUMERIC: dict[str, Callable[[float], float]] = {
    name: getattr(math, name)
    for name in [
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "sinh",
        "cosh",
        "tanh",
        "exp",
        "log",
        "sqrt",
    ]
}
"""Functions of numbers are folded in floating point: SymPy would try to be exact."""

FORBIDDEN = {
    ast.Attribute: "attribute access",
    ast.Subscript: "indexing",
    ast.Lambda: "a lambda",
    ast.List: "a list",
    ast.Tuple: "a tuple",
    ast.Dict: "a dictionary",
    ast.Set: "a set",
    ast.ListComp: "a comprehension",
    ast.GeneratorExp: "a comprehension",
    ast.JoinedStr: "a string",
    ast.Starred: "an unpacked argument",
    ast.NamedExpr: "an assignment",
    ast.Await: "await",
}


@checked
def parse_expression(text: object, names: Mapping[str, sp.Expr]) -> sp.Expr:
    """The expression written in `text`.

    text: arithmetic, functions such as cos, and the names; a number stands for itself. names: every
    declared name -> its symbol.

    Raises `ExpressionError` for an unknown name, a forbidden construct, a number or power out of
    range, or text that is too long or nested too deep.

    >>> hf.parse_expression("2*cos(v) - x", {"x": x, "v": v})
    -x + 2*cos(v)
    """
    return _parsed(text, names, processes=True)


@checked
def parse_formula(text: object, names: Mapping[str, sp.Expr]) -> sp.Expr:
    """`parse_expression` without stochastic processes, which only a disturbance may have."""
    return _parsed(text, names, processes=False)


def of_names(text: str) -> sp.Expr:
    """The expression of a text, in which every name is a quantity."""
    translator = _Translator(text, {}, processes=True)
    names = {node.id for node in ast.walk(translator.tree) if isinstance(node, ast.Name)}
    translator.names = {name: sp.Symbol(name, real=True) for name in names - {"pi"}}
    return translator.expression()


def _parsed(text: object, names: Mapping[str, sp.Expr], *, processes: bool) -> sp.Expr:
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        raise ExpressionError(f"got {text!r}", expected="an expression in quotes or a number")
    if isinstance(text, (int, float)):
        try:
            return _finite(float(text), str(text))
        except OverflowError:
            raise ExpressionError("a number is out of range", expected="a finite number") from None
    return _Translator(text, names, processes).expression()


@checked
def parse_condition(text: object, names: Mapping[str, sp.Expr]) -> sp.Expr:
    """The level expression of a condition such as "x < 0 and abs(y) > 0.5": >= 0 where it holds.

    text, names: as of `parse_expression`. Raises `ExpressionError` as that does.

    >>> hf.parse_condition("x < 1 and v > 0", {"x": x, "v": v})
    least(1 - x, v)
    """
    if not isinstance(text, str):
        raise ExpressionError(f"got {text!r}", expected="a condition in quotes")
    return _Translator(text, names).condition()


ONES = (sp.S.One, sp.S.NegativeOne)

ALSO = {"sign": "sgn", "ln": "log", "arctan2": "atan2", "arctan": "atan"}
"""Names that other languages have for functions."""


def _finite(value: float, shown: str) -> sp.Expr:
    if not math.isfinite(value):
        raise ExpressionError(f"the number {shown} is out of range", expected="a finite number")
    if value == int(value) and abs(value) < 1e15:
        return sp.Integer(int(value))
    return sp.Float(value)


def _extent(expression: sp.Expr) -> tuple[int, int]:
    """(number of nodes, depth) of an expression as a tree, counted without unfolding it."""
    extents: dict[sp.Basic, tuple[int, int]] = {}
    stack = [expression]
    while stack:
        node = stack[-1]
        missing = [a for a in node.args if a not in extents]
        if missing:
            stack += missing
            continue
        parts = [extents[a] for a in node.args]
        extents[node] = (
            1 + sum(size for size, _ in parts),
            1 + max((depth for _, depth in parts), default=0),
        )
        stack.pop()
    return extents[expression]


class _Translator:
    def __init__(self, text: str, names: Mapping[str, sp.Expr], processes: bool = False) -> None:
        self.text = text.strip()
        self.names = names
        self.functions = [n for n in FUNCTIONS if processes or n not in PROCESSES]
        if len(text) > MAX_LENGTH:
            raise ExpressionError(
                f"the expression has {len(text)} characters", expected=f"at most {MAX_LENGTH}"
            )
        try:
            with warnings.catch_warnings():  # "1if x else y" is one of them
                warnings.simplefilter("error", SyntaxWarning)
                self.tree = syntax_tree(self.text, "eval").body
        except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
            reason = getattr(error, "msg", None) or str(error) or type(error).__name__
            raise ExpressionError(
                f"'{self._shown()}' is not an expression ({reason})",
                expected='arithmetic such as "u*cos(theta)"',
            ) from None

    def _shown(self) -> str:
        return self.text if len(self.text) <= 60 else self.text[:57] + "..."

    def _refuse(self, what: str, expected: str = "", remedy: str = "") -> ExpressionError:
        return ExpressionError(f"{what} in '{self._shown()}'", expected=expected, remedy=remedy)

    def expression(self) -> sp.Expr:
        return self._value(self.tree, 0)

    def condition(self) -> sp.Expr:
        return self._level(self.tree, 0)

    def _checked(self, result: sp.Expr) -> sp.Expr:
        """Refuse an expression too large after substitution, and numbers out of range."""
        if result.is_Number:
            return self._number(float(result))
        if result in (sp.zoo, sp.nan, sp.oo, -sp.oo) or result.is_real is False:
            raise self._refuse("a value that is not a finite real number")
        size, depth = _extent(result)
        if size > MAX_SIZE or depth > MAX_TREE_DEPTH:
            raise self._refuse(
                "an expression that is too large once its definitions are put in",
                expected=f"at most {MAX_SIZE} terms, nested at most {MAX_TREE_DEPTH} deep",
            )
        return result

    def _number(self, value: float) -> sp.Expr:
        if not math.isfinite(value):
            raise self._refuse("a value that is not a finite real number")
        return _finite(value, "of an operation")

    def _value(self, node: ast.expr, depth: int) -> sp.Expr:
        if depth > MAX_DEPTH:
            raise self._refuse("too many nested parentheses", expected=f"at most {MAX_DEPTH}")
        match node:
            case ast.Constant(value=bool() | str() | bytes() | complex() | None):
                raise self._refuse(f"the constant {node.value!r}", expected="a number")
            case ast.Constant(value=int() | float() as value):
                try:
                    return _finite(float(value), f"{value:.6g}")
                except OverflowError:
                    raise self._refuse("a number out of range") from None
            case ast.Name(id=name):
                return self._name(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self._checked(-self._value(operand, depth + 1))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._value(operand, depth + 1)
            case ast.BinOp(left=left, op=operator, right=right):
                a, b = self._value(left, depth + 1), self._value(right, depth + 1)
                # A written factor of 1, which SymPy would drop, stays: it has a unit.
                if isinstance(operator, ast.Mult) and a in ONES and not b.is_number:
                    a = sp.Float(a)
                elif isinstance(operator, (ast.Mult, ast.Div)) and b in ONES and not a.is_number:
                    b = sp.Float(b)
                return self._checked(self._binary(operator, a, b))
            case ast.Call():
                return self._call(node, depth)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                level = self._level(test, depth + 1)
                branches = [self._value(part, depth + 1) for part in (body, orelse)]
                return self._checked(select(level, *branches))
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                raise self._refuse(
                    "a condition where a value is wanted", remedy=_value_in_place_of(node)
                )
        what = FORBIDDEN.get(type(node), f"the construct {type(node).__name__}")
        raise self._refuse(
            f"{what} is not allowed", expected="arithmetic, declared names and listed functions"
        )

    def _name(self, name: str) -> sp.Expr:
        if name in self.names:
            return self.names[name]
        if name == "pi":
            return sp.pi
        if name in self.functions:
            raise self._refuse(f"the function '{name}' without arguments")
        raise self._refuse(
            f"unknown name '{name}'",
            remedy=suggestion(name, [*self.names, "pi", *self.functions]),
        )

    def _binary(self, operator: ast.operator, left: sp.Expr, right: sp.Expr) -> sp.Expr:
        match operator:
            case ast.Add():
                return left + right
            case ast.Sub():
                return left - right
            case ast.Mult():
                return left * right
            case ast.Div():
                if right == 0:
                    raise self._refuse("division by zero")
                return left / right
            case ast.Pow():
                return self._power(left, right)
            case ast.BitXor():
                raise self._refuse("'^'", remedy="write ** for a power")
        raise self._refuse(f"the operator {type(operator).__name__}", expected="+ - * / **")

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> sp.Expr:
        if exponent.is_number:
            if abs(float(exponent)) > MAX_EXPONENT:
                raise self._refuse(
                    f"the exponent {float(exponent):.6g}",
                    expected=f"at most {MAX_EXPONENT} in magnitude",
                )
            if base == 0 and float(exponent) < 0:
                raise self._refuse("division by zero")
            if base.is_number:
                try:
                    value = float(base) ** float(exponent)
                except OverflowError:
                    raise self._refuse("a power out of range") from None
                if isinstance(value, complex):
                    raise self._refuse("a root of a negative number")
                return self._number(value)
        return base**exponent

    def _call(self, node: ast.Call, depth: int) -> sp.Expr:
        if not isinstance(node.func, ast.Name):
            raise self._refuse("a call of anything but a function name is not allowed")
        name = ALSO.get(node.func.id, node.func.id)
        if name == "diff":
            return self._derivative(node, depth)
        if name not in self.functions:
            apart = "only [disturbance] of closed loops may have it"
            raise self._refuse(
                f"the function '{name}' is not allowed",
                remedy=apart if name in PROCESSES else suggestion(name, [*self.functions, "diff"]),
            )
        if node.keywords or any(isinstance(a, ast.Starred) for a in node.args):
            raise self._refuse(f"'{name}' with named or unpacked arguments")
        fewest, most, function = FUNCTIONS[name]
        if not fewest <= len(node.args) <= most:
            wanted = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise self._refuse(
                f"'{name}' with {len(node.args)} arguments", expected=f"{wanted} arguments"
            )
        if name == "select":
            first = self._level(node.args[0], depth + 1)
            rest = node.args[1:]
            return self._checked(select(first, *(self._value(a, depth + 1) for a in rest)))
        arguments = [self._value(a, depth + 1) for a in node.args]
        if name in NUMERIC and arguments[0].is_number:
            try:
                return self._number(NUMERIC[name](float(arguments[0])))
            except (OverflowError, ValueError):
                raise self._refuse("a value that is not a finite real number") from None
        return self._checked(sp.sympify(function(*arguments)))

    def _derivative(self, node: ast.Call, depth: int) -> sp.Expr:
        variable = node.args[1] if len(node.args) == 2 else None
        if not isinstance(variable, ast.Name) or node.keywords:
            raise self._refuse("'diff' without a name", expected="diff(expression, name)")
        by = self._name(variable.id)
        if not by.is_Symbol:
            raise self._refuse(
                f"'diff' by the definition '{variable.id}'", expected="a state or parameter"
            )
        return self._checked(self._value(node.args[0], depth + 1).diff(by))

    def _level(self, node: ast.expr, depth: int) -> sp.Expr:
        if depth > MAX_DEPTH:
            raise self._refuse("too many nested parentheses", expected=f"at most {MAX_DEPTH}")
        match node:
            case ast.BoolOp(op=operator, values=values):
                fold = least if isinstance(operator, ast.And) else greatest
                return pairwise(fold)(*(self._level(v, depth + 1) for v in values))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return -self._level(operand, depth + 1)
            case ast.Compare(left=left, ops=operators, comparators=comparators):
                parts = []
                for relation, right in zip(operators, comparators, strict=True):
                    a, b = self._value(left, depth + 1), self._value(right, depth + 1)
                    if isinstance(relation, (ast.Lt, ast.LtE)):
                        parts.append(b - a)
                    elif isinstance(relation, (ast.Gt, ast.GtE)):
                        parts.append(a - b)
                    else:
                        raise self._refuse("a comparison other than < <= > >=")
                    left = right
                return pairwise(least)(*parts)
        return self._value(node, depth)


def parse_number(
    text: object, names: Mapping[str, sp.Expr], values: Mapping[sp.Symbol, float]
) -> float:
    """The number of an expression at these values; `ExpressionError` if it is not a number."""
    number = parse_formula(text, names).subs(values)
    if not (number.is_number and number.is_real and number.is_finite):
        raise ExpressionError(f"{number} is not a number", expected="a value from parameters")
    return float(number)


def _value_in_place_of(condition: ast.expr) -> str:
    """What to write: of `a <= b` that keeps a vehicle, what is at most 0 where it holds."""
    match condition:
        case ast.Compare(left=a, ops=[ast.Lt() | ast.LtE()], comparators=[b]):
            low, high = a, b
        case ast.Compare(left=a, ops=[ast.Gt() | ast.GtE()], comparators=[b]):
            low, high = b, a
        case _:
            return "write 'a if condition else b'"
    below = ast.unparse(ast.BinOp(low, ast.Sub(), high))
    return (
        f"for an inequality write what is at most 0 where it holds, '{below}', "
        "for a choice 'a if condition else b'"
    )
