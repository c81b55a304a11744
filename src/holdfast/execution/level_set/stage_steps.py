"""The arithmetic of a stage of a step at a node, for every target.

    slopes   mean = half (below + above),  gap = half (above - below)
    step     new = base + weight ((value - base) + dt rate), the rate limited to one sign,
             and new within the bounds

Of a scheme that has one slope of every interval the slopes are differences of the nodes on either
side; others have computed them before. What lies between the two is the rate (`rate_leaves.py`).

A scheme of higher order may balance a ridge against its dissipation, and stand still where the
equation does not. So it is filtered: with r the rate of the scheme, r_M that of the monotone step
from the plain differences (`maths/games/monotone_flux.py`), s a bound of |r - r_M|, and b how far
the slopes are from the mean of the plain differences and from one another,

    rate = r_M + w (r - r_M),   w = 1 to s + k b = e,  2 - (s + k b) / e to 2 e,  0 beyond

Where the value is smooth s is of the order of a cell, b of its square, and both are less than the
leeway e, so that the rate is that of the scheme. At a kink within a cell b is a part of s, however
weak the kink: there a scheme of high order takes the slope of either side as far as the kink, and
stands still where neither side falls. k is 0 where no other march is beside this one.

A step differs from a monotone one by no more than e dt, and e tends to 0 with the cells, whatever
the value, so that the values converge to the viscosity solution (G. Barles, P. E. Souganidis,
Asymptotic Anal. 4, 1991; B. D. Froese, A. M. Oberman, SIAM J. Numer. Anal. 51, 2013;
O. Bokanowski, M. Falcone, S. Sahu, SIAM J. Sci. Comput. 38, 2016, where w depends on |r - r_M|
itself, which is small where a ridge is balanced). Limits and bounds keep the order of two values,
and a Runge-Kutta step is a convex combination of such stages, so that it holds for a whole step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from holdfast.execution.arithmetic.steps import FLOAT, Steps, Value, choose
from holdfast.execution.codegen.llvm_body import LANES
from holdfast.execution.level_set.rate_leaves import RateLeaves

NUMBERS = ("dt", "weight", "floor", "ceiling", "nearest", "leeway", "share", "bent")
"""The first of its numbers, the last three for a filter; `OF_AXES` of every axis follow."""

OF_AXES = ("half", "step", "low", "high", "lowest_low", "lowest_high")
"""Numbers of each axis: half the inverse of its step, its step, and of what a set is kept within
(`stencils.py`) how much it falls from node to node beyond both ends, and down to what."""


def names_of_numbers(axes: int) -> list[str]:
    """The numbers of a stage, in their order."""
    return [*NUMBERS, *(f"{x}{i}" for x in OF_AXES for i in range(axes))]


INFINITE = 1e300

MOST_STEEP = 4.0
"""How many times larger the leeway may be where the value is steeper than the start value."""


@dataclass(frozen=True)
class Stage:
    """one_slope: whether an interval has one slope. filtered: whether the rate is held close to
    that of a monotone step. limits: the lowest and the highest rate. side: of zero, for which it is
    measured how fast the set moves. from_start: the values are those that the step begins with and
    that its result is compared with. lower, upper: whether there are such bounds at nodes."""

    rates: RateLeaves
    axes: int
    one_slope: bool
    filtered: bool
    limits: tuple[float, float]
    side: float
    from_start: bool
    lower: bool
    upper: bool

    @property
    def lanes(self) -> int:
        """Nodes that are computed at a time."""
        rate = self.rates.rate
        return 2 * LANES if rate.single and rate.algebraic else LANES

    def slopes(self) -> tuple[Steps, list[Value]]:
        """The means, then the gaps, from inputs value, below0, above0, half0, below1, ..."""
        steps = Steps(expanded=True)
        means, gaps = [], []
        for i in range(self.axes):
            below, above = steps.input(f"below{i}"), steps.input(f"above{i}")
            if self.one_slope:
                here = steps.input("value")
                below, above = here - below, above - here
            half = steps.input(f"half{i}")
            means.append(half * (below + above))
            gaps.append(half * (above - below))
        return steps, [*means, *gaps]

    def apart(self) -> tuple[Steps, list[Value]]:
        """s + k b, with s a bound of |r - r_M| whatever the Hamiltonian; the leeway e; and whether
        the first is more.

        No speed exceeds c_i, so that with slopes p and plain differences q on both sides of a node

            |r - r_M| <= s = sum_i c_i (max(|p_i- - q_i-|, |p_i+ - q_i+|) + |q_i+ - q_i-| / 2)
                         b = sum_i c_i (|p_i- + p_i+ - q_i- - q_i+| + |p_i+ - p_i-|) / 2
            e = a R,  or  a sum_i c_i min(|q_i-|, |q_i+|)  where that is more, at most 4 a R

        with the share a and the largest rate R of the start value. Inputs: leeway, which is a R,
        share, bent, which is k, and of each axis below0, above0, plain_below0, plain_above0,
        speed0, half0, ...
        """
        steps = Steps(expanded=True)
        bent = steps.input("bent")
        most, steep = steps.constant(0.0, FLOAT), steps.constant(0.0, FLOAT)
        for i in range(self.axes):
            below, above = steps.input(f"below{i}"), steps.input(f"above{i}")
            pace = 2.0 * (steps.input(f"half{i}") * steps.input(f"speed{i}"))
            lower, upper = steps.input(f"plain_below{i}"), steps.input(f"plain_above{i}")
            differ = _at_least(abs(below - lower), abs(above - upper))
            bend = abs(below + above - lower - upper) + abs(above - below)
            most = most + pace * (differ + 0.5 * abs(upper - lower) + 0.5 * (bent * bend))
            steep = steep + pace * _at_most(abs(lower), abs(upper))
        leeway = steps.input("leeway")
        own = _at_least(steep * steps.input("share"), leeway)
        own = _at_most(own, MOST_STEEP * leeway)
        return steps, [most, own, most > own]

    def filter(self) -> tuple[Steps, list[Value]]:
        """The rate, from inputs rate, monotone, apart and leeway (those of `apart`)."""
        steps = Steps(expanded=True)
        rate, monotone, apart, leeway = map(steps.input, ("rate", "monotone", "apart", "leeway"))
        left = _at_least((2.0 * leeway - apart) / leeway, steps.constant(0.0, FLOAT))
        return steps, [choose(apart > leeway, monotone + left * (rate - monotone), rate)]

    def step(self, measured: bool) -> tuple[Steps, list[Value]]:
        """The new value, whether it differs, whether it is not finite, and how far it has moved.

        The last only if `measured`. Inputs: value, base, before, rate, lower and upper, `NUMBERS`,
        and of each axis mean0, gap0, step0, ...
        """
        steps = Steps(expanded=True)
        base, dt, weight = (steps.input(x) for x in ("base", "dt", "weight"))
        lowest, highest = self.limits
        r = steps.input("rate")
        r = r if highest == math.inf else _at_most(r, steps.constant(highest, FLOAT))
        r = r if lowest == -math.inf else _at_least(r, steps.constant(lowest, FLOAT))
        new = base + weight * ((steps.input("value") - base) + dt * r)
        for name, bound, there in (
            ("lower", _at_least, self.lower),
            ("upper", _at_most, self.upper),
        ):
            if there:
                new = bound(new, steps.input(name))
        new = _at_most(_at_least(new, steps.input("floor")), steps.input("ceiling"))
        was = steps.input("before")
        results = [new, new.differs(was), ~(abs(new) < INFINITE)]
        if measured:
            results.append(self._move(steps, new, was))
        return steps, results

    def _move(self, steps: Steps, new: Value, was: Value) -> Value:
        """By how much of a cell the value of a node on that side of zero has moved.

        Or by how much of its distance from zero, if that is more. A cell is how much the value
        changes from a node to the next, on its flatter side, the largest along the axes: of the
        slopes mean - gap and mean + gap on either side the smaller is ||mean| - |gap||.
        """
        cell = steps.constant(0.0, FLOAT)
        for i in range(self.axes):
            mean, gap, step = (steps.input(f"{x}{i}") for x in ("mean", "gap", "step"))
            change = step * abs(abs(mean) - abs(gap))
            cell = choose(change > cell, change, cell)
        w = self.side * was
        near = choose(w > cell, w, cell)
        nearest = steps.input("nearest")
        near = choose(near > nearest, near, nearest)
        return choose(w > 0.0, abs(new - was) / near, 0.0)


def _at_most(value: Value, bound: Value) -> Value:
    """NaN passes, so that it is seen."""
    return choose(value > bound, bound, value)


def _at_least(value: Value, bound: Value) -> Value:
    return choose(value < bound, bound, value)
