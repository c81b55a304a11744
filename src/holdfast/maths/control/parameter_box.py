"""Conditions on inputs that hold for every model of a box of parameters.

    n(p) . u + w(p) . d + g(p) <= 0   for every p with least_i <= p_i <= most_i

An uncertain parameter p is one number of the model, anywhere in its range; u is to be chosen, d is
an unknown disturbance. n, w and g are rational in p, so that multiplied by their denominators,
which are positive in the box, they are polynomials, and these lie below the largest of their
coefficients in the basis of Bernstein,

    b(p) = sum_i b_i B_i(p),   B_i >= 0,   sum_i B_i = 1     =>     b(p) <= max_i b_i,

where b_i at a vertex is the value there (S. Bernstein 1912; J. Garloff, Interval Computations 2,
1993). The b_i of n . u + w . d + g are affine in u and d, and b_i <= 0 are the new conditions:

- A parameter that multiplies inputs or worst disturbances to the degree 1, after the denominators
  that these have in common are multiplied out, gives a condition at each of its two ends; one to
  the degree k gives k + 1.
- A polynomial g of a degree above that of the inputs is replaced by one that is not, with the same
  values at the vertices, plus the most by which it is below g.
- A parameter in g alone gives no condition more: the largest of its b_i is taken. Where g is affine
  in it, that is its value at the middle plus the half width times |dg/dp|.

Where the condition is affine, or convex, in every parameter separately this is the worst case,
attained at a vertex. Else it is an upper bound of it, whose excess falls with the square of the
width of the ranges.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from numbers import Real

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import greatest
from holdfast.maths.expressions.traversal import derivatives, exchanged, symbols_of

Form = tuple[tuple[sp.Expr, ...], tuple[sp.Expr, ...], sp.Expr]
"""n, w and g of a condition n . u + w . d + g <= 0."""

LEAST, MOST = "_least", "_most"
MOST_CONDITIONS = 64


@dataclass(frozen=True)
class ParameterBox:
    """Uncertain parameters, at their nominal values, and the ends of their ranges.

    constants: the values of all parameters of the model, by symbol.
    """

    uncertain: tuple[Parameter, ...] = ()
    ends: tuple[tuple[Parameter, Parameter], ...] = ()
    constants: Mapping[sp.Symbol, float] | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The ends of the ranges, as parameters of a law."""
        return tuple(itertools.chain.from_iterable(self.ends))

    def worst(self, name: str, form: Form) -> list[Form]:
        """Conditions that hold only where `form` does for every model of the box.

        name: of the inequality that it comes from. Raises `DefinitionError` for a condition that is
        not rational in a parameter, or whose denominator may vanish.
        """
        inside = symbols_of([*form[0], *form[1], form[2]])
        if not any(q.symbol in inside for q in self.uncertain):
            return [form]
        return _Worst(self, name, form).conditions()


def parameter_box(
    uncertain: Mapping[str, tuple[float, float]] | None, system: System, region: Region | None
) -> ParameterBox:
    """The box of the named ranges (least, most), in the unit of each parameter.

    Raises `DefinitionError` for a name that is not a parameter of the system or the region, a range
    that is not two finite numbers in order with the nominal value between them, and a parameter of
    the bounds of inputs or disturbances.
    """
    if uncertain is not None and not isinstance(uncertain, Mapping):
        raise DefinitionError(
            f"uncertain of the safeguard is {uncertain!r}", expected="names to ranges [least, most]"
        )
    of_region = region.parameters if region else ()
    parameters = {p.name: p for p in (*system.parameters, *of_region)}
    chosen, ends = [], []
    for name, limits in (uncertain or {}).items():
        if name not in parameters:
            raise DefinitionError(
                f"uncertain '{name}' is not a parameter of system '{system.name}'",
                remedy=suggestion(str(name), parameters),
            )
        p = parameters[name]
        low, high = _range(p, limits)
        for what, bounds in (
            ("inputs", system.input_bounds),
            ("disturbances", system.disturbance_bounds),
        ):
            if bounds is not None and p.symbol in bounds.free_symbols:
                raise DefinitionError(
                    f"uncertain '{name}' is in the bounds of the {what}",
                    expected="parameters of the rates",
                    remedy="leave it out, and give the parameter its worst value",
                )
        chosen.append(p)
        ends.append(
            (
                Parameter(name + LEAST, p.unit, f"least {name}", value=low),
                Parameter(name + MOST, p.unit, f"largest {name}", value=high),
            )
        )
    values = {p.symbol: float(p.value) for p in parameters.values()}
    return ParameterBox(tuple(chosen), tuple(ends), values)


