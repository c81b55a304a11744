"""Variation between runs: parameters drawn at random, and values computed from them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.quantity import Parameter, frozen, symbol
from holdfast.maths.definitions.value import FrozenDict, Value

MOST_VERTICES = 1024
"""Vertices of a box of ten draws, all tried from every start."""


@checked
@dataclass(frozen=True, eq=False)
class Varied(Value):
    """Parameters whose values differ from run to run.

    draws: name -> (lowest, highest), uniform and independent; a name that is not yet a
    parameter becomes one. values: parameter -> expression of the draws, of values before it and
    of other parameters; law and plant both get it. plant: the same for the simulated vehicle
    only; the law keeps the nominal value. units: of the new names, "1" where not given.
    cases: parameter -> its values, one for each case, all of the same number; law and plant both
    get them. Every start is simulated in every case, with the same draws, as with other gains:
    run i is start i // n in the case (i mod n) // k, n = k cases, of k vertices.
    vertices: draws that take their lowest and their highest value in every combination, from every
    start, instead of random ones: run i is start i // n at the vertex i mod n of n = 2^k.
    A rate over random draws is an average over their box; the vertices are its corners.

    A current of unknown direction: draws = {"direction": (-pi, pi)}, and the disturbance
    Vx = 0.2 cos(direction). A law that knows the current: values = {"current_x": ...}.

    The checks of a catalogue function when it is called (r1 >= r0) are not repeated per run.

    Raises `DefinitionError` for an invalid range, a parameter that is varied twice, a value that
    uses a later one, vertices of a parameter that is not drawn, or vertices of more than ten draws.

    >>> follow = hf.laws.steer_unicycle(robot)
    >>> gains = hf.Varied(draws={"k1": (0.5, 1.5)}, vertices=("k1",))
    >>> hf.simulate(robot, follow, starts=[[1.0, 0.5, 0.0]], varied=gains, horizon=1.0)
    <Result of 2 runs: 2 stayed>
    """

    draws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    values: Mapping[str, sp.Expr] = field(default_factory=dict)
    plant: Mapping[str, sp.Expr] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    vertices: Sequence[str] = ()
    cases: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, ends in self.draws.items():
            if len(ends) != 2:
                raise DefinitionError(
                    f"'{name}' is drawn from {ends!r}",
                    expected="a lowest and a highest number",
                    key=f"varied.draws.{name}",
                )
            low, high = ends
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise DefinitionError(
                    f"'{name}' is drawn from [{low:g}, {high:g}]",
                    expected="two finite numbers, lowest first",
                    key=f"varied.draws.{name}",
                )
        self._check_vertices()
        self._check_cases()
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

    def _check_vertices(self) -> None:
        chosen = self.vertices
        if isinstance(chosen, str) or len(set(chosen)) < len(chosen):
            raise DefinitionError(
                f"vertices are {chosen!r}",
                expected="names of draws, each once",
                key="varied.vertices",
            )
        for name in chosen:
            if name not in self.draws:
                raise DefinitionError(
                    f"vertices of '{name}', which is not drawn",
                    remedy=suggestion(name, self.draws),
                    key="varied.vertices",
                )
        if 2 ** len(chosen) > MOST_VERTICES:
            raise DefinitionError(
                f"{len(chosen)} draws have {2 ** len(chosen):,} vertices, tried from every start",
                expected=f"at most {MOST_VERTICES:,}",
                remedy="name the draws that matter, and let the others be drawn at random",
                key="varied.vertices",
            )
        object.__setattr__(self, "vertices", tuple(chosen))

    def _check_cases(self) -> None:
        if len({len(column) for column in self.cases.values()}) > 1:
            raise DefinitionError(
                "the cases have different numbers of values",
                expected="one value of every parameter for each case",
                key="varied.cases",
            )
        for name, column in self.cases.items():
            if not column or not all(math.isfinite(value) for value in column):
                raise DefinitionError(
                    f"the cases of '{name}' are {list(column)!r}",
                    expected="at least one finite number",
                    key="varied.cases",
                )
            if name in self.draws or name in self.values:
                raise DefinitionError(f"'{name}' has cases and is drawn or given a value")
        columns = {name: tuple(map(float, column)) for name, column in self.cases.items()}
        object.__setattr__(self, "cases", FrozenDict(columns))

    @property
    def case_count(self) -> int:
        """The number of cases, 1 if none are given."""
        return len(next(iter(self.cases.values()), (0.0,)))

    @property
    def turns(self) -> int:
        """The number of runs from every start: the cases times the vertices."""
        return self.case_count * len(self.corners)

    @property
    def corners(self) -> tuple[tuple[float, ...], ...]:
        """The values of `vertices` at every vertex, the last name varied first; one () if none."""
        return tuple(itertools.product(*(self.draws[name] for name in self.vertices)))

    def __bool__(self) -> bool:
        return bool(self.draws or self.values or self.plant or self.cases)

    def new_parameters(self, known: Mapping[str, object]) -> tuple[Parameter, ...]:
        """The drawn names that are not yet parameters, with the middle of their range."""
        return tuple(
            Parameter(n, self.units.get(n, "1"), "drawn for every run", value=(low + high) / 2)
            for n, (low, high) in self.draws.items()
            if n not in known
        )

    def check(
        self, parameters: Mapping[str, Parameter], of_the_plant: Mapping[str, object]
    ) -> None:
        """Refuse unknown parameters, and expressions of anything but parameters and draws."""
        for what, table, names in (
            ("cases", self.cases, parameters),
            ("values", self.values, parameters),
            ("plant", self.plant, of_the_plant),
        ):
            for name, expression in table.items():
                if name not in names:
                    raise DefinitionError(
                        f"unknown parameter '{name}'"
                        + (" of the system" if what == "plant" else ""),
                        remedy=suggestion(name, names),
                        key=f"varied.{what}.{name}",
                    )
                used = expression.free_symbols if isinstance(expression, sp.Expr) else set()
                unknown = used - {symbol(n) for n in parameters}
                if unknown:
                    raise DefinitionError(
                        f"'{name}' uses '{min(map(str, unknown))}'",
                        expected="an expression of parameters and draws",
                        key=f"varied.{what}.{name}",
                    )

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """Of the values, then of the plant, with every value of the run written out."""
        values: dict[sp.Symbol, sp.Expr] = {}
        for name, expression in self.values.items():
            values[symbol(name)] = expression.subs(values, simultaneous=True)
        return (
            *values.values(),
            *(e.subs(values, simultaneous=True) for e in self.plant.values()),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The values for both law and plant: draws, cases, and the values computed from them."""
        return (*self.draws, *self.cases, *self.values)

    @property
    def labels(self) -> tuple[str, ...]:
        """Every varied number by name; those of the plant only are marked."""
        return (*self.names, *(f"{n} of the plant" for n in self.plant))
