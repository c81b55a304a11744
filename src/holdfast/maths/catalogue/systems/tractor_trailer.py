"""A tractor with trailers, each hitched to the axle in front of it."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol, whole_number
from holdfast.maths.definitions.system import PfaffianRow, System

LENGTHS = (0.5, 0.5, 0.5)


@checked
def tractor_trailer(
    trailers: int = 1,
    *,
    length_1: float = LENGTHS[0],
    length_2: float = LENGTHS[1],
    length_3: float = LENGTHS[2],
) -> System:
    """Tractor with one to three trailers, by the axle (x, y) of the last trailer.

        x' = s_N cos(psi_N),   y' = s_N sin(psi_N),   psi0' = r
        psi_i' = s_(i-1) sin(psi_(i-1) - psi_i) / length_i
        s_0 = v,   s_i = s_(i-1) cos(psi_(i-1) - psi_i)

    No axle slips sideways, from the last to the tractor's (i = N ... 0):
    -sin(psi_i) x' + cos(psi_i) y' + sum_(k > i) length_k cos(psi_i - psi_k) psi_k' = 0.
    Inputs: speed v of the tractor [m/s], its turn rate r [rad/s]; lengths [m] from each axle
    to the one in front. Raises `DefinitionError` unless `trailers` is 1, 2 or 3.
    """
    whole_number(trailers, "number of trailers", 1, len(LENGTHS))
    psi = [symbol(f"psi{i}") for i in range(trailers + 1)]
    base = [sp.S.Zero, *(symbol(f"length_{i}") for i in range(1, trailers + 1))]
    speed = [symbol("v")]
    for i in range(1, trailers + 1):
        speed.append(speed[-1] * sp.cos(psi[i - 1] - psi[i]))
    rates = {
        "x": speed[-1] * sp.cos(psi[-1]),
        "y": speed[-1] * sp.sin(psi[-1]),
        **{
            f"psi{i}": speed[i - 1] * sp.sin(psi[i - 1] - psi[i]) / base[i]
            for i in range(trailers, 0, -1)
        },
        "psi0": symbol("r"),
    }
    rows = [
        PfaffianRow(
            {"x": -sp.sin(psi[i]), "y": sp.cos(psi[i])}
            | {f"psi{k}": base[k] * sp.cos(psi[i] - psi[k]) for k in range(i + 1, trailers + 1)}
        )
        for i in range(trailers, -1, -1)
    ]
    lengths = (length_1, length_2, length_3)
    return System(
        name="tractor_trailer",
        states=(
            Quantity("x", "m", "position of the last trailer"),
            Quantity("y", "m", "position of the last trailer"),
            *(
                Quantity(f"psi{i}", "rad", f"heading of trailer {i}", angle=True)
                for i in range(trailers, 0, -1)
            ),
            Quantity("psi0", "rad", "heading of the tractor", angle=True),
        ),
        inputs=(
            Quantity("v", "m/s", "speed of the tractor"),
            Quantity("r", "rad/s", "turn rate of the tractor"),
        ),
        rates=rates,
        parameters=tuple(
            Parameter(
                f"length_{i}",
                "m",
                f"axle of trailer {i} to the axle in front",
                value=lengths[i - 1],
                above=0.0,
            )
            for i in range(1, trailers + 1)
        ),
        pfaffian=tuple(rows),
        description=f"tractor with {trailers} trailer{'s' if trailers > 1 else ''}",
        source="O. J. Sordalen, Conversion of the kinematics of a car with n trailers into a "
        "chained form, ICRA 1993; a system for the method of thesis chapter 4",
    )
