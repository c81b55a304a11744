"""A set of states given by named inequalities c_j(q) <= 0.

The one sign convention of holdfast: c <= 0 is safe, as in chapters 5 and 6. Chapter 7 of
the thesis calls l > 0 safe; l = -max_j c_j / s_j is formed here (`Region.margin`) and nowhere else,
with s_j the scale of the inequality: the amount of it, in its unit, that counts as 1. Scales change
no set. They weigh metres against radians when the depth inside the set is measured.

Its shapes in the plane are data; `presentation` draws them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import sympy as sp

from holdfast.arguments import InItsUnit, Written, checked, written_by_user
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import (
    TIME,
    UNWRITTEN,
    Parameter,
    Quantity,
    alike,
    check_symbols,
    check_unique,
    dimension,
    expression_of,
    has_unit,
    merge_parameters,
    numbers_text,
)
from holdfast.maths.definitions.units import (
    Empirical,
    Units,
    are_not_checked,
    of_another_unit,
)
from holdfast.maths.definitions.value import Printed, Value, short_text
from holdfast.maths.expressions.functions import greatest


@dataclass(frozen=True)
class Segment:
    """A fixed line from start to end, e.g. a wall or a target on it."""

    role: str
    start: tuple[sp.Expr, sp.Expr]
    end: tuple[sp.Expr, sp.Expr]


@dataclass(frozen=True)
class Cone:
    """A field of view: apex, heading, half angle and range, expressions of the state."""

    role: str
    apex: tuple[sp.Expr, sp.Expr]
    heading: sp.Expr
    half_angle: sp.Expr
    range: sp.Expr


@dataclass(frozen=True)
class Footprint:
    """A sensor's footprint: a polygon with corners (ahead, left) of the apex, turned by heading."""

    role: str
    apex: tuple[sp.Expr, sp.Expr]
    heading: sp.Expr
    corners: tuple[tuple[sp.Expr, sp.Expr], ...]


@dataclass(frozen=True)
class Circle:
    """A fixed circle, e.g. an obstacle or a set of goals."""

    role: str
    centre: tuple[sp.Expr, sp.Expr]
    radius: sp.Expr


@dataclass(frozen=True)
class ZeroLevel:
    """Where an inequality is zero: the edge of what a region allows, or of a goal."""

    role: str
    name: str
    expression: sp.Expr


Shape = Segment | Cone | Footprint | Circle | ZeroLevel

CONSTRAINT, GOAL = "constraint", "goal"
"""The roles of zero levels."""

WALLS = ("wall", "obstacle", "room")
"""The roles of segments that are drawn as walls: one, a side of an obstacle, and of a room."""


def _remedy(relation: sp.logic.boolalg.Boolean) -> str:
    match relation:
        case sp.LessThan() | sp.StrictLessThan():
            return f"write {short_text(relation.lhs - relation.rhs)}"
        case sp.GreaterThan() | sp.StrictGreaterThan():
            return f"write {short_text(relation.rhs - relation.lhs)}"
        case sp.And():
            return "write an inequality for each part"
    return ""


@checked
@dataclass(frozen=True)
class Inequality(Value):
    """expression <= 0, in the unit given.

    expression: of the states and parameters of its region. scale: how much of it, in that unit,
    counts as 1.

    Raises `DefinitionError` for a relation such as x <= 1 in the place of x - 1, and a scale that
    is not above 0.

    >>> hf.Inequality("fast", abs(v) - 0.5, "m/s")
    Inequality(name='fast', expression=magnitude(v) - 0.5, unit='m/s', description='', scale=None)
    """

    name: str
    expression: Written
    unit: str = UNWRITTEN
    description: str = ""
    scale: InItsUnit | None = None

    def __post_init__(self) -> None:
        boolean = isinstance(self.expression, sp.logic.boolalg.Boolean)
        if boolean and not isinstance(self.expression, sp.Expr):  # as a symbol is
            raise DefinitionError(
                f"inequality '{self.name}' is the relation {short_text(self.expression)}",
                expected="an expression that is at most 0 where it holds",
                remedy=_remedy(self.expression),
            )
        object.__setattr__(self, "expression", expression_of(self.expression))
        if self.scale is not None and not 0 < self.scale < math.inf:
            raise DefinitionError(
                f"inequality '{self.name}' has the scale {self.scale:g}",
                expected="a finite number above 0",
            )

    @property
    def scaled(self) -> sp.Expr:
        """c_j / s_j, or c_j itself where no scale is given."""
        return self.expression if self.scale is None else self.expression / sp.Float(self.scale)