def _range(p: Parameter, limits: object) -> tuple[float, float]:
    pair = isinstance(limits, Sequence) and not isinstance(limits, str) and len(limits) == 2
    if not (pair and all(isinstance(e, Real) and not isinstance(e, bool) for e in limits)):  # type: ignore[attr-defined]
        raise DefinitionError(
            f"the range of uncertain '{p.name}' is {limits!r}",
            expected="two numbers, [least, most]",
        )
    low, high = (float(e) for e in limits)  # type: ignore[attr-defined]
    shown = f"the range of uncertain '{p.name}' is [{low:g}, {high:g}]"
    if not (math.isfinite(low) and math.isfinite(high)):
        raise DefinitionError(shown, expected="finite numbers")
    if low > high:
        raise DefinitionError(shown, expected="the least number first")
    if not low > p.above:
        raise DefinitionError(shown, expected=f"numbers above {p.above:g}")
    if not low <= p.value <= high:
        raise DefinitionError(
            f"{shown}, and its value {p.value:g} is not in it",
            expected="a range about the value of the model",
        )
    return low, high


# -- the worst case of one condition -----------------------------------------------------------


class _Worst:
    """One condition over the box: its degrees, its coefficients and what is left of them."""

    def __init__(self, box: ParameterBox, name: str, form: Form) -> None:
        self.name, self.form = name, form
        self.constants = dict(box.constants or {})
        self.ends = {
            q.symbol: (a.symbol, b.symbol)
            for q, (a, b) in zip(box.uncertain, box.ends, strict=True)
        }
        self.numbers = {
            q.symbol: (float(a.value), float(b.value))
            for q, (a, b) in zip(box.uncertain, box.ends, strict=True)
        }
        self.skeletons = _Skeletons(list(self.ends), name, set(self.constants))

    def conditions(self) -> list[Form]:
        acting = [*self.form[0], *self.form[1]]
        rest = self.form[2]
        shapes = [self.skeletons.terms(e) for e in acting]
        shape = self.skeletons.terms(rest)
        bases = self.skeletons.bases
        common, degrees = self._common(shapes, shape)
        turning = [p for p in self.ends if degrees[p] > 0]  # those that multiply inputs
        extra = {
            k: power - common.get(k, 0)
            for k, power in _powers([shape]).items()
            if power > common.get(k, 0)
        }
        multiplied = {k: common.get(k, 0) + extra.get(k, 0) for k in (*common, *extra)}
        of_rest = self._degrees([shape], multiplied)
        affine = self._affine(shape, turning, of_rest)
        counted = [p for p in self.ends if p not in affine and max(degrees[p], of_rest[p]) > 0]
        factor = sp.Mul(*(self._positive(bases[k]) ** n for k, n in common.items()))
        alone = sp.Mul(*(self._positive(bases[k]) ** n for k, n in extra.items()))
        middle = {p: sum(self.ends[p]) / 2 for p in affine}
        centre = exchanged([rest], middle)[0]
        slopes = list(derivatives(rest, affine).values())
        slopes = [
            s * (self.ends[p][1] - self.ends[p][0]) / 2 for p, s in zip(affine, slopes, strict=True)
        ]
        most = {p: max(degrees[p], of_rest[p]) for p in counted}
        net = [centre, *exchanged(slopes, middle)]
        coefficients = self._coefficients([e * factor * alone for e in net], most)
        sizes = self._coefficients([alone], most)
        levels = {
            place: (
                values[0] + sp.Add(*(greatest(s, -s) for s in values[1:] if s != 0))
            ) / sizes[place][0]
            for place, values in coefficients.items()
        }  # fmt: skip
        turned = {p: degrees[p] for p in turning}
        levels = _lowered(_merged(levels, counted, turning), most, turned)
        effects = self._coefficients([e * factor for e in acting], turned)
        scales = self._values([factor], turned)
        split = len(self.form[0])
        forms = []
        for place, values in effects.items():
            scale = scales[place][0]
            row = [e / scale for e in values]
            forms.append((tuple(row[:split]), tuple(row[split:]), levels[place] / scale))
        if len(forms) > MOST_CONDITIONS:
            raise DefinitionError(
                f"uncertain: '{self.name}' has {len(forms)} conditions over the box",
                expected=f"at most {MOST_CONDITIONS}",
                remedy="leave out " + " or ".join(p.name for p in turning),
            )
        return forms

    def _common(
        self, shapes: Sequence[_Terms], shape: _Terms
    ) -> tuple[dict[int, int], dict[sp.Symbol, int]]:
        """The denominators that multiply all, and the degrees of what acts on the inputs then.

        The rest is multiplied by its denominators with parameters of the inputs, as the inputs are.
        """
        common = _powers(shapes)
        while True:
            degrees = self._degrees(shapes, common)
            turning = {p for p, degree in degrees.items() if degree > 0}
            more = {
                k: power
                for k, power in _powers([shape]).items()
                if power > common.get(k, 0) and symbols_of([self.skeletons.bases[k]]) & turning
            }
            if not more:
                return common, degrees
            common |= more

    def _degrees(
        self, shapes: Sequence[_Terms], multiplied: Mapping[int, int]
    ) -> dict[sp.Symbol, int]:
        """The degree in each parameter, once multiplied by the bases to these powers."""
        largest = dict.fromkeys(self.ends, 0)
        inside = self.skeletons.degrees
        for powers, under in itertools.chain.from_iterable(shapes):
            for i, p in enumerate(self.ends):
                degree = powers[i] + sum(
                    (n - under.get(k, 0)) * inside(k)[i] for k, n in multiplied.items()
                )
                largest[p] = max(largest[p], degree)
        return largest

    def _affine(
        self, shape: _Terms, turning: Sequence[sp.Symbol], degrees: Mapping[sp.Symbol, int]
    ) -> list[sp.Symbol]:
        """Parameters that the rest alone has, affinely, and no two of them in one product."""
        divided = symbols_of(self.skeletons.bases)
        places = {p: i for i, p in enumerate(self.ends)}
        chosen: list[sp.Symbol] = []
        for p in self.ends:
            if p in turning or p in divided or degrees[p] != 1:
                continue
            beside = any(
                powers[places[p]] and powers[places[q]] for powers, _ in shape for q in chosen
            )
            if not beside:
                chosen.append(p)
        return chosen

    # -- values and coefficients at the points of the box

    def _at(self, p: sp.Symbol, share: sp.Rational) -> sp.Expr:
        """The parameter at a share of its range."""
        low, high = self.ends[p]
        return low if share == 0 else high if share == 1 else low + share * (high - low)

    def _values(
        self, expressions: Sequence[sp.Expr], degrees: Mapping[sp.Symbol, int]
    ) -> dict[tuple[int, ...], list[sp.Expr]]:
        """The expressions at the nodes of a grid of the box; others of it at their values."""
        by_place = {}
        for place in itertools.product(*(range(n + 1) for n in degrees.values())):
            here = {
                p: self._at(p, sp.Rational(k, n))
                for (p, n), k in zip(degrees.items(), place, strict=True)
            }
            by_place[place] = exchanged(expressions, here)
        return by_place

    def _coefficients(
        self, expressions: Sequence[sp.Expr], degrees: Mapping[sp.Symbol, int]
    ) -> dict[tuple[int, ...], list[sp.Expr]]:
        """The coefficients of Bernstein of polynomials of these degrees."""
        by_place = self._values(expressions, degrees)
        for axis, n in enumerate(degrees.values()):
            if n > 1:
                by_place = {
                    place: [
                        sp.Add(*(w * e for w, e in zip(weights, along, strict=True)))
                        for along in zip(*_line(by_place, place, axis, n), strict=True)
                    ]
                    for place in by_place
                    for weights in [list(_from_values(n).row(place[axis]))]
                }
        return by_place

    def _positive(self, base: sp.Expr) -> sp.Expr:
        """The denominator, or its opposite: which of them is positive in the box, proved."""
        inside = [p for p in self.ends if p in symbols_of([base])]
        degrees = {p: int(sp.Poly(base, p).degree()) for p in inside}
        values: dict[sp.Symbol, sp.Expr] = {s: sp.Float(v) for s, v in self.constants.items()}
        for p in inside:
            for end, number in zip(self.ends[p], self.numbers[p], strict=True):
                values[end] = sp.Float(number)
        coefficients = self._coefficients([base], degrees)
        signs = {sp.sign(e.xreplace(values)) for (e,) in coefficients.values()}
        if signs == {sp.S.One}:
            return base
        if signs == {sp.S.NegativeOne}:
            return -base
        shown = " and ".join(f"'{p.name}'" for p in inside)
        raise DefinitionError(
            f"the range of uncertain {shown} may make {base} zero, by which the condition of "
            f"'{self.name}' is divided",
            remedy="give a range in which it keeps its sign",
        )


