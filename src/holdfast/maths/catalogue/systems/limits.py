"""Optional limits of the inputs of a system: those that are not given are no parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.bounds import Bounds, Box
from holdfast.maths.definitions.quantity import Parameter, symbol


@dataclass(frozen=True)
class Limit:
    """-largest <= u <= largest, or least <= u <= largest; None is no limit.

    The parameters are NAME_limit and, if `least` is given, NAME_least.
    """

    name: str
    unit: str
    meaning: str
    largest: float | None = None
    least: float | None = None

    def __post_init__(self) -> None:
        if self.least is None:
            return
        if self.largest is None or not self.least < self.largest:
            most = "no largest" if self.largest is None else f"{self.largest:g} {self.unit}"
            raise DefinitionError(
                f"{self.name}_least is {self.least:g} {self.unit} with {self.name}_limit {most}",
                expected=f"a {self.name}_limit above {self.name}_least",
            )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those that are given."""
        largest, least = f"largest {self.meaning}", f"least {self.meaning}"
        return tuple(
            Parameter(name, self.unit, meaning, value=value, above=above)
            for name, meaning, value, above in (
                (f"{self.name}_limit", largest, self.largest, 0.0),
                (f"{self.name}_least", least, self.least, -math.inf),
            )
            if value is not None
        )

    @property
    def ends(self) -> tuple[sp.Expr, sp.Expr]:
        """The least and the largest value."""
        if self.largest is None:
            return -sp.oo, sp.oo
        most = symbol(f"{self.name}_limit")
        return (-most if self.least is None else symbol(f"{self.name}_least")), most


def limited(*limits: Limit) -> tuple[tuple[Parameter, ...], Bounds | None]:
    """The parameters of the limits, and the bounds of the inputs: None where there is no limit."""
    parameters = tuple(p for limit in limits for p in limit.parameters)
    if not parameters:
        return (), None
    lower, upper = zip(*(limit.ends for limit in limits), strict=True)
    return parameters, Box(lower, upper)
