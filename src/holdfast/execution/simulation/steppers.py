"""Explicit Runge-Kutta methods, a tableau each.

A method with a second row of weights estimates its error and may choose its own steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Tableau:
    """Butcher tableau: stage i is at c[i] with a[i]; the step is b; b - b_low the error."""

    name: str
    order: int
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    b_low: tuple[float, ...] | None = None

    @property
    def c(self) -> tuple[float, ...]:
        return tuple(sum(row) for row in self.a)

    @property
    def adaptive(self) -> bool:
        return self.b_low is not None

    def weights(self) -> npt.NDArray[np.float64]:
        """The rows of a, then b, b - b_low and c, each with an entry for every stage. The shape is
        (stages + 3, stages)."""
        stages = len(self.b)
        table = np.zeros((stages + 3, stages))
        for row, weights in zip(table, self.a, strict=False):
            row[: len(weights)] = weights
        table[stages] = self.b
        if self.b_low is not None:
            table[stages + 1] = np.subtract(self.b, self.b_low)
        table[stages + 2] = self.c
        return table


RK4 = Tableau(
    "rk4",
    4,
    a=((), (1 / 2,), (0, 1 / 2), (0, 0, 1)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
)
"""Kutta 1901, the classical fourth-order method."""

BOGACKI_SHAMPINE = Tableau(
    "bogacki-shampine",
    3,
    a=((), (1 / 2,), (0, 3 / 4), (2 / 9, 1 / 3, 4 / 9)),
    b=(2 / 9, 1 / 3, 4 / 9, 0),
    b_low=(7 / 24, 1 / 4, 1 / 3, 1 / 8),
)
"""P. Bogacki, L. F. Shampine, Appl. Math. Lett. 2(4), 1989: a 3(2) pair."""

DORMAND_PRINCE = Tableau(
    "dormand-prince",
    5,
    a=(
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        (35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    ),
    b=(35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0),
    b_low=(
        5179 / 57600,
        0,
        7571 / 16695,
        393 / 640,
        -92097 / 339200,
        187 / 2100,
        1 / 40,
    ),
)
"""J. R. Dormand, P. J. Prince, J. Comput. Appl. Math. 6(1), 1980: a 5(4) pair."""

ALL = (RK4, BOGACKI_SHAMPINE, DORMAND_PRINCE)
BY_NAME = {tableau.name: tableau for tableau in ALL}