def _line(
    by_place: Mapping[tuple[int, ...], list[sp.Expr]], place: tuple[int, ...], axis: int, n: int
) -> list[list[sp.Expr]]:
    """The entries along an axis through a place."""
    return [by_place[(*place[:axis], k, *place[axis + 1 :])] for k in range(n + 1)]


@cache
def _from_values(n: int) -> sp.Matrix:
    """From the values at n + 1 equal steps to the coefficients of Bernstein of degree n."""
    return sp.Matrix(
        n + 1,
        n + 1,
        lambda k, i: (
            sp.binomial(n, i) * sp.Rational(k, n) ** i * (1 - sp.Rational(k, n)) ** (n - i)
        ),
    ).inv()


@cache
def _elevated(n: int, to: int) -> sp.Matrix:
    """From the coefficients of degree n to those of the same polynomial of a higher degree."""
    return sp.Matrix(
        to + 1,
        n + 1,
        lambda j, i: (
            sp.binomial(n, i) * sp.binomial(to - n, j - i) / sp.binomial(to, j)
            if 0 <= j - i <= to - n
            else 0
        ),
    )


def _merged(
    levels: Mapping[tuple[int, ...], sp.Expr],
    counted: Sequence[sp.Symbol],
    turning: Sequence[sp.Symbol],
) -> dict[tuple[int, ...], sp.Expr]:
    """The largest of the levels over the parameters that multiply no input."""
    axes = [i for i, p in enumerate(counted) if p in turning]
    merged: dict[tuple[int, ...], sp.Expr] = {}
    for place, level in levels.items():
        short = tuple(place[i] for i in axes)
        merged[short] = greatest(merged[short], level) if short in merged else level
    return merged


