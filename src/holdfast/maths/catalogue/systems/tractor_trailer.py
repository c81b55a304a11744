"""A tractor with trailers, each hitched on, behind or ahead of the axle in front of it."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
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
    hitch_1: float = 0.0,
    hitch_2: float = 0.0,
    hitch_3: float = 0.0,
) -> System:
    """Tractor with one to three trailers, by the axle (x, y) of the last trailer.

        x' = s_N cos(psi_N),   y' = s_N sin(psi_N),   psi0' = r
        b_i = psi_(i-1) - psi_i,   s_0 = v,   s_i = s_(i-1) cos(b_i) + hitch_i psi_(i-1)' sin(b_i)
        psi_i' = (s_(i-1) sin(b_i) - hitch_i psi_(i-1)' cos(b_i)) / length_i

    No axle slips sideways, from the last to the tractor's (i = N ... 0), in which hitch_(N+1) = 0:
    -sin(psi_i) x' + cos(psi_i) y' + hitch_(i+1) psi_i'
    + sum_(k > i) (length_k + hitch_(k+1)) cos(psi_i - psi_k) psi_k' = 0.
    Inputs: speed v of the tractor [m/s], its turn rate r [rad/s]; lengths [m] from each axle
    to its hitch; hitches [m] behind the axle in front, negative ahead of it. A hitch of 0 is on
    the axle: then it is no parameter. Raises `DefinitionError` unless `trailers` is 1, 2 or 3 and
    every hitch_i is above -length_i, and for the hitch of a trailer that is not there.
    """
    whole_number(trailers, "number of trailers", 1, len(LENGTHS))
    lengths, hitches = (length_1, length_2, length_3), (hitch_1, hitch_2, hitch_3)
    _check_hitches(trailers, lengths, hitches)
    psi = [symbol(f"psi{i}") for i in range(trailers + 1)]
    base = [sp.S.Zero, *(symbol(f"length_{i}") for i in range(1, trailers + 1))]
    hitch = [sp.S.Zero] * (trailers + 2)
    for i in range(1, trailers + 1):
        hitch[i] = symbol(f"hitch_{i}") if hitches[i - 1] else sp.S.Zero
    speed, turn = [symbol("v")], [symbol("r")]
    for i in range(1, trailers + 1):
        b = psi[i - 1] - psi[i]
        turn.append((speed[-1] * sp.sin(b) - hitch[i] * turn[-1] * sp.cos(b)) / base[i])
        speed.append(speed[-1] * sp.cos(b) + hitch[i] * turn[i - 1] * sp.sin(b))
    rates = {
        "x": speed[-1] * sp.cos(psi[-1]),
        "y": speed[-1] * sp.sin(psi[-1]),
        **{f"psi{i}": turn[i] for i in range(trailers, -1, -1)},
    }
    rows = [
        PfaffianRow(
            {"x": -sp.sin(psi[i]), "y": sp.cos(psi[i])}
            | {
                f"psi{k}": (base[k] + hitch[k + 1]) * sp.cos(psi[i] - psi[k])
                for k in range(i + 1, trailers + 1)
            }
            | ({f"psi{i}": hitch[i + 1]} if hitch[i + 1] != 0 else {})
        )
        for i in range(trailers, -1, -1)
    ]
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
        parameters=(
            *(
                Parameter(
                    f"length_{i}",
                    "m",
                    f"axle of trailer {i} to "
                    f"{'its hitch' if hitches[i - 1] else 'the axle in front'}",
                    value=lengths[i - 1],
                    above=0.0,
                )
                for i in range(1, trailers + 1)
            ),
            *(
                Parameter(
                    f"hitch_{i}",
                    "m",
                    f"hitch of trailer {i} behind the axle in front",
                    value=hitches[i - 1],
                    above=-lengths[i - 1],
                )
                for i in range(1, trailers + 1)
                if hitches[i - 1]
            ),
        ),
        pfaffian=tuple(rows),
        description=f"tractor with {trailers} trailer{'s' if trailers > 1 else ''}",
        source="O. J. Sordalen, Conversion of the kinematics of a car with n trailers into a "
        "chained form, ICRA 1993; off-axle hitches: P. Rouchon, M. Fliess, J. Levine, P. Martin, "
        "Flatness, motion planning and trailer systems, CDC 1993; a system for the method of "
        "thesis chapter 4",
    )


def _check_hitches(trailers: int, lengths: tuple[float, ...], hitches: tuple[float, ...]) -> None:
    for i, (length, hitch) in enumerate(zip(lengths, hitches, strict=True), start=1):
        if i > trailers and hitch:
            raise DefinitionError(
                f"hitch_{i} is {hitch:g} with {trailers} trailer{'s' if trailers > 1 else ''}",
                expected="the hitch of a trailer that is there",
                remedy="raise the number of trailers, or leave the hitch out",
            )
        if hitch and not hitch > -length:
            raise DefinitionError(
                f"hitch_{i} is {hitch:g} m with length_{i} {length:g} m",
                expected=f"above {-length:g}",
                remedy="a hitch so far ahead puts the trailer's axle ahead of the other axle",
            )
