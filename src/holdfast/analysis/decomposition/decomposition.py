"""What a problem falls into: its parts, how their sets make up the whole, and why that is so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import sympy as sp

from holdfast.maths.decomposition.prediction import Prediction
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System

EXACT, INNER = "exact", "inner"


@dataclass(frozen=True)
class Part:
    """A problem over few states that is solved by itself.

    coordinates: state of the part -> its expression in the states of the whole system. region: to
    be kept, or reached; goal: of a capture basin. cut: states of the whole that are disturbances
    here, with their intervals.
    """

    kind: str
    system: System
    region: Region | None
    goal: Region | None
    coordinates: Mapping[str, sp.Expr]
    cut: Mapping[str, tuple[float, float]]

    @property
    def about(self) -> Region:
        """The region whose inequalities decide the part."""
        region = self.goal or self.region
        assert region is not None
        return region

    @property
    def inequality_names(self) -> tuple[str, ...]:
        """Of both regions, each once."""
        both = (r.inequality_names for r in (self.goal, self.region) if r is not None)
        return tuple(dict.fromkeys(n for names in both for n in names))


@dataclass(frozen=True)
class Decomposition:
    """The parts of a problem, and what their sets say of its set.

    alternatives: lists of parts; a state is in the set where all parts of one list have it. The
    value is the largest over the lists of the least over the parts. verdict: "exact", or "inner":
    every state of the set put together is in the set, up to the error of the grids. reasons: why,
    in sentences. kept: of a kernel, the region of the whole. domain: inequalities of the states
    of the whole that have to hold besides. prediction: of actuators that lag, how they were taken
    out; box: the intervals of the states left, over which what remains of them is bounded;
    within: of them, those that are kept in their intervals.
    """

    system: System
    kind: str
    alternatives: tuple[tuple[Part, ...], ...]
    verdict: str
    reasons: tuple[str, ...]
    disturbances: str = "min"
    kept: Region | None = None
    domain: tuple[Inequality, ...] = ()
    prediction: Prediction | None = None
    box: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    within: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts, of one list after the other."""
        return tuple(p for parts in self.alternatives for p in parts)

    @property
    def most_states(self) -> int:
        """The number of states of the largest part."""
        return max(len(p.system.states) for p in self.parts)

    @property
    def where(self) -> str:
        """The domain in words."""
        return " and ".join(_intervals(self.domain))

    @property
    def guarantee(self) -> str:
        """What the set put together is, in one sentence."""
        if self.verdict == EXACT:
            return "the set put together is the set itself, up to the error of the grids"
        return (
            "the set put together is inner: every state in it is in the set, up to the error of "
            "the grids"
        )

    def lines(self) -> Iterator[str]:
        """A description: the parts, the verdict and the reasons."""
        count = len(self.system.states)
        yield f"{self.kind} of '{self.system.name}', {count} states"
        several = len(self.alternatives) > 1
        for k, parts in enumerate(self.alternatives):
            if several:
                yield f"alternative {k + 1}"
            for part in parts:
                yield ("  " if several else "") + _line(part, self.system)
        if self.domain:
            yield f"holds where {self.where}"
        yield f"{self.verdict}: {self.guarantee}"
        for reason in self.reasons:
            yield f"- {reason}"

    def __str__(self) -> str:
        return "\n".join(self.lines())


def _line(part: Part, whole: System) -> str:
    states = ", ".join(
        n
        if str(e) == n
        else ("predicted " if n in whole.state_names else "") + f"{n} = {sp.sstr(sp.N(e, 3))}"
        for n, e in part.coordinates.items()
    )
    disturbed = ""
    if part.cut:
        units = {q.name: q.unit for q in part.system.disturbances}
        intervals = (f"{n} in {shown(i, units[n])}" for n, i in part.cut.items())
        disturbed = f", disturbed by {', '.join(intervals)}"
    inputs = ", ".join(part.system.input_names) or "no input"
    about = ", ".join(part.inequality_names)
    return f"part ({states}) by {inputs}{disturbed}: {about}"


def _intervals(domain: Sequence[Inequality]) -> Iterator[str]:
    """The inequalities in turn, two that bound one expression as its interval."""
    left = [(row, *row.expression.as_coeff_Add()) for row in domain]
    while left:
        row, low, first = left.pop(0)
        if left and left[0][2] == -first:
            _, high, _ = left.pop(0)
            yield f"{sp.sstr(sp.N(-first, 3))} is in {shown((low, -high), row.unit)}"
        else:
            yield f"{sp.sstr(sp.N(row.expression, 3))} <= 0"


def shown(interval: tuple[float, float], unit: str) -> str:
    """An interval with its unit."""
    low, high = map(float, interval)
    return f"[{low:.4g}, {high:.4g}]" + ("" if unit == "1" else f" {unit}")