def _lowered(
    levels: Mapping[tuple[int, ...], sp.Expr],
    present: Mapping[sp.Symbol, int],
    wanted: Mapping[sp.Symbol, int],
) -> dict[tuple[int, ...], sp.Expr]:
    """Coefficients of the degrees of the inputs, of a polynomial that is nowhere below this one.

    The one of degree n through the values at n + 1 equal steps is below by at most the largest
    coefficient of the difference times max (1 - B_0 - B_d) = 1 - 2^(1 - d): it is 0 at both ends.
    """
    coefficients = dict(levels)
    for axis, (p, n) in enumerate(wanted.items()):
        d = present[p]
        if d <= n:
            continue
        lower = {}
        for place in {(*q[:axis], 0, *q[axis + 1 :]) for q in coefficients}:
            line = sp.Matrix(
                [coefficients[(*place[:axis], k, *place[axis + 1 :])] for k in range(d + 1)]
            )
            nodes = sp.Matrix(n + 1, d + 1, lambda k, j: _bernstein(d, j, sp.Rational(k, n)))  # noqa: B023
            through = _from_values(n) * nodes * line
            over = line - _elevated(n, d) * through
            gap = reduce(greatest, list(over[1:-1]), sp.S.Zero)
            gap *= 1 - sp.Rational(1, 2 ** (d - 1))
            for k in range(n + 1):
                lower[(*place[:axis], k, *place[axis + 1 :])] = through[k] + gap
        coefficients = lower
    return coefficients


def _bernstein(n: int, i: int, t: sp.Rational) -> sp.Expr:
    return sp.binomial(n, i) * t**i * (1 - t) ** (n - i)


