"""What differs from run to run: parameters drawn at random, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.quantity import Parameter, frozen, symbol


@dataclass(frozen=True)
class Varied:
    """Parameters that every run has values of its own for.

    draws: name -> (lowest, highest), uniform and independent; a name that is not yet a
    parameter becomes one. values: parameter -> expression of the draws and the other
    parameters; law and plant both get it. plant: the same for the simulated vehicle alone,
    whose law keeps the nominal value. units: of the new names, "1" where not given.

    A current of unknown direction: draws = {"direction": (-pi, pi)}, and the disturbance
    Vx = 0.2 cos(direction). A law that is told the current: values = {"current_x": ...}.

    Raises `DefinitionError` for a range that is none, or a parameter that is varied twice.
    """

    draws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    values: Mapping[str, sp.Expr] = field(default_factory=dict)
    plant: Mapping[str, sp.Expr] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, (low, high) in self.draws.items():
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise DefinitionError(
                    f"'{name}' is drawn from [{low:g}, {high:g}]", expected="lowest first"
                )
        twice = set(self.draws) & set(self.values)
        if twice:
            raise DefinitionError(f"'{min(twice)}' is both drawn and given a value")
        object.__setattr__(self, "values", frozen(self.values))
        object.__setattr__(self, "plant", frozen(self.plant))

    def __bool__(self) -> bool:
        return bool(self.draws or self.values or self.plant)

    def new_parameters(self, known: Mapping[str, object]) -> tuple[Parameter, ...]:
        """The drawn names that are no parameters yet, with the middle of their range."""
        return tuple(
            Parameter(n, self.units.get(n, "1"), "drawn for every run", value=(low + high) / 2)
            for n, (low, high) in self.draws.items()
            if n not in known
        )

    def check(
        self, parameters: Mapping[str, Parameter], of_the_plant: Mapping[str, object]
    ) -> None:
        """Refuse what names no parameter, or an expression of anything else."""
        for what, table, names in (
            ("values", self.values, parameters),
            ("plant", self.plant, of_the_plant),
        ):
            for name, expression in table.items():
                if name not in names:
                    raise DefinitionError(
                        f"varied {what}: there is no parameter '{name}'"
                        + (" of the system" if what == "plant" else ""),
                        remedy=suggestion(name, names),
                    )
                unknown = expression.free_symbols - {symbol(n) for n in parameters}
                if unknown:
                    raise DefinitionError(
                        f"varied {what}: '{name}' uses '{min(map(str, unknown))}'",
                        expected="an expression of parameters and draws",
                    )

    @property
    def names(self) -> tuple[str, ...]:
        """What law and plant get: the draws, then the values."""
        return (*self.draws, *self.values)

    @property
    def labels(self) -> tuple[str, ...]:
        """Every varied number by name; those of the plant alone are marked."""
        return (*self.names, *(f"{n} of the plant" for n in self.plant))