@checked
@dataclass(frozen=True, repr=False)
class Region(Printed):
    """K = { q : c_j(q) <= 0 for every j } (thesis (5.4), with its parameters).

    reads: the states that the inequalities use. inequalities: each an `Inequality`, c_j.
    parameters: what they use besides. scene: the shapes to draw. empirical: why units do not count
    in it; without it they are checked where a user makes the region.

    A moving region, whose inequalities depend on `TIME`, is for kernels, reachable sets, safety
    filters and closed loops.

    Raises `DefinitionError` without an inequality, for two of the same name, and for an expression
    of undeclared names.

    >>> far = hf.Inequality("far", sp.sqrt(x**2 + hf.symbol("y")**2) - 2, "m")
    >>> print(hf.Region("near", robot.states[:2], (far,)))
    Region 'near' of x, y
      far: sqrt(x**2 + y**2) - 2 <= 0 m
    """

    name: str
    reads: tuple[Quantity, ...]
    inequalities: tuple[Inequality, ...]
    parameters: tuple[Parameter, ...] = ()
    scene: tuple[Shape, ...] = ()
    description: str = ""
    source: str = ""
    empirical: Empirical = field(default="", kw_only=True, compare=False)

    def _lines(self) -> tuple[str, list[str], list[str]]:
        conditions = [
            f"{c.name}: {short_text(c.expression)} <= 0 {c.unit}" for c in self.inequalities
        ]
        reads = ", ".join(q.name for q in self.reads)
        return f"Region '{self.name}' of {reads}", conditions, numbers_text(self.parameters)

    def __post_init__(self) -> None:
        owner = f"region '{self.name}'"
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        if not self.inequalities:
            raise DefinitionError(f"{owner} has no inequalities")
        check_unique((c.name for c in self.inequalities), owner)
        check_unique((q.name for q in self.reads + self.parameters), owner)
        allowed = [q.symbol for q in self.reads + self.parameters] + [TIME]
        check_symbols(
            {f"inequality '{c.name}'": c.expression for c in self.inequalities}, allowed, owner
        )
        if written_by_user():
            self.check_units()

    def check_units(self) -> None:
        """Refuse inequalities whose units do not fit, unless they are `empirical`."""
        if are_not_checked(self.empirical, f"region '{self.name}'"):
            return
        units = Units(f"region '{self.name}'", self.reads + self.parameters)
        for c in self.inequalities:
            what = f"inequality '{c.name}'"
            units.check(c.expression, what, units.written(c.unit, what), "its unit")

    def check_states(self, system: str, states: Sequence[Quantity]) -> None:
        """Refuse it where it reads what is no state of a system, or a state in another unit."""
        by_name = {q.name: q for q in states}
        for q in self.reads:
            state = by_name.get(q.name)
            if state is None:
                raise DefinitionError(
                    f"region '{self.name}' reads '{q.name}', which is not a state of system "
                    f"'{system}'",
                    expected="states among " + ", ".join(by_name),
                )
            if has_unit(q) and has_unit(state) and not self.empirical:
                unit = dimension(q.unit)
                if not alike(unit, dimension(state.unit)):
                    does = f"'{q.name}' of region '{self.name}': the region reads it"
                    raise of_another_unit(does, unit, state, f"system '{system}'")

    def check_reads(self, system: str, states: Sequence[Quantity]) -> None:
        """Refuse it likewise, and where it depends on time."""
        self.check_still()
        self.check_states(system, states)

    def check_still(self) -> None:
        """Refuse it where it depends on time."""
        if self.moves:
            raise DefinitionError(
                f"region '{self.name}' depends on time",
                expected="a stationary region; only kernels, reachable sets, safety filters and "
                "closed loops allow a moving one",
            )

    @property
    def moves(self) -> bool:
        return any(c.expression.has(TIME) for c in self.inequalities)

    @property
    def inequality_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.inequalities)

    @checked
    def inequality(self, name: str) -> Inequality:
        """The inequality of that name; `DefinitionError` for an unknown name."""
        if name not in self.inequality_names:
            raise DefinitionError(
                f"region '{self.name}' has no inequality {name!r}",
                expected="one of " + ", ".join(self.inequality_names),
            )
        return self.inequalities[self.inequality_names.index(name)]

    @checked
    def with_scales(self, scales: Mapping[str, float]) -> Region:
        """The same set with these scales; `DefinitionError` for a name without an inequality."""
        for name in scales:
            self.inequality(name)
        return replace(
            self,
            inequalities=tuple(
                replace(c, scale=float(scales[c.name])) if c.name in scales else c
                for c in self.inequalities
            ),
        )

    @property
    def units(self) -> tuple[str, ...]:
        """The different units of the inequalities that have no scale."""
        return tuple(dict.fromkeys(c.unit for c in self.inequalities if c.scale is None))

    @property
    def margin_unit(self) -> str:
        """The unit of `margin`: that of all inequalities, or "1" where they have scales.

        Where units differ and nothing has a scale, 1 m counts as much as 1 rad; the unit is "1".
        """
        scaled = any(c.scale is not None for c in self.inequalities)
        return "1" if scaled or len(self.units) > 1 else self.units[0]

    @property
    def worst(self) -> sp.Expr:
        """max_j c_j(q) / s_j, which is <= 0 exactly in the region."""
        value = self.inequalities[0].scaled
        for c in self.inequalities[1:]:
            value = greatest(value, c.scaled)
        return value

    @property
    def margin(self) -> sp.Expr:
        """l = -max_j c_j(q) / s_j, the convention of chapter 7: safe where positive."""
        return -self.worst


def drawn_shapes(region: Region | None, goal: Region | None) -> tuple[Shape, ...]:
    """The shapes of both scenes, and the zero level of every inequality of both."""
    both = [(role, r) for role, r in ((CONSTRAINT, region), (GOAL, goal)) if r is not None]
    return (
        *(shape for _, r in both for shape in r.scene),
        *(ZeroLevel(role, c.name, c.expression) for role, r in both for c in r.inequalities),
    )
