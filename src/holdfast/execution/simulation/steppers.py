"""Explicit Runge-Kutta methods: a tableau each, and the one printer that unrolls them.

A method with a second row of weights estimates its error and may choose its own steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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


def _combination(weights: tuple[float, ...], component: int) -> str:
    terms = [f"{w!r} * k{i}[{component}]" for i, w in enumerate(weights) if w]
    return " + ".join(terms) if terms else "0.0"


def stepper_source(tableau: Tableau, dimension: int) -> str:
    """Source of `step(t, h, q, k0, ...)`: the state after h and the error estimate.

    k0 = field(t, q, ...) is given by the caller, who needs it anyway. The estimate is a
    tuple of zeros for a method without a second row.
    """
    lines = [
        "@inlined",
        "def step(t, h, q, k0, u, mode, plant, gains, table):",
    ]
    for i in range(1, len(tableau.a)):
        stage = ", ".join(
            f"q[{j}] + h * ({_combination(tableau.a[i], j)})" for j in range(dimension)
        )
        lines.append(
            f"    k{i} = field(t + {tableau.c[i]!r} * h, ({stage},), u, mode, plant, gains, table)"
        )
    new = ", ".join(f"q[{j}] + h * ({_combination(tableau.b, j)})" for j in range(dimension))
    lines.append(f"    new = ({new},)")
    if tableau.b_low is None:
        error = ", ".join("0.0" for _ in range(dimension))
    else:
        gap = tuple(float(x) for x in np.subtract(tableau.b, tableau.b_low))
        error = ", ".join(f"h * ({_combination(gap, j)})" for j in range(dimension))
    lines.append(f"    return new, ({error},)")
    return "\n".join(lines)
