"""A safeguard's quadratic program solved for every set of conditions that may be active.

    minimise  sum_i ((u_i - w_i) / s_i)^2   subject to   n_j . u <= b_j

With y = u / s, v = w / s and a_j = s n_j: where there is a minimiser, it is

    y_S = v - A' (A A')^-1 (A v - b),   (A A')^-1 (A v - b) >= 0,   a_j . y_S <= b_j for j not in S

for a set S of conditions whose normals A are independent (Karush, Kuhn, Tucker; at most as many as
there are inputs). Multiplied by det(A A') >= 0, the second is without a division. The program has
no admissible input only where each y_S violates a condition outside S.

Then conditions are relaxed by the least slack. If it is one condition a . y <= b, and the others
are bounds of each input, this is

    minimise  |y - v|^2 + (s + P)^2   subject to   a . y - b <= |a| s,    P = 1e6 max(1, |v_i|)

with s > 0 everywhere, so that y_i is at its lower bound where a_i > |a| max |y_i - v_i| / P, at the
upper one where a_i is below the opposite of this, and may be any between. Of several conditions
nothing is said but that the inputs are within their bounds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import reduce

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.law import Safeguard
from holdfast.maths.definitions.law_cases import Conditions, Definitions, Option
from holdfast.maths.expressions.functions import greatest
from holdfast.maths.expressions.traversal import exact

MOST = 400
"""Sets of conditions."""

PULL = -1e6
"""Where the slack is wanted in the simulated program, in units of what inputs are wanted."""

Saturate = Callable[[Sequence[sp.Expr]], Sequence[sp.Expr]]


def options_of(
    guard: Safeguard,
    inputs: Sequence[sp.Symbol],
    wanted: Sequence[sp.Expr] | None,
    saturate: Saturate,
    within: Conditions,
    box: Box | None,
    prefix: str = "",
) -> tuple[Definitions, tuple[Option, ...]]:
    """What a safeguard may make of the inputs that a law wants; None: these may be anything.

    saturate: what limits the inputs afterwards. within: conditions that limited inputs meet. box:
    the bounds of the inputs, if they are one. prefix: of the names that are defined.

    Raises `DefinitionError` for more than `MOST` sets of conditions.
    """
    return _Program(guard, inputs, wanted, prefix).options(saturate, within, box)


def _open(conditions: Conditions) -> Conditions | None:
    """Those that are not decided; None where one never holds."""
    if any(c.is_number and c > 0 for c in conditions):
        return None
    return tuple(c for c in conditions if not c.is_number)


class _Program:
    """The conditions in units of the scales, by names."""

    def __init__(
        self,
        guard: Safeguard,
        inputs: Sequence[sp.Symbol],
        wanted: Sequence[sp.Expr] | None,
        prefix: str,
    ) -> None:
        self.inputs, self.prefix = list(inputs), prefix
        self.definitions: list[tuple[sp.Symbol, sp.Expr]] = []
        names = [u.name for u in inputs]
        self.scales = sp.Matrix([guard.scales[n] for n in names])
        self.count, self.hard = len(guard.offsets), guard.hard
        normals = [[guard.normals[n][j] for n in names] for j in range(self.count)]
        self.exact = sp.Matrix(self.count, len(names), [e for row in normals for e in row])
        self.normals = self.exact.copy()
        for j, i in itertools.product(range(self.count), range(len(names))):
            self.normals[j, i] = self.named(f"_n{j}_{i}", self.exact[j, i])
        self.offsets = sp.Matrix([self.named(f"_b{j}", b) for j, b in enumerate(guard.offsets)])
        self.scaled = self.normals * sp.diag(*self.scales)
        self.wanted = None
        if wanted is not None:
            over = [
                self.named(f"_w{i}", w) / s
                for i, (w, s) in enumerate(zip(wanted, self.scales, strict=True))
            ]
            self.wanted = sp.Matrix(over)

    def named(self, name: str, e: sp.Expr) -> sp.Expr:
        """A symbol for an expression; a number stays one."""
        if e.is_number:
            return e
        symbol = sp.Symbol(f"{self.prefix}{name}", real=True)
        self.definitions.append((symbol, e))
        return symbol

    def options(
        self, saturate: Saturate, within: Conditions, box: Box | None
    ) -> tuple[Definitions, tuple[Option, ...]]:
        found, missed = [], []
        for chosen in self._sets():
            solved = self._solved(chosen)
            if solved is None:
                continue
            u, multipliers = solved
            others = [
                self.normals[j, :].dot(u) - self.offsets[j]
                for j in range(self.count)
                if j not in chosen
            ]
            missed.append(-reduce(greatest, others) if others else sp.S.One)
            when = _open((*(-m for m in multipliers), *others))
            if self.wanted is not None and when is not None:
                found.append(Option(when, tuple(saturate(u))))
        if self.wanted is None:
            rows = self.normals * sp.Matrix(self.inputs) - self.offsets
            found.append(Option(tuple(rows), tuple(self.inputs)))
        if sp.S.One not in missed:
            single = box is not None and self._one_beside(box)
            ways = self._pushed(box) if box is not None and single else [((), self.inputs)]
            found += [Option((*missed, *when, *within), tuple(u)) for when, u in ways]
        return tuple(self.definitions), tuple(found)

    def _one_beside(self, box: Box) -> bool:
        """Whether one condition is relaxed, and the others are the bounds of a box."""
        rows = {(*self.exact[j, :], self.offsets[j]) for j in range(self.hard)}
        sides = {(*map(exact, normal), exact(most)) for normal, most in box.half_spaces()}
        full = all(e.is_finite for e in (*box.lower, *box.upper))
        return full and self.count == self.hard + 1 and rows == sides

    def _pushed(self, box: Box) -> list[tuple[Conditions, list[sp.Expr]]]:
        """Where the one condition that is relaxed pushes the inputs: to a bound, or anywhere."""
        a = self.scaled[self.hard, :]
        size = sp.sqrt(sp.Add(*(e**2 for e in a)))
        ways: list[list[tuple[Conditions, sp.Expr]]] = []
        for i, (low, high) in enumerate(zip(box.lower, box.upper, strict=True)):
            low, high = exact(low), exact(high)
            most = sp.Max(abs(low / self.scales[i]), abs(high / self.scales[i]))
            little = (1 + most) * exact(-1 / PULL) * size
            ways.append([
                ((little - a[i],), low), ((little + a[i],), high),
                ((a[i] - little, -a[i] - little), self.inputs[i]),
            ])  # fmt: skip
        return [
            (tuple(c for when, _ in way for c in when), [u for _, u in way])
            for way in itertools.product(*ways)
        ]

    def _sets(self) -> list[tuple[int, ...]]:
        most = len(self.inputs)
        sizes = range(most + 1) if self.wanted is not None else (most,)
        sets = [s for k in sizes for s in itertools.combinations(range(self.count), k)]
        if len(sets) > MOST:
            raise DefinitionError(
                f"a safeguard with {len(sets)} sets of conditions", expected=f"at most {MOST}"
            )
        return sets

    def _solved(self, chosen: tuple[int, ...]) -> tuple[list[sp.Expr], list[sp.Expr]] | None:
        """The inputs at which these conditions are active, and their multipliers times a size."""
        if not chosen:
            assert self.wanted is not None
            return [s * y for s, y in zip(self.scales, self.wanted, strict=True)], []
        rows = list(chosen)
        a, b = self.scaled[rows, :], self.offsets[rows, :]
        square = len(chosen) == len(self.inputs)
        core = a if square else a * a.T
        if self._dependent(rows):
            return None
        label = "_".join(map(str, chosen))
        if square:  # an input that one condition alone decides is found without the others
            y = (core.adjugate() * b / core.det()).applyfunc(sp.cancel)
        else:
            size = self.named(f"_d{label}", core.det())
            y = self.wanted - a.T * core.adjugate() * (a * self.wanted - b) / size
        u = [
            self.named(f"_y{label}_{i}", s * e)
            for i, (s, e) in enumerate(zip(self.scales, y, strict=True))
        ]
        if self.wanted is None:
            return u, []
        gram = a * a.T
        return u, list(gram.adjugate() * (a * self.wanted - b))

    def _dependent(self, rows: list[int]) -> bool:
        """Whether the normals of these conditions depend on each other everywhere, proved."""
        a = self.exact[rows, :]
        size = (a * a.T).det()
        symbols = sorted(size.free_symbols, key=str)
        at = {s: sp.Rational(7 + 3 * k, 5 + 2 * k) for k, s in enumerate(symbols)}
        value = sp.N(size.subs(at))
        if not value.is_real or value > 1e-9:
            return False
        return bool(sp.expand(size) == 0 or sp.simplify(size) == 0)
