"""A computation as a list of steps, each one operation that IEEE 754 defines to the last bit.

Targets print the steps, such as `codegen/llvm_text.py`. Every operation is exactly rounded, and no
target may contract or reorder them, so that all targets give the same bits. There are no branches:
a comparison selects between two values. A rare case, such as the sine of 1e300, has steps of its
own, which a target may skip where no value needs them.

Sums and products with their rounding errors are pairs of floats that are exact. The choices and
angles of control laws that C lacks (`maths/expressions/functions.py`) are functions of steps.
"""

from __future__ import annotations

import inspect
import math
import struct
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

LEAST_SINGLE = float(np.float32(1e-19))
"""What stands for a positive number that single precision has not: its inverse times any gain that
is as large is finite."""

FLOAT, WHOLE, TRUTH = "float", "whole", "truth"
"""Kinds of values: binary64, 64 bits as an integer, and a truth value."""

ONE_FLOAT = ("neg", "abs", "sqrt", "floor", "ceil", "rint")
TWO_FLOATS = ("add", "sub", "mul", "div")
COMPARISONS = ("lt", "le", "eq", "ne")
"""False for NaN, except `ne`."""
TRUTHS = ("both", "either")
WHOLES = ("iadd", "isub", "imul", "iand", "ior", "ixor", "shl", "shr")
"""Modulo 2^64; `shr` is logical."""


@dataclass(frozen=True, eq=False)
class Value:
    """The result of a step, with Python's operators."""

    steps: Steps
    number: int
    kind: str

    def _with(self, operation: str, other: Operand, *, swapped: bool = False) -> Value:
        pair = (self, self.steps.lifted(other, self.kind))
        return self.steps.step(operation, *(pair[::-1] if swapped else pair))

    def _float_or_whole(self, name: str, other: Operand, *, swapped: bool = False) -> Value:
        return self._with(name if self.kind == FLOAT else f"i{name}", other, swapped=swapped)

    def __add__(self, other: Operand) -> Value:
        return self._float_or_whole("add", other)

    def __radd__(self, other: Operand) -> Value:
        return self._float_or_whole("add", other, swapped=True)

    def __sub__(self, other: Operand) -> Value:
        return self._float_or_whole("sub", other)

    def __rsub__(self, other: Operand) -> Value:
        return self._float_or_whole("sub", other, swapped=True)

    def __mul__(self, other: Operand) -> Value:
        return self._float_or_whole("mul", other)

    def __rmul__(self, other: Operand) -> Value:
        return self._float_or_whole("mul", other, swapped=True)

    def __truediv__(self, other: Operand) -> Value:
        return self._with("div", other)

    def __rtruediv__(self, other: Operand) -> Value:
        return self._with("div", other, swapped=True)

    def __neg__(self) -> Value:
        return self.steps.step("neg", self)

    def __abs__(self) -> Value:
        return self.steps.step("abs", self)

    def __lt__(self, other: Operand) -> Value:
        return self._with("lt", other)

    def __le__(self, other: Operand) -> Value:
        return self._with("le", other)

    def __gt__(self, other: Operand) -> Value:
        return self._with("lt", other, swapped=True)

    def __ge__(self, other: Operand) -> Value:
        return self._with("le", other, swapped=True)

    def equals(self, other: Operand) -> Value:
        return self._with("eq" if self.kind == FLOAT else "ieq", other)

    def differs(self, other: Operand) -> Value:
        return self._with("ne", other)

    def __and__(self, other: Operand) -> Value:
        return self._with("both" if self.kind == TRUTH else "iand", other)

    def __or__(self, other: Operand) -> Value:
        return self._with("either" if self.kind == TRUTH else "ior", other)

    def __xor__(self, other: Operand) -> Value:
        return self._with("ixor", other)

    def __invert__(self) -> Value:
        return self.steps.step("not", self)

    def __lshift__(self, other: Operand) -> Value:
        return self._with("shl", other)

    def __rshift__(self, other: Operand) -> Value:
        return self._with("shr", other)


Operand = Value | float | int


@dataclass(frozen=True)
class Step:
    """One operation on earlier steps. `given`: a constant, an input's name, a function, a table;
    fused: as in `Steps`."""

    operation: str
    arguments: tuple[int, ...]
    kind: str
    given: Any = None
    fused: bool = False


