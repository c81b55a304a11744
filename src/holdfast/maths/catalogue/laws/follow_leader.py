"""Follow a leader by its range and bearing alone and keep it in view: chapter 6."""

from __future__ import annotations

import math

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.control.gain_conditions import held_gain
from holdfast.maths.definitions.law import Law, Safeguard
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.expressions.functions import clip, greatest, sgn
from holdfast.maths.formations.footprint import edges, polygon, side_parameters

SEEN = (Quantity("range", "m", "distance to the leader"), Quantity("bearing", "rad"))
"""The only reads of a follower: its law knows nothing else about the leader."""

NEAR = sp.Float(1e-2)
"""The smallest divisor [m] for the distance ahead: the robots collide long before."""

FOLLOWERS = ("approach_leader", "follow_leader")
"""Laws whose gains keep a leader in view within a window, `hf.visibility_gains`."""

TURNS = ("bearing", "line_of_sight")


@checked
def approach_leader(
    *, k1: float = 0.6, k2: float = 0.8, distance: float = 1.0, turn: str = "bearing"
) -> Law:
    """Go to `distance` from a stationary leader, facing it; nominal, (6.12).

        uF = k1 (range - rd)
        wF = k2 bearing                                        turn = "bearing"
        wF = k2 bearing + uF sin(bearing) / range              turn = "line_of_sight"

    (6.12) with the desired position on the line of sight, where the field points along that line:
    the dipole has no effect. The second form adds the turn rate of the line of sight of a
    stationary leader, so that d/dt bearing = -k2 bearing, as in the thesis. The thesis computes its
    gains (6.17), (6.18) for the first form. Gains that keep the leader in view:
    `hf.visibility_gains`.

    turn: "bearing" or "line_of_sight".

    Raises `DefinitionError` for another turn.
    """
    speed = symbol("k1") * (symbol("range") - symbol("distance"))
    return _law(
        "approach_leader",
        speed,
        turn,
        _gains(k1, k2, distance),
        "go to a distance from a stationary leader, facing it",
        "thesis (6.12), with rd on the line of sight",
    )


@checked
def follow_leader(
    *,
    k1: float = 0.6,
    k2: float = 0.8,
    distance: float = 1.0,
    leader_speed: float = 0.25,
    softness: float = 0.05,
    turn: str = "bearing",
    as_printed: bool = False,
) -> Law:
    """Stay at `distance` from a moving leader, facing it; perturbed, (6.19).

        uF = k1 (range - rd) + uLM clip((range - rd) / softness, -1, 1)
        wF = k2 bearing

    uLM = `leader_speed`, the largest speed of the leader, is all that the law knows of its motion.
    turn = "line_of_sight" adds uF sin(bearing) / range to wF, the part of the turn rate of the line
    of sight that the follower knows; (6.19b) asks for all of it, in the leader's frame, which
    contains uL and wL. Gains that keep the leader in view: `hf.visibility_gains`.

    turn: "bearing" or "line_of_sight". as_printed: whether the sign replaces the saturation, which
    chatters.

    Raises `DefinitionError` for another turn, and an `as_printed` that is no truth value.
    """
    if not isinstance(as_printed, bool):
        raise DefinitionError(
            f"as_printed of follow_leader is {as_printed!r}", expected="true or false"
        )
    gap = symbol("range") - symbol("distance")
    parameters = (*_gains(k1, k2, distance), _leader_speed(leader_speed))
    if as_printed:
        hurry = sgn(gap)
    else:
        hurry = clip(gap / symbol("softness"), sp.S.NegativeOne, sp.S.One)
        parameters += (
            Parameter(
                "softness", "m", "width of the saturation that smooths the sign",
                value=softness, above=0.0,
            ),
        )  # fmt: skip
    return _law(
        "follow_leader",
        symbol("k1") * gap + symbol("leader_speed") * hurry,
        turn,
        parameters,
        "stay at a distance from a moving leader, facing it",
        "thesis (6.19), with rd on the line of sight, "
        + ("its sign as printed" if as_printed else "corrected"),
    )


