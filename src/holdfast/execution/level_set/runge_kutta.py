"""Explicit Runge-Kutta methods that are convex combinations of Euler steps.

With a step dt and the rate R of the value, a stage of the share h of the step is

    W <- W_0 + weight ((W - W_0) + h dt R(W)),    W_0 the value that the step begins with

so that what an Euler step of length h dt keeps, such as the order of two values, the whole step
keeps. Of the methods of an order with few stages these have the longest steps for their stages
(J. F. B. M. Kraaijevanger, BIT 31, 1991; D. I. Ketcheson, SIAM J. Sci. Comput. 30, 2008).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RungeKutta:
    """stages: of each the weight, and the share of the step at which its rate is taken; lengths:
    how many times an Euler step a step is as long."""

    stages: tuple[tuple[float, float], ...]
    lengths: int

    @property
    def share(self) -> float:
        """Of the step, that of a stage."""
        return 1.0 / self.lengths


def second_order(stages: int) -> RungeKutta:
    """So many stages, steps as long as one Euler step less."""
    lengths = stages - 1
    weights = [1.0] * lengths + [lengths / stages]
    return RungeKutta(tuple((w, k / lengths) for k, w in enumerate(weights)), lengths)


METHODS = {
    1: RungeKutta(((1.0, 0.0),), 1),
    2: second_order(3),
    3: RungeKutta(((1.0, 0.0), (1.0, 0.5), (1.0 / 3.0, 1.0), (1.0, 0.5)), 2),
}
"""By order."""

LONG = second_order(4)
"""Of second order, as long as three Euler steps."""
