"""A tractor with trailers, each hitched on, behind or ahead of the axle in front of it."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.limits import Limit, limited
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol, whole_number
from holdfast.maths.definitions.system import Antiderivative, FlatOutput, PfaffianRow, System

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
    speed_limit: float | None = None,
    turn_limit: float | None = None,
) -> System:
    """Tractor with one to three trailers, by the axle (x, y) of the last trailer.

        x' = s_N cos(psi_N),   y' = s_N sin(psi_N),   psi0' = r
        b_i = psi_(i-1) - psi_i,   s_0 = v,   s_i = s_(i-1) cos(b_i) + hitch_i psi_(i-1)' sin(b_i)
        psi_i' = (s_(i-1) sin(b_i) - hitch_i psi_(i-1)' cos(b_i)) / length_i

    No axle slips sideways, from the last to the tractor's (i = N ... 0), in which hitch_(N+1) = 0:
    -sin(psi_i) x' + cos(psi_i) y' + hitch_(i+1) psi_i' + sum_(k > i) (length_k + hitch_(k+1))
    cos(psi_i - psi_k) psi_k' = 0. Inputs: speed v of the tractor [m/s], its turn rate r [rad/s].

    trailers: 1, 2 or 3. length_1, length_2, length_3 [m]: from each axle to its hitch. hitch_1,
    hitch_2, hitch_3 [m]: behind the axle in front, negative ahead of it; a hitch of 0 is on the
    axle, and no parameter then. speed_limit [m/s], turn_limit [rad/s]: of the tractor; None for
    none.

    With the last hitch off the axle alone the system is flat, as it is with all hitches on their
    axles (`_flat_output`); with a hitch further ahead off its axle it is not.

    Raises `DefinitionError` for another number of trailers, unless every hitch_i is above
    -length_i, and for the hitch of a trailer that is not there.
    """
    whole_number(trailers, "number of trailers", 1, len(LENGTHS))
    lengths, hitches = (length_1, length_2, length_3), (hitch_1, hitch_2, hitch_3)
    _check_hitches(trailers, lengths, hitches)
    psi = [symbol(f"psi{i}") for i in range(trailers + 1)]
    parameters, bounds = limited(
        Limit("speed", "m/s", "speed of the tractor", speed_limit),
        Limit("turn", "rad/s", "turn rate of the tractor", turn_limit),
    )
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
            *parameters,
        ),
        input_bounds=bounds,
        pfaffian=tuple(rows),
        flat_output=_flat_output(trailers)
        if hitch[trailers] != 0 and not any(hitch[:-2])
        else None,
        description=f"tractor with {trailers} trailer{'s' if trailers > 1 else ''}",
        source="O. J. Sordalen, ICRA 1993; hitches off the axle: P. Rouchon et al., CDC 1993; "
        "a system for the method of thesis chapter 4",
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


def _flat_output(trailers: int) -> FlatOutput:
    """The flat output where only the last hitch, h behind its axle, is off it.

    In the form of P. Rouchon, M. Fliess, J. Levine, P. Martin, Flatness, motion planning and
    trailer systems, CDC 1993, up to the point that the arc is counted from.

        l^2 = h^2 + L^2 + 2 h L cos(b),   c = (h + L cos(b)) h / l
        arc = int_0^b h^2 L^2 sin(s)^2 / l(s)^3 ds
        Y = (x, y) + c n + arc n_perp

    with b the last hitch angle, n the direction from the last axle to the one in front, which has
    the angle phi, and n_perp its left normal. Y moves along n, with the curvature

        kappa = l sin(b) / ((h^2 + L^2) cos(b) + h L (1 + cos(b)^2) - arc l sin(b))

    whose divisor vanishes at a hitch angle of its own: 99.7 deg for h = 0.2 L, 49.9 for -L / 2.
    """
    x, y, front, rear, h, length = (
        symbol(n)
        for n in (
            "x",
            "y",
            f"psi{trailers - 1}",
            f"psi{trailers}",
            f"hitch_{trailers}",
            f"length_{trailers}",
        )
    )
    b, s = front - rear, symbol("s")

    def square(angle: sp.Expr) -> sp.Expr:
        return h**2 + length**2 + 2 * h * length * sp.cos(angle)

    arc = Antiderivative(
        "arc", h**2 * length**2 * sp.sin(s) ** 2 / square(s) ** sp.Rational(3, 2), s, b
    )
    away = sp.sqrt(square(b))
    # from the last axle to the one in front: l n
    ahead = h * sp.cos(front) + length * sp.cos(rear)
    left = h * sp.sin(front) + length * sp.sin(rear)
    share, across = h * (h + length * sp.cos(b)) / square(b), arc.symbol / away
    divisor = (h**2 + length**2) * sp.cos(b) + h * length * (1 + sp.cos(b) ** 2)
    return FlatOutput(
        first=x + share * ahead - across * left - h,
        last=(
            square(b) ** 2 * sp.sin(b) / (ahead**3 * (divisor - arc.symbol * away * sp.sin(b))),
            left / ahead,
            y + share * left + across * ahead,
        ),
        antiderivatives=(arc,),
    )