class Steps:
    """A list of steps, in which equal ones are one.

    expanded: whether functions are replaced by their own steps, or called. single: whether floats
    are of single precision, whose bits are not to be had. fused: whether the steps to come are
    those of values whose last bit a target may choose: it may contract a product and a sum of such
    steps, and their floats have the precision that the values are stored in.
    """

    def __init__(self, expanded: bool, single: bool = False, fused: bool = False) -> None:
        self.expanded, self.single, self.fused = expanded, single, fused
        self.list: list[Step] = []
        self._known: dict[Any, Value] = {}

    def step(
        self, operation: str, *arguments: Value, immediate: Any = None, kind: str = ""
    ) -> Value:
        """The value of an operation; `kind` is that of the result, if it is open."""
        for a in arguments:
            if a.steps is not self:
                raise ValueError("a value of other steps")
        numbers = tuple([a.number for a in arguments])
        key = (operation, numbers, kind, _key(immediate), self.fused)
        value = self._known.get(key)
        if value is None:
            settled = kind or _kind(operation, arguments)
            value = self._known[key] = Value(self, len(self.list), settled)
            self.list.append(Step(operation, numbers, settled, immediate, self.fused))
        return value

    def input(self, name: str, kind: str = FLOAT) -> Value:
        """A value that the caller gives."""
        return self.step("input", immediate=name, kind=kind)

    def constant(self, value: float | int, kind: str) -> Value:
        if kind == FLOAT:
            return self.step("constant", immediate=float(value), kind=FLOAT)
        if kind != WHOLE or value != int(value):
            raise ValueError(f"{value!r} as {kind}")
        return self.step("constant", immediate=int(value) % 2**64, kind=WHOLE)

    def lifted(self, operand: Operand, kind: str) -> Value:
        return operand if isinstance(operand, Value) else self.constant(operand, kind)

    def rare(
        self, when: Value, usual: tuple[Value, ...], function: Function, *arguments: Value
    ) -> tuple[Value, ...]:
        """The results of `function` where `when` is true, else the usual ones."""
        whole = self.step("rare", when, *usual, *arguments, immediate=function, kind="several")
        return self._results(whole, function.kinds)

    def call(self, function: Function, *arguments: Value) -> tuple[Value, ...]:
        """The results of a function that is called."""
        whole = self.step("call", *arguments, immediate=function, kind="several")
        return self._results(whole, function.kinds)

    def repeat(self, results: Sequence[Value], inputs: Mapping[str, Value]) -> list[Value]:
        """The results of other steps, which become steps of these; `inputs` are what some of their
        inputs are here, and the rest are inputs here too."""
        other, here = results[0].steps, dict[int, Value]()
        fused, self.fused = self.fused, other.fused
        for number in other.needed([v.number for v in results]):
            step = other.list[number]
            value = inputs.get(step.given) if step.operation == "input" else None
            here[number] = value or self.step(
                step.operation, *(here[k] for k in step.arguments),
                immediate=step.given, kind=step.kind,
            )  # fmt: skip
        self.fused = fused
        return [here[v.number] for v in results]

    def needed(
        self, results: Sequence[int], computed: Collection[int] = (), *, always: bool = False
    ) -> list[int]:
        """The steps that the results depend on, in order; those of computed ones are not.

        always: without those that only the unusual value of `only_where` depends on.
        """
        numbers: set[int] = set()
        waiting = list(results)
        while waiting:
            number = waiting.pop()
            if number not in numbers:
                numbers.add(number)
                step = self.list[number]
                if number not in computed:
                    unusual = always and step.operation == WHERE
                    waiting.extend(step.arguments[:2] if unusual else step.arguments)
        return sorted(numbers)

    def _results(self, whole: Value, kinds: tuple[str, ...]) -> tuple[Value, ...]:
        return tuple(
            self.step("result", whole, immediate=i, kind=kind) for i, kind in enumerate(kinds)
        )


class Function:
    """A named function of floats, which is made of steps."""

    def __init__(self, definition: Callable[..., Any]) -> None:
        self.definition = definition
        self.name = definition.__name__
        self.text = inspect.getdoc(definition) or ""
        self.parameters = tuple(inspect.signature(definition).parameters)

    def __call__(self, *arguments: Operand) -> Any:
        steps = next(a.steps for a in arguments if isinstance(a, Value))
        values = [steps.lifted(a, FLOAT) for a in arguments]
        if steps.expanded:
            return self.definition(*values)
        results = steps.call(self, *values)
        return results if len(results) > 1 else results[0]

    def traced(self, expanded: bool) -> tuple[Steps, list[Value]]:
        """Its steps for inputs of the names of its parameters, and its results."""
        steps = Steps(expanded)
        results = self.definition(*(steps.input(name) for name in self.parameters))
        return steps, list(results) if isinstance(results, tuple) else [results]

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        return tuple(v.kind for v in self.traced(expanded=True)[1])


def in_single(value: float) -> float:
    """A constant of code in single precision: what is added to a divisor does not vanish."""
    with np.errstate(over="ignore", under="ignore"):
        short = float(np.float32(value))
    return short if short or not value else math.copysign(LEAST_SINGLE, value)


def choose(condition: Value, a: Operand, b: Operand) -> Value:
    """a where the condition is true, else b."""
    kind = next((v.kind for v in (a, b) if isinstance(v, Value)), FLOAT)
    steps = condition.steps
    return steps.step("choose", condition, steps.lifted(a, kind), steps.lifted(b, kind))


WHERE = "where"
"""The operation of `only_where`."""


