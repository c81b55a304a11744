"""Units of expressions: a sum has one unit, a cosine is of an angle, and what is stated is met.

Only what is written is checked, so that what is refused is wrong with any reading of it:

| part | unit |
|---|---|
| a quantity | the one written of it; without one, whatever fits |
| a number | whatever fits: 0.5 x may be a speed, since the unit of 0.5 is not written |
| a value of cos, tanh, exp, sgn, ... | whatever fits where it stands alone; none in a product |
| `t` | whatever fits, as a number: of seconds |
| a sum, least, greatest, select | that of its terms, which is the same |
| a product, a power | the product, the power; an exponent has none |
| the argument of sin, exp, wrap, ... | none, or an angle in rad |
| what is compared with 0 in a condition, the argument of sgn | any, and each part of it its own |
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Annotated

import sympy as sp

from holdfast.arguments import Says
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Ball, Bounds, Box, LinearImage, Product
from holdfast.maths.definitions.quantity import (
    BASE,
    DELAY,
    SAMPLE_TIME,
    TIME,
    TIME_IN_MODE,
    Dimension,
    Quantity,
    UnitError,
    Unwritten,
    alike,
    dimension,
)
from holdfast.maths.definitions.value import short_text
from holdfast.maths.expressions import functions


class Free(Enum):
    """What has no unit of its own."""

    ANY = "any unit"
    NUMBER = "any unit where it stands alone, none in a product"


Kind = Dimension | Free

NONE: Dimension = (0.0,) * (len(BASE) + 1)
SECOND: Dimension = (*(float(name == "s") for name in BASE), 0.0)
CLOSE = 1e-9
LONGEST = 60
"""Characters of a term in a message."""

_DURATIONS = (TIME_IN_MODE, SAMPLE_TIME, DELAY)


def product(*kinds: Kind) -> Kind:
    if Free.ANY in kinds:
        return Free.ANY
    of_units = [k for k in kinds if not isinstance(k, Free)]
    return tuple(map(sum, zip(*of_units, strict=True))) if of_units else Free.NUMBER


def power(kind: Kind, exponent: float) -> Kind:
    return kind if isinstance(kind, Free) else tuple(exponent * k for k in kind)


def fits(one: Kind, other: Kind) -> bool:
    """Whether both may be the same unit."""
    return isinstance(one, Free) or isinstance(other, Free) or alike(one, other)


def unit_text(kind: Kind) -> str:
    """A dimension as the text of a unit, which is that of a number where there is none."""
    if isinstance(kind, Free):
        return "1"
    *powers, size = kind
    named = [(n, p) for n, p in zip(BASE, powers, strict=True) if abs(p) > CLOSE]
    over = [n + _exponent(p) for n, p in named if p > 0]
    under = [n + _exponent(-p) for n, p in named if p < 0]
    text = " ".join(over) or "1"
    text += "".join(f"/{part}" for part in under)
    if abs(size) > CLOSE:
        text = f"{math.exp(size):.6g} {'rad' if text == '1' else text}"
    return text


def _exponent(p: float) -> str:
    return "" if p == 1 else f"^{p:g}"


_OF_NUMBERS = (
    sp.sin, sp.cos, sp.tan, sp.sinh, sp.cosh, sp.tanh, sp.exp, sp.log, sp.asin, sp.acos, sp.atan,
    functions.wrap,
)  # fmt: skip
"""Functions of a number or an angle."""
_ANGLES = (sp.asin, sp.acos, sp.atan, functions.wrap)
_EQUAL = (functions.least, functions.greatest, sp.Min, sp.Max)
_SIGNS = (functions.sgn, sp.sign)


class Units:
    """The units of expressions of the same quantities, each part of them once.

    owner: whose the expressions are, in messages. Where nothing that is written has a unit but "1"
    or "rad" (`plain`), durations have none either.
    """

    def __init__(self, owner: str, quantities: Iterable[Quantity]) -> None:
        self.owner, self.what = owner, ""
        self.kinds: dict[sp.Basic, Kind] = {}
        self.texts: dict[sp.Basic, str] = {}
        for q in quantities:
            self.texts[q.symbol] = str(q.unit)
            self.kinds[q.symbol] = self.written(q.unit, f"'{q.name}'")
        self.plain = all(k == NONE or isinstance(k, Free) for k in self.kinds.values())
        self.kinds |= {TIME: Free.ANY}
        self.kinds |= dict.fromkeys(_DURATIONS, Free.ANY if self.plain else SECOND)

    def written(self, unit: str, whose: str) -> Kind:
        """What is written of the unit of `whose`; `DefinitionError` for text that is none."""
        try:
            return Free.ANY if not unit or isinstance(unit, Unwritten) else dimension(unit)
        except UnitError as error:
            raise DefinitionError(
                f"{whose} of {self.owner} has the unit '{unit}', which is none",
                expected=error.expected,
            ) from None

    def shown(self, e: sp.Basic, kind: Kind) -> str:
        """The unit of an expression; that of a quantity as it is written."""
        return self.texts.get(e) or unit_text(kind)

    def per_second(self, kind: Kind) -> Kind:
        """That of a rate of what has this; what has none may count time in anything."""
        return Free.ANY if kind == NONE and self.plain else product(kind, power(SECOND, -1.0))

    def of(self, e: sp.Expr, what: str) -> Kind:
        """The unit of an expression, which messages name `what`; `DefinitionError` without one."""
        self.what = what
        kinds, waiting = self.kinds, [e]
        while waiting:
            part = waiting[-1]
            if part in kinds:
                waiting.pop()
            elif missing := [a for a in _arguments(part) if a not in kinds]:
                waiting += missing
            else:
                kinds[waiting.pop()] = self._kind(part)
        return kinds[e]

    def check_level(self, e: sp.Expr, what: str) -> None:
        """Refuse a condition e >= 0 with a part that has no unit; parts may have several."""
        for part in _levels(e):
            self.of(part, what)

    def check(self, e: sp.Expr, what: str, wanted: Kind, of: str) -> Kind:
        """Refuse an expression of another unit than `wanted`, which is that of `of`."""
        kind = self.of(e, what)
        if not fits(kind, wanted):
            raise self.refused(
                f"{_shown(e)} is in {self.shown(e, kind)}",
                expected=f"{unit_text(wanted)}, {of}",
                lacking=product(wanted, power(kind, -1.0)),
            )
        return kind

    def refused(self, cause: str, expected: str, lacking: Kind = NONE) -> DefinitionError:
        """The error, whose remedy is the factor that is lacking, if one is known."""
        return DefinitionError(
            f"{self.what} of {self.owner}: {cause}", expected=expected, remedy=remedy_of(lacking)
        )

    def of_set(self, bounds: Bounds, what: str) -> list[Kind]:
        """The units of the members of a set."""
        match bounds:
            case Box(lower=lower, upper=upper):
                sides = list(zip(lower, upper, strict=True))
                kinds = [[self.of(end, what) for end in side] for side in sides]
                return [
                    self._same(side, of, "has a side from", None)
                    for side, of in zip(sides, kinds, strict=True)
                ]
            case Ball(radius=radius, dimension=n):
                return [self.of(radius, what)] * n
            case Product(parts=parts):
                return [k for part in parts for k in self.of_set(part, what)]
            case LinearImage(matrix=matrix, of=inner):
                made_by = self.of_set(inner, what)
                return [self._row(list(matrix.row(i)), made_by, what) for i in range(matrix.rows)]
        return [Free.ANY] * bounds.dimension

    def check_set(self, bounds: Bounds | None, of: Sequence[Quantity], what: str) -> None:
        """Refuse a set of these quantities in other units than theirs."""
        for q, kind in zip(of, self.of_set(bounds, what) if bounds else (), strict=False):
            if not fits(kind, wanted := self.kinds[q.symbol]):
                raise self.refused(
                    f"'{q.name}' is bounded in {unit_text(kind)}",
                    expected=f"{unit_text(wanted)}, its unit",
                )

    def _row(self, entries: Sequence[sp.Expr], kinds: Sequence[Kind], what: str) -> Kind:
        """The unit of sum_i entries_i q_i, of quantities of these kinds."""
        terms = [
            (e, product(self.of(e, what), k)) for e, k in zip(entries, kinds, strict=True) if e != 0
        ]
        return self._same([e for e, _ in terms], [k for _, k in terms], "combines", None)

    def check_row(self, entries: Mapping[sp.Symbol, sp.Expr], rhs: sp.Expr, what: str) -> None:
        """Refuse sum_i entries_i d q_i/dt = rhs where units differ."""
        rates = [self.per_second(self.kinds[s]) for s in entries]
        kind = self._row(list(entries.values()), rates, what)
        self.check(rhs, what, kind, "that of its left side")

    def _kind(self, part: sp.Basic) -> Kind:
        if part.is_NumberSymbol:
            return Free.NUMBER
        args = part.args
        if not args:
            return Free.ANY
        kinds = self.kinds
        if isinstance(part, functions.select):
            return self._same(args[1:], [kinds[a] for a in args[1:]], "chooses between", part)
        if isinstance(part, _SIGNS):
            return Free.NUMBER
        of = [kinds[a] for a in args]
        if part.is_Mul:
            start = 1 if args[0] is sp.S.NegativeOne else 0
            return product(*of[start:])
        if part.is_Add:
            return self._same(args, of, "adds", part)
        if part.is_Pow:
            return self._power(part, *of)
        if isinstance(part, functions.length):
            return self._same(args[:2], of[:2], "is the length of", part)
        if isinstance(part, (functions.angle, sp.atan2)):
            self._same(args[:2], of[:2], "is the angle of", part)
            return NONE
        if isinstance(part, (functions.magnitude, sp.Abs)):
            return of[0]
        if isinstance(part, _EQUAL):
            return self._same(args, of, "compares", part)
        if isinstance(part, _OF_NUMBERS):
            self._plain(part, of[0], args[0])
            return NONE if isinstance(part, _ANGLES) else Free.NUMBER
        return Free.ANY  # of the library itself, such as the nearest place of walls

    def _power(self, part: sp.Basic, base: Kind, exponent: Kind) -> Kind:
        whole, by = part.args
        if by.is_number:
            return power(base, float(by))
        self._plain(part, exponent, by)
        self._plain(part, base, whole)
        return Free.NUMBER

    def _plain(self, part: sp.Basic, kind: Kind, argument: sp.Basic) -> None:
        """Refuse the argument of a function that has a unit."""
        if not fits(kind, NONE):
            raise self.refused(
                f"the term {_shown(part)}, whose {_shown(argument)} is in "
                f"{self.shown(argument, kind)}",
                expected="an angle in rad or a number without a unit",
                lacking=power(kind, -1.0),
            )

    def _same(
        self, parts: Sequence[sp.Basic], kinds: Sequence[Kind], does: str, whole: sp.Basic | None
    ) -> Kind:
        """The unit of all the parts, which is one; that of a number fits it."""
        first = -1
        for i, kind in enumerate(kinds):
            if isinstance(kind, Free):
                continue
            if first < 0:
                first = i
            elif kind != kinds[first] and not fits(kinds[first], kind):
                terms = [
                    f"{_shown(parts[k])} in {self.shown(parts[k], kinds[k])}" for k in (first, i)
                ]
                subject = f"{_shown(whole)} {does}" if whole is not None else f"it {does}"
                raise self.refused(f"{subject} {' and '.join(terms)}", expected="one unit")
        if first >= 0:
            return kinds[first]
        return Free.NUMBER if Free.NUMBER in kinds else Free.ANY


REASON = 'empirical = "drag fitted to a tank test"'
"""How a definition says why its units do not count."""

Empirical = Annotated[str, Says(f"the reason as text, such as {REASON}")]


def are_not_checked(empirical: object, owner: str) -> bool:
    """Whether a definition says why its units do not count; `DefinitionError` for no text."""
    if not isinstance(empirical, str):
        raise DefinitionError(
            f"empirical of {owner} is {empirical!r}",
            expected=f"the reason as text, such as {REASON}",
        )
    return bool(empirical)


def _arguments(part: sp.Basic) -> Sequence[sp.Basic]:
    """The arguments whose units count; of a condition and of a sign, those of their parts."""
    if isinstance(part, functions.select):
        return *_levels(part.args[0]), *part.args[1:]
    return [*_levels(part.args[0])] if isinstance(part, _SIGNS) else part.args


def _levels(e: sp.Basic) -> Iterator[sp.Basic]:
    """What is compared with 0 in a condition, whose "and" is the least, "or" the greatest."""
    if isinstance(e, (*_EQUAL, functions.select)):
        for part in e.args:
            yield from _levels(part)
    elif e.is_Mul and len(e.args) == 2 and e.args[0] is sp.S.NegativeOne:
        yield from _levels(e.args[1])
    else:
        yield e


def of_another_unit(does: str, unit: Dimension, q: Quantity, owner: str) -> DefinitionError:
    """The error of what does something with a quantity of `owner` in another unit."""
    return DefinitionError(
        f"{does} in {unit_text(unit)}",
        expected=f"{q.unit}, as in {owner}",
        remedy=remedy_of(product(dimension(q.unit), power(unit, -1.0))),
    )


def remedy_of(lacking: Kind) -> str:
    """What to do about a term that lacks a factor of this unit, if it is known."""
    if isinstance(lacking, Free) or fits(lacking, NONE):
        remedy = "correct the term or a unit"
    elif fits((*lacking[:-1], 0.0), NONE):
        remedy = "write units of the SI, such as m and rad"
    else:
        remedy = f"correct it, or multiply it by a parameter in {unit_text(lacking)}"
    return f"{remedy}; where units do not count say why: {REASON}"


def _shown(e: sp.Basic) -> str:
    text = short_text(e)
    return f"'{text if len(text) <= LONGEST else text[: LONGEST - 3] + '...'}'"
