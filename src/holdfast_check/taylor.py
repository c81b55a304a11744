"""Taylor models: polynomials of numbers in [-1, 1] and of time, with intervals of what is left out.

A model (p, I) stands for all functions that differ from p by numbers in I. Its variables are those
of a box, each in [-1, 1], and s, from 0 to 1, the part of a step that has passed (Makino, Berz).
"""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from flint import arb

from holdfast_check.intervals import (
    FUNCTIONS,
    SMOOTH,
    UNKNOWN,
    ZERO,
    Interval,
    Row,
    Tape,
    add,
    constant,
    hull,
    interval,
    inverse,
    mul,
    neg,
    point,
    power,
    root,
    sub,
)

Polynomial = dict[int, Any]
Model = tuple[Polynomial, Interval]

NONE: Interval = (ZERO, ZERO)


class NoModelError(Exception):
    """What a function is not smooth at."""


class Models:
    """Models of so many variables, up to a degree in these, and up to one in time."""

    def __init__(self, variables: int, degree: int, times: int) -> None:
        some = itertools.combinations_with_replacement(range(variables + 1), degree)
        powers = [tuple(map(chosen.count, range(variables))) for chosen in some]
        most = (degree + 1) * (times + 1)
        every = [(*e, t) for e in powers for t in range(times + 1)
                 if sum(e) * (times + 1) + t * (degree + 1) < most]  # fmt: skip
        every.sort(key=lambda e: (sum(e), e))
        self.exponents, self.most = every, max(degree, times)
        index = {e: k for k, e in enumerate(every)}
        self.variable = [
            index[tuple(int(k == j) for k in range(variables + 1))] for j in range(variables)
        ]
        self.even = [all(n % 2 == 0 for n in e[:-1]) for e in every]
        self.times = [e[-1] for e in every]
        self.start = [index[*e[:-1], 0] for e in every]
        self.longer = [index.get((*e[:-1], e[-1] + 1)) for e in every]
        self.shorter = [index[*e[:-1], e[-1] - 1] if e[-1] else 0 for e in every]
        self.product = [
            [index.get(tuple(map(sum, zip(e, f, strict=True))), -1) for f in every] for e in every
        ]
        self.rough = False
        self._until: dict[int, Models] = {}

    def until(self, times: int) -> Models:
        """Models up to a degree in time, without what they leave out."""
        if times not in self._until:
            short_models = copy.copy(self)
            short = [t <= times for t in self.times]
            short_models.product = [
                [k if k < 0 or short[k] else -1 for k in row] for row in self.product
            ]
            short_models.rough = True
            self._until[times] = short_models
        return self._until[times]

    def constant(self, q: Interval) -> Model:
        """A number that is anything in an interval, another at every place."""
        middle = ((q[0] + q[1]) / 2).mid()
        return {0: middle}, sub(q, point(middle))

    def range(self, a: Model) -> Interval:
        p, low = a[0], ZERO
        high, first = low, p.get(0, ZERO)
        for k, c in p.items():
            if k == 0:
                continue
            if self.even[k]:
                low, high = low + min(c, ZERO), high + max(c, ZERO)
            else:
                size = abs(c)
                low, high = low - size, high + size
        return add(interval(first + low, first + high), a[1])

    def add(self, a: Model, b: Model) -> Model:
        p = dict(a[0])
        for k, c in b[0].items():
            p[k] = p[k] + c if k in p else c
        return p, add(a[1], b[1])

    def negative(self, a: Model) -> Model:
        return {k: -c for k, c in a[0].items()}, neg(a[1])

    def sub(self, a: Model, b: Model) -> Model:
        return self.add(a, self.negative(b))

    def scaled(self, a: Model, by: Interval) -> Model:
        """By a number of an interval."""
        middle = ((by[0] + by[1]) / 2).mid()
        rest = mul(a[1], by)
        if by[0] < by[1]:
            rest = add(rest, mul(self.range((a[0], NONE)), sub(by, point(middle))))
        return {k: c * middle for k, c in a[0].items()}, rest

    def mul(self, a: Model, b: Model) -> Model:
        (p, i), (q, j) = a, b
        for one, other in ((a, b), (b, a)):
            if one[0].keys() <= {0}:  # a number, another one at every place
                return self.scaled(other, add(point(one[0].get(0, ZERO)), one[1]))
        product: Polynomial = {}
        lost = ZERO
        others = list(q.items())
        for m, x in p.items():
            row, beyond = self.product[m], []
            for n, y in others:
                k = row[n]
                if k < 0:
                    beyond.append(y)
                elif k in product:
                    product[k] += x * y
                else:
                    product[k] = x * y
            if beyond and not self.rough:
                lost += abs(x) * sum(map(abs, beyond), ZERO)
        if self.rough:
            return product, NONE
        rest = interval(-lost, lost)
        if not i[0] == ZERO == i[1]:
            rest = add(rest, mul(self.range(b), i))
        if not j[0] == ZERO == j[1]:
            rest = add(rest, mul(self.range((p, NONE)), j))
        return product, rest

    def power(self, a: Model, n: int) -> Model:
        half = self.power(a, n // 2) if n > 1 else None
        if half is None:
            return a
        square = self.mul(half, half)
        return self.mul(square, a) if n % 2 else square

    def smooth(self, name: str, a: Model) -> Model:
        """Of a function with a series: that at the middle, and the next term over the range."""
        middle = point(arb(a[0].get(0, ZERO)).mid())
        off = self.add(a, self.constant(neg(middle)))
        at = list(itertools.islice(series(name, middle), self.most + 1))
        total = self.constant(at[-1])
        for c in reversed(at[:-1]):
            total = self.add(self.mul(total, off), self.constant(c))
        if self.rough:
            return total
        away = hull(NONE, self.range(off))
        last = next(itertools.islice(series(name, add(middle, away)), self.most + 1, None))
        return total[0], add(total[1], mul(last, power(away, self.most + 1)))

    def positive(self, a: Model) -> Model:
        """The greatest of a model and 0: between its range's ends a chord and what it is off."""
        low, high = self.range(a)
        if not low <= high:
            raise NoModelError("what is not known")
        if high <= ZERO or low >= ZERO:
            return a if low >= ZERO else self.constant(NONE)
        slope = (high / (high - low)).mid()
        line = self.scaled(a, point(slope))
        # max(w, 0) - slope w has its ends at w = low, 0 and high
        off = hull(NONE, *(mul(point(w), point(k)) for w, k in ((low, -slope), (high, 1 - slope))))
        return line[0], add(line[1], off)

    def of(self, name: str, x: Sequence[Model]) -> Model:
        """What a function that may have kinks is."""
        match name:
            case "least":
                return self.sub(x[0], self.positive(self.sub(x[0], x[1])))
            case "greatest":
                return self.add(x[1], self.positive(self.sub(x[0], x[1])))
            case "Abs" | "magnitude":
                w = self.positive(x[0])
                return self.sub(self.add(w, w), x[0])
            case "length":
                return self.smooth("sqrt", self.add(self.power(x[0], 2), self.power(x[1], 2)))
            case "angle" | "atan2":
                return self._angle(*x[:2])
            case "wrap":
                value = FUNCTIONS["wrap"][1](q := self.range(x[0]))
                k = (((q[0] - value[0]) / (2 * arb.pi())).mid() + arb(0.5)).floor()
                whole = mul(point(2 * k), interval(arb.pi(), arb.pi()))
                if value[1] - value[0] < 6 and k.is_exact():
                    return self.sub(x[0], self.constant(whole))
        raise NoModelError(f"{name} where it jumps")

    def _angle(self, y: Model, x: Model) -> Model:
        # atan(y/x), pi/2 - atan(x/y), -pi/2 + atan(x/-y), of what is above 0
        for low, over, quarter in ((x, y, 0), (y, x, 1), (self.negative(y), x, -1)):
            if self.range(low)[0] > ZERO:
                turned = self.smooth("atan", self.mul(over, self.smooth("inverse", low)))
                turned = self.negative(turned) if quarter > 0 else turned
                return self.add(turned, self.constant(interval(*2 * [quarter * arb.pi() / 2])))
        raise NoModelError("an angle where it jumps")

    def values(self, tape: Tape, at: Mapping[str, Model]) -> list[Model]:
        """Of the expressions of a tape."""
        every: list[Model] = []
        for name, arguments, of in tape.operations:
            x = [every[k] for k in arguments]
            if name in _PLAIN:
                every.append(_PLAIN[name](self, *x))
            elif name == "power":
                every.append(self.power(x[0], of))
            elif name in SMOOTH:
                every.append(self.smooth(name, x[0]))
            elif x:
                every.append(self.of(name, x))
            else:
                every.append(at[of] if name == "symbol" else self.constant(constant(of)))
        return tape.of(every)

    def ended(self, a: Model) -> Model:
        """A model at the end of a step, where s is 1."""
        last: Polynomial = {}
        for k, c in a[0].items():
            first = self.start[k]
            last[first] = last[first] + c if first in last else c
        return last, a[1]

    def integral(self, p: Polynomial) -> Polynomial:
        """Over s; what goes beyond the degree in time is left out."""
        return {
            longer: c / (self.times[k] + 1)
            for k, c in p.items() if (longer := self.longer[k]) is not None
        }  # fmt: skip

    def derivative(self, p: Polynomial) -> Polynomial:
        """By s."""
        return {self.shorter[k]: c * self.times[k] for k, c in p.items() if self.times[k]}


_PLAIN: Mapping[str, Callable[..., Model]] = {
    "+": Models.add, "-": Models.sub, "*": Models.mul, "negative": Models.negative,
}  # fmt: skip


def rounded(p: Polynomial) -> Model:
    """A polynomial whose numbers are exact, and what that changes."""
    away = functools.reduce(arb.__add__, (arb(c).rad() for c in p.values()), ZERO)
    return {k: arb(c).mid() for k, c in p.items()}, interval(-away, away)


def series(name: str, x: Interval) -> Iterator[Interval]:
    """g^(j)(x) / j! of a smooth function, for j = 0, 1, 2, ..."""
    match name:
        case "inverse":
            for j in itertools.count(1):
                v = power(inverse(x), j)
                yield v if j % 2 else neg(v)
        case "exp":
            v = FUNCTIONS["exp"][1](x)
            for j in itertools.count(1):
                yield v
                v = mul(v, inverse(point(j)))
        case "log":
            yield FUNCTIONS["log"][1](x)
            for j in itertools.count(1):
                v = mul(power(inverse(x), j), inverse(point(j)))
                yield v if j % 2 else neg(v)
        case "sqrt":
            by = point(1)
            yield root(x)
            for j in itertools.count(1):
                by = mul(by, mul(point(arb(3) / 2 - j), inverse(point(j))))
                yield mul(by, mul(root(x), power(inverse(x), j)))
        case "sin" | "cos":
            a, b = (FUNCTIONS[n][1](x) for n in ("sin", "cos"))
            turn = (a, b, neg(a), neg(b)) if name == "sin" else (b, neg(a), neg(b), a)
            over = point(1)
            for j in itertools.count():
                yield mul(turn[j % 4], over)
                over = mul(over, inverse(point(j + 1)))
        case "tan" | "tanh":  # g' = 1 + g^2, or 1 - g^2
            terms = [FUNCTIONS[name][1](x)]
            for j in itertools.count():
                yield terms[j]
                square = _squared(terms, j)
                square = square if name == "tan" else neg(square)
                square = add(point(1), square) if j == 0 else square
                terms.append(mul(square, inverse(point(j + 1))))
        case "atan":  # g' = 1 / (1 + x^2)
            yield FUNCTIONS["atan"][1](x)
            first = inverse(add(point(1), power(x, 2)))
            slope: Row = [first]
            for j in itertools.count(1):
                yield mul(slope[j - 1], inverse(point(j)))
                more = mul(mul(point(2), x), slope[j - 1])
                more = add(more, slope[j - 2]) if j > 1 else more
                slope.append(neg(mul(first, more)))
    while True:
        yield UNKNOWN


def _squared(a: Row, j: int) -> Interval:
    """The coefficient j of the square of a series."""
    return functools.reduce(add, (mul(a[k], a[j - k]) for k in range(j + 1)))
