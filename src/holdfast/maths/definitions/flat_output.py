"""Flat outputs of a system whose chained coordinates are no states, declared with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp
from sympy.integrals.quadrature import gauss_legendre

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.expressions.canonical import canonical

NODES = 16


@checked
@dataclass(frozen=True)
class Antiderivative:
    """A quantity int_0^upper integrand d(variable), which no elementary function is.

    upper: an expression of the states. integrand: of `variable` and parameters. Its derivative is
    exact, by the fundamental theorem; its value is by Gauss-Legendre quadrature with 16 nodes.
    """

    name: str
    integrand: sp.Expr
    variable: sp.Symbol
    upper: sp.Expr

    @property
    def symbol(self) -> sp.Symbol:
        return symbol(self.name)

    @property
    def slope(self) -> sp.Expr:
        """The derivative by the upper limit."""
        return self.integrand.xreplace({self.variable: self.upper})

    @property
    def value(self) -> sp.Expr:
        """The quadrature, as an expression."""
        half = self.upper / 2
        return sp.Mul(
            half,
            sp.Add(
                *(
                    weight * self.integrand.xreplace({self.variable: half * (1 + node)})
                    for node, weight in _nodes()
                )
            ),
        )


@checked
@dataclass(frozen=True)
class FlatOutput:
    """The flat output (z1, zn) of a system, from which its chained coordinates follow.

    first: z1. last: (zk, ..., zn), at least zn; those before it spare the search their
    differentiation, and it refuses them unless they are what differentiation gives. All are zero at
    the origin. antiderivatives: quantities that these expressions name.
    """

    first: sp.Expr
    last: tuple[sp.Expr, ...]
    antiderivatives: tuple[Antiderivative, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "first", canonical(self.first))
        object.__setattr__(self, "last", tuple(map(canonical, self.last)))
        if not self.last:
            raise DefinitionError("a flat output has no last coordinate", expected="z1 and zn")


@cache
def _nodes() -> tuple[tuple[sp.Float, sp.Float], ...]:
    nodes, weights = gauss_legendre(NODES, 17)
    return tuple(zip(nodes, weights, strict=True))
