"""What differs from run to run: parameters drawn at random, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.quantity import Parameter, frozen, symbol


@checked
@dataclass(frozen=True)
class Varied:
    """Parameters that every run has values of its own for.

    draws: name -> (lowest, highest), uniform and independent; a name that is not yet a
    parameter becomes one. values: parameter -> expression of the draws, of values before it and
    of other parameters; law and plant both get it. plant: the same for the simulated vehicle
    alone, whose law keeps the nominal value. units: of the new names, "1" where not given.

    A current of unknown direction: draws = {"direction": (-pi, pi)}, and the disturbance
    Vx = 0.2 cos(direction). A law that is told the current: values = {"current_x": ...}.

    What a catalogue function checks when it is called (r1 >= r0) is not checked again.

    Raises `DefinitionError` for a range that is none, a parameter that is varied twice, or a
    value that uses one after it.
    """

    draws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    values: Mapping[str, sp.Expr] = field(default_factory=dict)
    plant: Mapping[str, sp.Expr] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, given in self.draws.items():
            if len(given) != 2:
                raise DefinitionError(
                    f"'{name}' is drawn from {given!r}",
                    expected="a lowest and a highest number",
                    key=f"varied.draws.{name}",
                )
            low, high = given
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise DefinitionError(
                    f"'{name}' is drawn from [{low:g}, {high:g}]",
                    expected="two finite numbers, lowest first",
                    key=f"varied.draws.{name}",
                )
        twice = set(self.draws) & set(self.values)
        if twice:
            raise DefinitionError(f"'{min(twice)}' is both drawn and given a value")
        object.__setattr__(self, "values", frozen(self.values))
        object.__setattr__(self, "plant", frozen(self.plant))
        later = set(self.values)
        for name, expression in self.values.items():
            later.discard(name)
            ahead = expression.free_symbols & {symbol(n) for n in later}
            if ahead:
                raise DefinitionError(
                    f"the value of '{name}' uses '{min(map(str, ahead))}', which comes after it"
                )

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
                        f"there is no parameter '{name}'"
                        + (" of the system" if what == "plant" else ""),
                        remedy=suggestion(name, names),
                        key=f"varied.{what}.{name}",
                    )
                unknown = expression.free_symbols - {symbol(n) for n in parameters}
                if unknown:
                    raise DefinitionError(
                        f"'{name}' uses '{min(map(str, unknown))}'",
                        expected="an expression of parameters and draws",
                        key=f"varied.{what}.{name}",
                    )

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """Of the values, then of the plant, with every value of the run written out."""
        known: dict[sp.Symbol, sp.Expr] = {}
        for name, expression in self.values.items():
            known[symbol(name)] = expression.subs(known, simultaneous=True)
        return (
            *known.values(),
            *(e.subs(known, simultaneous=True) for e in self.plant.values()),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """What law and plant get: the draws, then the values."""
        return (*self.draws, *self.values)

    @property
    def labels(self) -> tuple[str, ...]:
        """Every varied number by name; those of the plant alone are marked."""
        return (*self.names, *(f"{n} of the plant" for n in self.plant))