# -- how the parameters enter ------------------------------------------------------------------

_Term = tuple[tuple[int, ...], dict[int, int]]
_Terms = list[_Term]
"""Powers of the parameters, and of the denominators by number, in every product of a sum."""


def _powers(shapes: Iterable[_Terms]) -> dict[int, int]:
    """The largest power of each denominator."""
    powers: dict[int, int] = {}
    for _, under in itertools.chain.from_iterable(shapes):
        for k, power in under.items():
            powers[k] = max(powers.get(k, 0), power)
    return powers


class _Skeletons:
    """Expressions as sums of products of parameters, denominators, and what has none of them."""

    def __init__(
        self, parameters: Sequence[sp.Symbol], name: str, constants: set[sp.Symbol]
    ) -> None:
        self.parameters, self.name = parameters, name
        self.constants = constants | set(parameters)
        self.bases: list[sp.Expr] = []
        self._inverse: list[sp.Symbol] = []
        self._without: dict[sp.Expr, sp.Symbol] = {}
        self._inside: dict[sp.Basic, frozenset[sp.Symbol]] = {}

    def terms(self, expression: sp.Expr) -> _Terms:
        """The products of an expression."""
        if expression == 0:
            return []
        skeleton = self._skeleton(expression)
        gens = (*self.parameters, *self._inverse)
        poly = sp.Poly(skeleton, *gens)
        count = len(self.parameters)
        return [
            (powers[:count], {k: n for k, n in enumerate(powers[count:]) if n})
            for powers in poly.monoms()
        ]

    @cache  # noqa: B019
    def degrees(self, k: int) -> tuple[int, ...]:
        """The degrees of a denominator."""
        return tuple(int(sp.Poly(self.bases[k], p).degree()) for p in self.parameters)

    def _skeleton(self, e: sp.Expr) -> sp.Expr:
        if not self._parameters_in(e):
            return self._dummy(e)
        if isinstance(e, sp.Symbol):
            return e
        if isinstance(e, (sp.Add, sp.Mul)):
            inside = [a for a in e.args if self._parameters_in(a)]
            others = [a for a in e.args if not self._parameters_in(a)]
            parts = [self._skeleton(a) for a in inside]
            return e.func(*parts, *([self._dummy(e.func(*others))] if others else []))
        if isinstance(e, sp.Pow) and e.exp.is_Integer:
            if e.exp > 0:
                return self._skeleton(e.base) ** e.exp
            return self._denominator(e.base) ** -e.exp
        shown = " and ".join(f"'{s.name}'" for s in sorted(self._parameters_in(e), key=str))
        raise DefinitionError(
            f"the condition of '{self.name}' is not rational in uncertain {shown}",
            expected="sums, products and quotients of it",
            remedy="leave it out, and give a margin for it",
        )

    def _denominator(self, base: sp.Expr) -> sp.Symbol:
        if odd := symbols_of([base]) - self.constants:
            shown = " and ".join(f"'{s.name}'" for s in sorted(self._parameters_in(base), key=str))
            raise DefinitionError(
                f"the condition of '{self.name}' is divided by a term of uncertain {shown} and "
                f"'{min(odd, key=str)}'",
                expected="denominators of parameters alone",
                remedy="leave it out, and give a margin for it",
            )
        if base not in self.bases:
            self._skeleton(base)  # refuses what is not rational
            self.bases.append(base)
            self._inverse.append(sp.Dummy(real=True))
        return self._inverse[self.bases.index(base)]

    def _dummy(self, e: sp.Expr) -> sp.Expr:
        if e.is_Number:
            return e
        return self._without.setdefault(e, sp.Dummy(real=True))

    def _parameters_in(self, e: sp.Basic) -> frozenset[sp.Symbol]:
        if e not in self._inside:
            if e in self.parameters:
                self._inside[e] = frozenset({e})
            else:
                self._inside[e] = frozenset().union(*(self._parameters_in(a) for a in e.args))
        return self._inside[e]


def ranges(box: ParameterBox) -> Iterator[tuple[str, float, float]]:
    """The name, the least and the largest value of each uncertain parameter."""
    for p, (low, high) in zip(box.uncertain, box.ends, strict=True):
        yield p.name, float(low.value), float(high.value)
