"""Intervals with interval slopes, of formulas written as text, over many boxes at once.

An `Enclosure` has lower and upper bounds of a function over boxes, and of its partial derivatives
(generalised ones, of F. H. Clarke, where `abs`, `min` and `max` have kinks). Bounds are widened by
1e-12 of their size at every operation, which is more than rounding. Source: R. E. Moore, Interval
Analysis, 1966; A. Griewank and A. Walther, Evaluating Derivatives, 2008 (forward mode).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import CodeType
from typing import Any

import numpy as np

Array = np.ndarray
WIDER = 1e-12
"""Of the size of a bound: what every operation adds to it."""


def outward(low: Array, high: Array) -> tuple[Array, Array]:
    """The bounds a little further apart."""
    return low - WIDER * np.abs(low) - 1e-300, high + WIDER * np.abs(high) + 1e-300


def product(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    """Of two intervals."""
    corners = [p * q for p in a for q in b]
    low = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
    high = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
    return outward(low, high)


def plus(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    return outward(a[0] + b[0], a[1] + b[1])


def hull(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def range_of_sine(low: Array, high: Array) -> tuple[Array, Array]:
    """The least and the largest sine between two angles."""
    ends = np.sin(low), np.sin(high)
    quarter = np.pi / 2

    def passes(place: float) -> Array:
        return np.floor((high - place) / (2 * np.pi)) >= np.ceil((low - place) / (2 * np.pi))

    return outward(
        np.where(passes(-quarter), -1.0, np.minimum(*ends)),
        np.where(passes(quarter), 1.0, np.maximum(*ends)),
    )


@dataclass(frozen=True)
class Enclosure:
    """Bounds (low, high) of a value, and of its slopes by each counted variable."""

    value: tuple[Array, Array]
    slopes: Mapping[int, tuple[Array, Array]]

    def _chain(self, value: tuple[Array, Array], slope: tuple[Array, Array]) -> Enclosure:
        return Enclosure(value, {k: product(slope, s) for k, s in self.slopes.items()})

    def __add__(self, other: Any) -> Enclosure:
        o = enclosed(other)
        slopes = dict(self.slopes)
        for k, s in o.slopes.items():
            slopes[k] = plus(slopes[k], s) if k in slopes else s
        return Enclosure(plus(self.value, o.value), slopes)

    __radd__ = __add__

    def __neg__(self) -> Enclosure:
        turned = {k: (-b, -a) for k, (a, b) in self.slopes.items()}
        return Enclosure((-self.value[1], -self.value[0]), turned)

    def __sub__(self, other: Any) -> Enclosure:
        return self + (-enclosed(other))

    def __rsub__(self, other: Any) -> Enclosure:
        return enclosed(other) + (-self)

    def __mul__(self, other: Any) -> Enclosure:
        o = enclosed(other)
        slopes: dict[int, tuple[Array, Array]] = {}
        for factor, times in ((self, o), (o, self)):
            for k, s in factor.slopes.items():
                term = product(s, times.value)
                slopes[k] = plus(slopes[k], term) if k in slopes else term
        return Enclosure(product(self.value, o.value), slopes)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Enclosure:
        o = enclosed(other)
        if np.any((o.value[0] <= 0) & (o.value[1] >= 0)):
            raise ValueError("a divisor may be zero")
        inverse = outward(1 / o.value[1], 1 / o.value[0])
        squared = product(inverse, inverse)
        return self * o._chain(inverse, (-squared[1], -squared[0]))

    def __pow__(self, power: int) -> Enclosure:
        if power != 2:
            raise ValueError("only squares are read")
        a, b = self.value
        low = np.where((a <= 0) & (b >= 0), 0.0, np.minimum(a * a, b * b))
        return self._chain(outward(low, np.maximum(a * a, b * b)), (2 * a, 2 * b))

    def __abs__(self) -> Enclosure:
        a, b = self.value
        low = np.where((a <= 0) & (b >= 0), 0.0, np.minimum(np.abs(a), np.abs(b)))
        slope = np.where(a >= 0, 1.0, -1.0), np.where(b <= 0, -1.0, 1.0)
        return self._chain((low, np.maximum(np.abs(a), np.abs(b))), slope)


def enclosed(number: Any) -> Enclosure:
    """A number as an enclosure; an enclosure as it is."""
    if isinstance(number, Enclosure):
        return number
    return Enclosure((np.asarray(number, float), np.asarray(number, float)), {})


def between(low: Array, high: Array, variable: int | None = None) -> Enclosure:
    """A variable over boxes; with slopes by itself if it is counted."""
    one = np.ones(())
    return Enclosure((low, high), {} if variable is None else {variable: (one, one)})


def sine(e: Enclosure) -> Enclosure:
    return e._chain(range_of_sine(*e.value), cosine_range(*e.value))


def cosine_range(low: Array, high: Array) -> tuple[Array, Array]:
    return range_of_sine(low + np.pi / 2, high + np.pi / 2)


def cosine(e: Enclosure) -> Enclosure:
    slope = range_of_sine(*e.value)
    return e._chain(cosine_range(*e.value), (-slope[1], -slope[0]))


def root(e: Enclosure) -> Enclosure:
    a, b = np.maximum(e.value[0], 0.0), np.maximum(e.value[1], 0.0)
    with np.errstate(divide="ignore"):
        slope = 0.5 / np.sqrt(b), 0.5 / np.sqrt(a)
    return e._chain(outward(np.sqrt(a), np.sqrt(b)), (slope[0], np.minimum(slope[1], 1e150)))


def _choice(larger: bool) -> Callable[[Any, Any], Enclosure]:
    def chosen(first: Any, second: Any) -> Enclosure:
        a, b = enclosed(first), enclosed(second)
        pick = np.maximum if larger else np.minimum
        value = pick(a.value[0], b.value[0]), pick(a.value[1], b.value[1])
        if larger:
            only_a, only_b = a.value[0] > b.value[1], b.value[0] > a.value[1]
        else:
            only_a, only_b = a.value[1] < b.value[0], b.value[1] < a.value[0]
        zero = (np.zeros(()), np.zeros(()))
        slopes = {}
        for k in {*a.slopes, *b.slopes}:
            s, t = a.slopes.get(k, zero), b.slopes.get(k, zero)
            both = hull(s, t)
            slopes[k] = tuple(
                np.where(only_a, s[i], np.where(only_b, t[i], both[i])) for i in (0, 1)
            )
        return Enclosure(value, slopes)

    return chosen


ENCLOSED: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "max": _choice(True),
    "min": _choice(False),
    "sin": sine,
    "cos": cosine,
    "sqrt": root,
}
NUMBERS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "max": np.maximum,
    "min": np.minimum,
    "sin": np.sin,
    "cos": np.cos,
    "sqrt": np.sqrt,
}
"""What a formula may call, for enclosures and for arrays of numbers."""

_COMPILED: dict[str, CodeType] = {}


def read(text: str, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """The value of a formula of this engine (never of a stranger's text)."""
    if text not in _COMPILED:
        _COMPILED[text] = compile(text, "<formula>", "eval")
    return eval(_COMPILED[text], {"__builtins__": {}}, {**functions, **names})


def enclose_all(
    texts: Sequence[str], names: Mapping[str, Any], shape: tuple[int, ...], variables: int
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Bounds of formulas (formulas, boxes) and of their slopes (formulas, variables, boxes)."""
    values = [enclosed(read(t, names, ENCLOSED)) for t in texts]
    low, high = (np.array([np.broadcast_to(v.value[i], shape) for v in values]) for i in (0, 1))
    zero = (np.zeros(()), np.zeros(()))
    slopes = [
        np.array(
            [
                [np.broadcast_to(v.slopes.get(k, zero)[i], shape) for k in range(variables)]
                for v in values
            ]
        ).reshape(len(texts), variables, *shape)
        for i in (0, 1)
    ]
    return (low, high), (slopes[0], slopes[1])