@checked
def keep_footprint(
    *,
    k1: float = 0.6,
    distance: float = 1.0,
    leader_speed: float = 0.25,
    firmness: float = 1.0,
    vertices: object = None,
) -> Law:
    """Stay behind a leader so that it moves straight to (rd, 0) in the follower's frame.

        wF = k1 Y / X,   uF = k1 (X - rd) + wF Y,   (X, Y) = range (cos(bearing), sin(bearing))

    While the leader is stationary, X' = -k1 (X - rd) and Y' = -k1 Y: for any k1 [1/s] it stays in
    every footprint that is star-shaped about (rd, 0). While it moves, a safety filter changes both
    inputs as little as the sides n . s <= b of the footprint require, against the leader's worst
    motion of uLM = `leader_speed`:

        n . s' + uLM <= -firmness (n . s - b)

    vertices: (X, Y) [m] of the footprint, in order, by default the triangle of `leader_in_view`;
    convex, with (rd, 0) in it. distance rd [m], firmness [1/s].

    Raises `DefinitionError` for a distance that is not inside the footprint.
    """
    bearing, gap = symbol("bearing"), symbol("range")
    ahead, left = gap * sp.cos(bearing), gap * sp.sin(bearing)
    turn = symbol("k1") * left / greatest(ahead, NEAR)
    corners = polygon(vertices)
    sides, numbers = side_parameters(corners)
    if isinstance(distance, int | float) and math.isfinite(distance):  # else `Parameter` refuses
        for number, side in enumerate(edges(corners), start=1):
            if not side.ahead * distance < side.offset:
                raise DefinitionError(
                    f"distance = {distance:g} m is beyond side {number} of the footprint",
                    expected="(distance, 0) inside the footprint",
                )
    slack = [s.ahead * ahead + s.left * left - s.offset for s in sides]
    return Law(
        name="keep_footprint",
        reads=SEEN,
        outputs={"uF": symbol("k1") * (ahead - symbol("distance")) + turn * left, "wF": turn},
        safeguard=Safeguard(
            {
                "uF": tuple(-s.ahead for s in sides),
                "wF": tuple(s.ahead * left - s.left * ahead for s in sides),
            },
            tuple(-symbol("firmness") * c - symbol("leader_speed") for c in slack),
            hard=0,
            scales={"uF": sp.S.One, "wF": sp.S.One},
            units=("m/s",) * len(sides),
        ),
        parameters=(
            Parameter("k1", "1/s", "rate of approach", value=k1, above=0.0, gain=True),
            Parameter("distance", "m", "distance rd to the leader", value=distance, above=0.0),
            _leader_speed(leader_speed),
            Parameter("firmness", "1/s", "how fast a side may be neared", value=firmness, above=0),
            *numbers,
        ),
        description="keep a leader that moves in a convex footprint, going straight to its place",
        source="after thesis section 6.6: any closed convex footprint; law and condition are ours",
    )


def _law(
    name: str,
    speed: sp.Expr,
    turn: str,
    parameters: tuple[Parameter, ...],
    description: str,
    source: str,
) -> Law:
    if turn not in TURNS:
        raise DefinitionError(f"turn of {name} is {turn!r}", expected=" or ".join(map(repr, TURNS)))
    wanted = symbol("k2") * symbol("bearing")
    if turn == "line_of_sight":
        wanted += speed * sp.sin(symbol("bearing")) / greatest(symbol("range"), NEAR)
    return Law(
        name=name,
        reads=SEEN,
        outputs={"uF": speed, "wF": wanted},
        parameters=parameters,
        conditions=held_gain("k1", "k2", consequence="a speed that is held and late overshoots"),
        description=description,
        source=source,
    )


def _gains(k1: float, k2: float, distance: float) -> tuple[Parameter, ...]:
    return (
        Parameter("k1", "1/s", "gain of the distance", value=k1, above=0.0, gain=True),
        Parameter("k2", "1/s", "gain of the bearing", value=k2, above=0.0, gain=True),
        Parameter("distance", "m", "distance rd to the leader", value=distance, above=0.0),
    )


def _leader_speed(value: float) -> Parameter:
    return Parameter("leader_speed", "m/s", "largest speed of the leader", value=value, above=0.0)
