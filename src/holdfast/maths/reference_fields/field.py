"""A reference vector field and its flow lines: F(x) = factor(x) * components(x)."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import (
    Parameter,
    Quantity,
    check_symbols,
    check_unique,
    given_number,
    merge_parameters,
)

LARGEST = 12
"""The largest dimension of a field of the catalogue."""


@checked
@dataclass(frozen=True)
class Field:
    """F_i(x; parameters) = factor * components[i], one component for each coordinate.

    coordinates: x, each a `Quantity`. components: expressions, smooth at the zeros that are to be
    classified. parameters: what they use besides. factor: an expression, positive away from the
    origin, that does not change the flow lines: 1/r^3 of the electric dipole, 1/rho^2 of thesis
    (2.14). potential: V with F = -grad V, if it exists. moment: the axis p, empty without one.
    notes: facts that were measured, not derived. unit: of F.

    Raises `DefinitionError` when dimensions disagree, a name is undeclared, or the factor is not
    positive.

    >>> sink = hf.Field("sink", robot.states[:2], (-x, -hf.symbol("y")), unit="m")
    >>> hf.classify(sink).kind
    'node'
    """

    name: str
    coordinates: tuple[Quantity, ...]
    components: tuple[sp.Expr, ...]
    moment: tuple[sp.Expr, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    factor: sp.Expr = sp.S.One
    potential: sp.Expr | None = None
    unit: str = "1"
    description: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        owner = f"field '{self.name}'"
        for name in ("components", "moment"):
            object.__setattr__(self, name, tuple(sp.sympify(e) for e in getattr(self, name)))
        object.__setattr__(self, "factor", sp.sympify(self.factor))
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        if self.dimension < 2:
            raise DefinitionError(
                f"{owner} has {self.dimension} coordinates", expected="two or more"
            )
        if len(self.components) != self.dimension:
            raise DefinitionError(
                f"{owner}: {len(self.components)} components",
                expected=f"{self.dimension}, one for each coordinate",
            )
        if self.moment and len(self.moment) != self.dimension:
            raise DefinitionError(
                f"{owner}: moment of dimension {len(self.moment)}",
                expected=f"{self.dimension}, that of the coordinates",
            )
        if self.moment and all(p == 0 for p in self.moment):
            raise DefinitionError(
                f"{owner}: the moment p is zero", expected="a direction, or no moment"
            )
        quantities = self.coordinates + self.parameters
        check_unique((q.name for q in quantities), owner)
        named = zip(self.coordinates, self.components, strict=True)
        check_symbols(
            {f"component '{q.name}'": e for q, e in named}
            | {"the factor": self.factor}
            | ({} if self.potential is None else {"the potential": self.potential}),
            [q.symbol for q in quantities],
            owner,
        )
        check_symbols(
            {"the moment": sp.Tuple(*self.moment)}, [p.symbol for p in self.parameters], owner
        )
        self._check_factor(owner)

    def _check_factor(self, owner: str) -> None:
        factor, generator = self.factor.xreplace(self.values), random.Random(0)
        for _ in range(20):
            point = [generator.uniform(-2.0, 2.0) for _ in self.coordinates]
            at = dict(zip(self.symbols, map(sp.Float, point), strict=True))
            value = complex(sp.N(factor.xreplace(at)))
            if not (value.imag == 0 and value.real > 0 and math.isfinite(value.real)):
                shown = ", ".join(f"{x:.3g}" for x in point)
                raise DefinitionError(
                    f"{owner}: the factor is {value.real:g} at ({shown})",
                    expected="a positive number away from the origin",
                    remedy="move the part that changes sign into the components",
                )

    @property
    def dimension(self) -> int:
        return len(self.coordinates)

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return tuple(q.symbol for q in self.coordinates)

    @property
    def vector(self) -> tuple[sp.Expr, ...]:
        """factor * components: the field itself."""
        return tuple(self.factor * c for c in self.components)

    @property
    def values(self) -> dict[sp.Symbol, sp.Expr]:
        """The parameters' values, exact: 0.1 is 1/10."""
        return {p.symbol: sp.Rational(str(p.value)) for p in self.parameters}

    @property
    def any_values(self) -> dict[sp.Symbol, sp.Expr]:
        """The parameters as anything above their limits: lam -> 1 + positive symbol."""
        return {
            p.symbol: sp.nsimplify(p.above, rational=True) + sp.Symbol(p.name, positive=True)
            for p in self.parameters
            if math.isfinite(p.above)
        }

    @property
    def function(self) -> Callable[..., list[float]]:
        """The components as a Python function of the coordinates, at the parameters' values."""
        return sp.lambdify(
            self.symbols, [c.xreplace(self.values) for c in self.components], "math", cse=True
        )


def coordinate_names(dimension: int) -> tuple[str, ...]:
    """x, y (and z), or x1 ... xN beyond three dimensions."""
    if dimension <= 3:
        return ("x", "y", "z")[:dimension]
    return tuple(f"x{i}" for i in range(1, dimension + 1))


def exact_moment(moment: Sequence[float]) -> tuple[sp.Expr, ...]:
    """The moment as exact numbers: 0.7071067811865476 is sqrt(2)/2; its length is kept.

    Raises `DefinitionError` if it is zero or has an entry that is not finite.
    """
    if not isinstance(moment, Sequence) or isinstance(moment, str) or len(moment) > LARGEST:
        raise DefinitionError(f"the moment p is {moment!r}", expected=f"2 to {LARGEST} numbers")
    numbers = [given_number(value, "the moment p", moment) for value in moment]
    if all(value == 0 for value in numbers):
        raise DefinitionError("the moment p is zero", expected="a direction")
    return tuple(_exact(value) for value in numbers)


def _exact(value: sp.Expr) -> sp.Expr:
    square = sp.nsimplify(value**2, rational=True)
    if value.is_Float and max(square.p, square.q) < 10**6:  # half a square root, as of 45 deg
        root = sp.sign(value) * sp.sqrt(square)
        if abs(root - value) < 1e-15:
            return root
    return sp.nsimplify(value, rational=bool(value.is_Float))