def only_where(condition: Value, value: Value, usual: Value) -> Value:
    """A value that is the usual one where the condition is false.

    A target may skip the steps that no other value needs, where the condition holds for none of
    what it computes together. They belong to one such value.
    """
    return condition.steps.step(WHERE, condition, usual, value, kind=usual.kind)


def _operation(name: str) -> Callable[[Value], Value]:
    def apply(x: Value) -> Value:
        return x.steps.step(name, x)

    return apply


root, floor, ceil, rint = map(_operation, ("sqrt", "floor", "ceil", "rint"))
bits, from_bits = map(_operation, ("bits", "from_bits"))


def entry(table: tuple[int, ...], place: Value) -> Value:
    """The entry of a table of integers; `place` is within it."""
    return place.steps.step("entry", place, immediate=table, kind=WHOLE)


_KINDS: dict[str, tuple[tuple[str, ...], str]] = {
    **dict.fromkeys(ONE_FLOAT, ((FLOAT,), FLOAT)),
    **dict.fromkeys(TWO_FLOATS, ((FLOAT, FLOAT), FLOAT)),
    **dict.fromkeys(COMPARISONS, ((FLOAT, FLOAT), TRUTH)),
    **dict.fromkeys(TRUTHS, ((TRUTH, TRUTH), TRUTH)),
    **dict.fromkeys(WHOLES, ((WHOLE, WHOLE), WHOLE)),
    "not": ((TRUTH,), TRUTH),
    "ieq": ((WHOLE, WHOLE), TRUTH),
    "bits": ((FLOAT,), WHOLE),
    "from_bits": ((WHOLE,), FLOAT),
}


def _kind(operation: str, arguments: tuple[Value, ...]) -> str:
    kinds = tuple(a.kind for a in arguments)
    same = (TRUTH, kinds[-1], kinds[-1])
    expected, result = (same, kinds[-1]) if operation == "choose" else _KINDS[operation]
    if kinds != expected:
        raise ValueError(f"{operation} of {kinds}")
    return result


def _key(immediate: Any) -> Any:
    return struct.pack("<d", immediate) if isinstance(immediate, float) else immediate


SPLIT = 134217729.0
"""2^27 + 1 (T. J. Dekker, Numer. Math. 18, 1971)."""

Pair = tuple[Value, Value]


def exact_sum(a: Value, b: Value) -> Pair:
    """(s, e): s = a + b rounded, s + e = a + b exactly (D. E. Knuth)."""
    s = a + b
    c = s - a
    return s, (a - (s - c)) + (b - c)


def ordered_sum(a: Value, b: Value) -> Pair:
    """`exact_sum` of |a| >= |b|."""
    s = a + b
    return s, b - (s - a)


def halves(a: Value) -> Pair:
    """Two floats of 26 bits whose sum is a."""
    c = a * SPLIT
    high = c - (c - a)
    return high, a - high


def exact_product(a: Value, b: Value) -> Pair:
    """(p, e): p = a b rounded, p + e = a b exactly, where nothing underflows (Dekker)."""
    p = a * b
    a1, a2 = halves(a)
    b1, b2 = halves(b)
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def with_sign_of(a: Value, b: Value) -> Value:
    """a >= 0 with the sign of b, also that of a zero."""
    return from_bits(bits(a) | (bits(b) & SIGN))


def least_of(a: Value, b: Operand) -> Value:
    """The smaller of two; b if a is NaN."""
    return choose(a < b, a, b)


def greatest_of(a: Value, b: Operand) -> Value:
    """The larger of two; b if a is NaN."""
    return choose(a > b, a, b)


SIGN = 1 << 63


TWO_PI = 6.283185307179586
PI = 3.141592653589793


@Function
def wrap(x: Value) -> Value:
    """An angle [rad] in (-pi, pi]."""
    return x - TWO_PI * ceil((x - PI) / TWO_PI)


# NaN propagates through every choice: a comparison must not hide it


@Function
def least(a: Value, b: Value) -> Value:
    """The smaller of two; NaN if either is NaN."""
    return choose(a.differs(a), a, choose(a < b, a, b))


@Function
def greatest(a: Value, b: Value) -> Value:
    """The larger of two; NaN if either is NaN."""
    return choose(a.differs(a), a, choose(a > b, a, b))


@Function
def sgn(x: Value) -> Value:
    """+1 for x >= 0, else -1."""
    return choose(x >= 0.0, 1.0, choose(x < 0.0, -1.0, x))


@Function
def sign(x: Value) -> Value:
    """The sign with sign(0) = 0, the derivative of the magnitude."""
    return choose(x > 0.0, 1.0, choose(x < 0.0, -1.0, 0.0 * x))


@Function
def select(x: Value, a: Value, b: Value) -> Value:
    """a for x >= 0, else b."""
    return choose(x >= 0.0, a, choose(x < 0.0, b, x))


@Function
def length(x: Value, y: Value) -> Value:
    """sqrt(x^2 + y^2)."""
    return root(x * x + y * y)
