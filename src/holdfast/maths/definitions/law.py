"""A feedback law (controller): expressions for inputs, or for velocities used as inputs.

A lookup table is a function known at the nodes of a grid, as symbols in its expressions. What a
sampled law may do are cases: options, with the conditions under which each is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeVar

import sympy as sp

from holdfast.arguments import Written, checked, written_by_user
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import (
    DELAY,
    SAMPLE_TIME,
    TIME,
    Dimension,
    Parameter,
    Quantity,
    check_symbols,
    check_unique,
    frozen,
    merge_parameters,
    numbers_text,
    symbol,
)
from holdfast.maths.definitions.units import Empirical, Free, Units, are_not_checked
from holdfast.maths.definitions.value import FrozenDict, Printed, Value, short_text
from holdfast.maths.expressions.traversal import at_numbers

T = TypeVar("T", bound="Lookup")


@dataclass(frozen=True, eq=False)
class Lookup(Value):
    """V and its slopes at `places`: expressions of quantities a law reads, one for every axis.

    `value` and `slopes` (dV/d place, one for every axis) stand for them in expressions. `table`
    holds the numbers; its type is known only to the code that runs laws. timed: whether the first
    axis is the remaining time. first_time: then the least remaining time that is stored; below it
    the function is constant in time. unit: of V.
    """

    places: tuple[sp.Expr, ...]
    table: object = field(repr=False)
    first_time: float = 0.0
    timed: bool = False
    unit: str = "1"

    @property
    def value(self) -> sp.Symbol:
        return sp.Symbol("_V", real=True)

    @property
    def slopes(self) -> tuple[sp.Symbol, ...]:
        return tuple(sp.Symbol(f"_V{i}", real=True) for i in range(len(self.places)))

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return (self.value, *self.slopes)

    def subs(self: T, values: Mapping[sp.Symbol, sp.Expr]) -> T:
        """The same function, looked up where the symbols have these values."""
        return replace(self, places=tuple(e.xreplace(values) for e in self.places))


@dataclass(frozen=True, eq=False)
class SampledLookup(Lookup):
    """The value of a sampled game, of inputs that are held for `hold` [s].

    predicted [s]: the delay over which the law predicts the state; a run has no other. sloped:
    whether its slopes are looked up too.
    """

    hold: float = 0.0
    predicted: float = 0.0
    sloped: bool = False

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return super().symbols if self.sloped else (self.value,)


@dataclass(frozen=True, eq=False)
class CellLookup(Lookup):
    """What is known of the cell that `places` are in, in place of a value between nodes.

    `value` is how long the cell lasts, `entries` are its `width` numbers. hold: the sampling period
    [s] for which these are; a law that uses them is run at no other. errors: by how much each place
    may be measured wrong; delay [s]: by how long an input may come late.
    """

    width: int = 0
    hold: float = 0.0
    errors: tuple[float, ...] = ()
    delay: float = 0.0

    def error_of(self, state: str) -> float:
        """By how much a state may be measured wrong: not at all where it is no place."""
        among = [e for p, e in zip(self.places, self.errors, strict=False) if p == symbol(state)]
        return among[0] if among else 0.0

    @property
    def entries(self) -> tuple[sp.Symbol, ...]:
        return tuple(sp.Symbol(f"_C{i}", real=True) for i in range(self.width))

    @property
    def symbols(self) -> tuple[sp.Symbol, ...]:
        return (self.value, *self.entries)


Conditions = tuple[sp.Expr, ...]
"""Expressions that are all at most 0 where something is done."""


@dataclass(frozen=True)
class Option(Value):
    """Inputs that are given where `when` < 0, and no option before has its own conditions.

    Where one of `when` is 0 and none is above, they may be given or those of a later option.

    inputs: expressions, one for each input. The symbol of an input itself stands for any number
    that the input may be, the same one in `when`. to: the number of the mode afterwards.
    """

    when: Conditions
    inputs: tuple[sp.Expr, ...]
    to: int = 0

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        return (*self.when, *self.inputs)


@dataclass(frozen=True)
class Program(Value):
    """Inputs that a safeguard gives where `when` < 0, and no option before has its own conditions.

        minimise  sum_i ((u_i - w_i) / s_i)^2   subject to   n_j . u <= b_j

    wanted: w, None where it may be anything. rows: n_j and b_j of each condition in turn, of which
    the first `hard` are not relaxed where not all can be met. scales: s. limits: what actuators
    make of inputs, by the symbols of these. box: the bounds of each input, if they are such.
    """

    when: Conditions
    wanted: tuple[sp.Expr, ...] | None
    rows: tuple[tuple[sp.Expr, ...], ...]
    hard: int
    scales: tuple[sp.Expr, ...]
    limits: tuple[sp.Expr, ...]
    box: tuple[tuple[sp.Expr, sp.Expr], ...] | None
    to: int = 0

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """All but the limits, of which the inputs are those of the program."""
        rows = (e for row in self.rows for e in row)
        ends = (e for pair in self.box or () for e in pair)
        return (*self.when, *(self.wanted or ()), *rows, *self.scales, *ends)


@dataclass(frozen=True)
class LawCases(Value):
    """A sampled law: in each mode the options of which one is taken at a sample.

    modes: their names. initial: the number of the first one. options: of each mode, in order: the
    first whose conditions hold is taken. parts: for each input the edges of the parts that its
    range is divided into, where an option leaves it free. lookup: the table whose symbols the
    expressions use. What depends on the time in the mode is not known.
    """

    modes: tuple[str, ...]
    initial: int
    options: tuple[tuple[Option | Program, ...], ...]
    parts: tuple[tuple[float, ...], ...] = ()
    lookup: Lookup | None = None

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """All of them."""
        options = [o for mode in self.options for o in mode]
        places = self.lookup.places if self.lookup else ()
        limits = (e for o in options if isinstance(o, Program) for e in o.limits)
        return (*(e for o in options for e in o.expressions), *limits, *places)


@checked
@dataclass(frozen=True)
class GainCondition(Value):
    """A stability condition value < limit on the gains, and the consequence of violating it.

    value, limit: expressions of parameters, `SAMPLE_TIME` and `DELAY`. consequence: of violating
    it, a sentence. closed: whether the limit itself is allowed. refused: whether a closed loop that
    violates it is refused; others are warned of.

    >>> c = hf.symbol("c")
    >>> hf.GainCondition(c * hf.SAMPLE_TIME, 2, "the sampled loop is unstable", "").value
    c*sample_time
    """

    value: sp.Expr
    limit: sp.Expr
    consequence: str
    source: str
    closed: bool = False
    refused: bool = False

    def violation(self, parameters: Mapping[sp.Symbol, float]) -> str | None:
        """A sentence with both numbers when the condition fails, else None.

        A delay that is not given is none.
        """
        values = {DELAY: 0.0, **parameters}
        value = float(at_numbers(self.value, values))
        limit = float(at_numbers(self.limit, values))
        if value < limit or (self.closed and value <= limit * (1.0 + 1e-12)):
            return None
        shown = f"{limit:.4g}" if self.limit.is_number else f"{limit:.4g} = {self.limit}"
        return (
            f"{self.value} = {value:.4g} is {'above' if self.closed else 'not below'} "
            f"its limit {shown}: "
            f"{self.consequence} ({self.source})"
        )


MOST_LEVELS = 6
"""Levels of priority of a safeguard."""


@dataclass(frozen=True)
class Foresight(Value):
    """A condition of a safeguard on the value W of a sampled game, one sample ahead:

        W(base + (gains + curves u) u + move_r) >= level   for every r

    motion: the numbers of `HeldMotion`, of places in the table of the law; moves, curved: of them
    too. floor: the level below which the input is the best that there is. beyond: by how much W
    falls with each cell outside the grid. points: inputs that are tried, in the order of the
    inputs. first: whether half-spaces that are not hard give way to it.
    """

    motion: tuple[sp.Expr, ...]
    moves: int
    curved: bool
    points: tuple[tuple[sp.Expr, ...], ...]
    level: sp.Expr
    floor: sp.Expr
    beyond: sp.Expr
    first: bool = True

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """Its numbers: level, floor, beyond, motion, points."""
        points = (e for point in self.points for e in point)
        return (self.level, self.floor, self.beyond, *self.motion, *points)

    @property
    def counts(self) -> tuple[int, int, int, int, int]:
        """The points, the moves, whether there are curves, the motion, and whether it is first."""
        return (
            len(self.points), self.moves, int(self.curved), len(self.motion), int(self.first)
        )  # fmt: skip

    def axes(self, inputs: int) -> int:
        """Of the table, for so many inputs."""
        pairs = inputs * (inputs + 1) // 2
        return len(self.motion) // (1 + inputs + self.moves + (pairs if self.curved else 0))

    def of(
        self, names: Sequence[str], inputs: Sequence[str], gain: sp.Expr,
        shift: Mapping[str, sp.Expr],
    ) -> Foresight:  # fmt: skip
        """The same condition of `inputs` u, in place of w = (u - shift) / gain of some `names`."""
        m, n = len(names), self.axes(len(names))
        pairs = m * (m + 1) // 2
        w = {name: (sp.Symbol(f"_u_{name}", real=True) - shift[name]) / gain for name in names}
        u = {name: sp.Symbol(f"_u_{name}", real=True) for name in inputs}
        none = dict.fromkeys(u.values(), sp.S.Zero)
        base, gains, curves = [], [], []
        for i in range(n):
            place = self.motion[i]
            for j, a in enumerate(names):
                place += self.motion[n + i * m + j] * w[a]
            if self.curved:
                at = n * (1 + m) + i * pairs
                for j, a in enumerate(names):
                    for b in names[j:]:
                        place += self.motion[at] * w[a] * w[b]
                        at += 1
            slopes = [place.diff(a) for a in u.values()]
            base.append(place.xreplace(none))
            gains += [e.xreplace(none) for e in slopes]
            for j, e in enumerate(slopes):
                over = list(u.values())[j:]
                curves += [e.diff(b) / (2 if k == 0 else 1) for k, b in enumerate(over)]
        rest = self.motion[len(self.motion) - n * self.moves :]
        points = [dict(zip(names, point, strict=True)) for point in self.points]
        return replace(
            self,
            motion=(*base, *gains, *(curves if self.curved else ()), *rest),
            points=tuple(
                tuple(gain * point.get(name, sp.S.Zero) + shift[name] for name in inputs)
                for point in points
            ),
        )

    def subs(self, values: Mapping[sp.Symbol, sp.Expr]) -> Foresight:
        """The same with symbols replaced."""

        def there(e: sp.Expr) -> sp.Expr:
            return e.xreplace(values)

        return replace(
            self,
            motion=tuple(map(there, self.motion)),
            points=tuple(tuple(map(there, point)) for point in self.points),
            level=there(self.level),
            floor=there(self.floor),
            beyond=there(self.beyond),
        )


@dataclass(frozen=True)
class FoundPairs(Value):
    """What `execution/obstacle_pairs.py` finds pairs of a vehicle and obstacles by.

    pose: x, y, the cosine and the sine of the heading, of measured states. hull: in the layout of
    that text, in so many parts. clearance [m]. first: whether the conditions bound first
    derivatives alone. rows_handed: whether a row of the inputs itself may be handed over in the
    place of a pair.
    """

    pose: tuple[sp.Expr, ...]
    hull: tuple[float, ...]
    parts: int
    clearance: float
    first: bool
    rows_handed: bool = False


@dataclass(frozen=True)
class Repeated(Value):
    """Conditions that are one function of numbers that are handed over, for each of `count` things.

    rows: normal and offset of each condition in turn, with `numbers`, the symbols of one thing.
    The law is handed the numbers of all things, one thing after the other, behind what else it is
    handed: the first number of one says whether there is such a thing. units: of the offset of each
    condition. found: how the numbers are found.
    """

    numbers: tuple[sp.Symbol, ...]
    rows: tuple[sp.Expr, ...]
    units: tuple[str, ...]
    count: int
    found: FoundPairs

    @property
    def conditions(self) -> int:
        """Those of one thing."""
        return len(self.units)

    def subs(self, values: Mapping[sp.Symbol, sp.Expr]) -> Repeated:
        """The same with symbols replaced."""
        return replace(self, rows=tuple(e.xreplace(values) for e in self.rows))


@checked
@dataclass(frozen=True)
class Safeguard(Value):
    """A safety filter (CBF-QP): half-spaces sum_i normals_ij u_i <= offsets_j of the inputs.

    The input that a law requests is replaced by the nearest one in the half-spaces, in units of
    `scales`. If they have no common point, those after the first `hard` are all relaxed by the
    same least amount, the slack. `units`: the unit of the slack, one for every relaxed condition;
    `names`: the inequality that each comes from. Its expressions may use `SAMPLE_TIME`.
    `levels`: how many relaxed conditions each level of priority has, the most important first;
    where not all can be met the last level gives way first. By default there is one level.
    foresight: a condition that is no half-space. repeated: the conditions that take the place of
    the first ones behind the hard ones, which are met by any input where nothing is there.

    Raises `DefinitionError` for more levels than `MOST_LEVELS`.
    """

    normals: Mapping[str, tuple[sp.Expr, ...]]
    offsets: tuple[sp.Expr, ...]
    hard: int
    scales: Mapping[str, sp.Expr]
    units: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    levels: tuple[int, ...] = ()
    foresight: Foresight | None = None
    repeated: Repeated | None = None

    def __post_init__(self) -> None:
        if len(self.levels) > MOST_LEVELS:
            raise DefinitionError(
                f"a safeguard with {len(self.levels)} levels", expected=f"at most {MOST_LEVELS}"
            )
        object.__setattr__(self, "normals", FrozenDict(dict(self.normals)))
        object.__setattr__(self, "scales", frozen(self.scales))

    @property
    def expressions(self) -> tuple[sp.Expr, ...]:
        """Every expression of it."""
        entries = (e for row in self.normals.values() for e in row)
        more = self.foresight.expressions if self.foresight else ()
        each = self.repeated.rows if self.repeated else ()
        return (*entries, *self.offsets, *self.scales.values(), *more, *each)

    def rows(self, inputs: Sequence[str]) -> list[sp.Expr]:
        """The normal and the offset of every half-space in turn, the scales, the foresight."""
        pairs = enumerate(self.offsets)
        rows = [e for j, offset in pairs for e in (*(self.normals[n][j] for n in inputs), offset)]
        more = self.foresight.expressions if self.foresight else ()
        return [*rows, *(self.scales[n] for n in inputs), *more]

    def subs(self, values: Mapping[sp.Symbol, sp.Expr]) -> Safeguard:
        """The same safeguard with symbols replaced."""
        return Safeguard(
            {n: tuple(e.xreplace(values) for e in row) for n, row in self.normals.items()},
            tuple(e.xreplace(values) for e in self.offsets),
            self.hard,
            {n: e.xreplace(values) for n, e in self.scales.items()},
            self.units,
            self.names,
            self.levels,
            self.foresight.subs(values) if self.foresight else None,
            self.repeated.subs(values) if self.repeated else None,
        )

    @property
    def ends(self) -> tuple[int, ...]:
        """The number of conditions, hard ones too, up to the end of each level."""
        levels = self.levels or (len(self.offsets) - self.hard,)
        return tuple(self.hard + sum(levels[: i + 1]) for i in range(len(levels)))


@checked
@dataclass(frozen=True, repr=False)
class Law(Printed):
    """u_i = outputs_i(t, q; p).

    reads: the quantities that the law may use, all of them measured: states, and disturbances that
    it knows at every instant; an output or signal with any other symbol is refused. outputs: input
    -> its expression, in the unit of the input; text is read as an expression. parameters: what
    they use besides, such as gains. signals: named expressions to record. conditions: on the gains,
    each a `GainCondition`. believed: the values that the law assumes for disturbances, by name,
    where it needs the rates of the states; a missing name means zero. handed: quantities that
    somebody else gives at every sample, such as the command of another controller; expressions may
    use them as they use `reads`. safeguard: a safety filter, the half-spaces that the outputs are
    kept in. lookup: a function known on a grid, whose symbols the outputs, signals and safeguard
    may use. empirical: why units do not count in it; without it they are checked where a user makes
    the law.

    Raises `DefinitionError` without outputs, and for an expression of undeclared names.

    >>> gain = hf.Parameter("k", "1/s", value=2.0)
    >>> print(hf.Law("slow down", cart.states, {"a": "-k*v"}, parameters=(gain,)))
    Law 'slow down' of x, v
      a = -k*v
      parameters: k = 2 1/s
    """

    name: str
    reads: tuple[Quantity, ...]
    outputs: Mapping[str, Written]
    parameters: tuple[Parameter, ...] = ()
    signals: Mapping[str, Written] = field(default_factory=dict)
    conditions: tuple[GainCondition, ...] = ()
    believed: Mapping[str, Written] = field(default_factory=dict)
    safeguard: Safeguard | None = None
    lookup: Lookup | None = None
    handed: tuple[Quantity, ...] = ()
    description: str = ""
    source: str = ""
    empirical: Empirical = field(default="", kw_only=True, compare=False)
    units: ClassVar[Mapping[str, Dimension] | None] = None
    """Output -> its unit where it has one, of a law whose units were checked."""

    def _lines(self) -> tuple[str, list[str], list[str]]:
        reads = ", ".join(q.name for q in (*self.reads, *self.handed))
        last = [f"kept by {len(self.safeguard.offsets)} conditions"] if self.safeguard else []
        if self.lookup is not None:
            places = ", ".join(short_text(e) for e in self.lookup.places)
            last.append(f"looks up a table at {places}")
        last += numbers_text(self.parameters)
        outputs = [f"{n} = {short_text(e)}" for n, e in self.outputs.items()]
        return f"Law '{self.name}' of {reads or 'nothing'}", outputs, last

    def __post_init__(self) -> None:
        owner = f"law '{self.name}'"
        object.__setattr__(self, "parameters", merge_parameters(self.parameters))
        object.__setattr__(self, "outputs", frozen(self.outputs))
        object.__setattr__(self, "signals", frozen(self.signals))
        object.__setattr__(self, "believed", frozen(self.believed))
        if not self.outputs:
            raise DefinitionError(f"{owner} has no outputs")
        named = self.reads + self.handed + self.parameters
        check_unique((q.name for q in named), owner)
        allowed = [q.symbol for q in named] + [TIME]
        if self.lookup is not None:
            places = {f"place {i}": e for i, e in enumerate(self.lookup.places)}
            check_symbols(places, allowed, owner)
            allowed += self.lookup.symbols
        check_symbols({f"output '{k}'": e for k, e in self.outputs.items()}, allowed, owner)
        check_symbols({f"signal '{k}'": e for k, e in self.signals.items()}, allowed, owner)
        check_symbols({f"belief of '{k}'": e for k, e in self.believed.items()}, allowed, owner)
        if self.safeguard is not None:
            each = self.safeguard.repeated
            check_symbols(
                {f"safeguard {i}": e for i, e in enumerate(self.safeguard.expressions)},
                [*allowed, SAMPLE_TIME, *(each.numbers if each else ())],
                owner,
            )
        if written_by_user():
            self.check_units()

    def check_units(self) -> None:
        """Refuse outputs and signals whose units do not fit, unless they are `empirical`.

        What the units of the outputs have to be is known where the law meets a system.
        """
        if are_not_checked(self.empirical, f"law '{self.name}'"):
            return
        units = Units(f"law '{self.name}'", self.reads + self.handed + self.parameters)
        of = {n: units.of(e, f"output '{n}'") for n, e in self.outputs.items()}
        written = {n: kind for n, kind in of.items() if not isinstance(kind, Free)}
        object.__setattr__(self, "units", FrozenDict(written))
        for name, e in self.signals.items():
            units.of(e, f"signal '{name}'")

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(self.outputs)

    def output(self, name: str, owner: str) -> sp.Expr:
        """The output of that name; `DefinitionError` for a law that `owner` cannot be built on."""
        if name not in self.outputs:
            raise DefinitionError(
                f"{owner} needs a law with the output '{name}'",
                expected=f"another than '{self.name}', which has {', '.join(self.outputs)}",
            )
        return self.outputs[name]
