"""Unicycle whose wheels slip on the ground."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.catalogue.systems.limits import Limit, limited
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import PfaffianRow, System


@checked
def slipping_unicycle(
    speed_limit: float = 1.0,
    turn_limit: float = 2.0,
    slip_limit: float = 0.1,
    skid_limit: float = 0.1,
    turn_slip_limit: float = 0.2,
) -> System:
    """Unicycle whose wheels slip: what they roll is not what the robot travels.

        x' = (u - slip) cos(psi) - skid sin(psi)     psi' = r - turn_slip
        y' = (u - slip) sin(psi) + skid cos(psi)

    The Pfaffian row -sin(psi) x' + cos(psi) y' = skid has what the ground does not hold. Inputs:
    the speed u [m/s] and the turn rate r [rad/s] that the wheels roll, bounded by `speed_limit` and
    `turn_limit`. The disturbances are bounded one by one, in the robot's own axes: slip and skid
    [m/s] along and across the wheels by `slip_limit` and `skid_limit`, turn_slip [rad/s] by
    `turn_slip_limit`. They act at rest too, as on a slope. A slip that is a share s of the speed,
    slip = s u, is within these bounds where s <= slip_limit / speed_limit; so is a skid that is a
    share of it. What holds against all of these holds against the shares, which are not worse.

    Raises `DefinitionError` for a bound of slip below 0.
    """
    psi, u, r, slip, skid, turn_slip = (
        symbol(n) for n in ("psi", "u", "r", "slip", "skid", "turn_slip")
    )
    sin, cos = sp.sin(psi), sp.cos(psi)
    rolled, wheels = limited(
        Limit("speed", "m/s", "speed of the wheels", speed_limit),
        Limit("turn", "rad/s", "turn rate of the wheels", turn_limit),
    )
    ground = {
        "slip_limit": ("m/s", "largest slip along the wheels", slip_limit),
        "skid_limit": ("m/s", "largest slip across the wheels", skid_limit),
        "turn_slip_limit": ("rad/s", "largest slip of the turn", turn_slip_limit),
    }
    for name, (unit, _, value) in ground.items():
        if not value >= 0:
            raise DefinitionError(f"{name} is {value:g} {unit}", expected="0 or more")
    return System(
        name="slipping_unicycle",
        states=(
            Quantity("x", "m", "position"),
            Quantity("y", "m", "position"),
            Quantity("psi", "rad", "heading", angle=True),
        ),
        inputs=(
            Quantity("u", "m/s", "speed that the wheels roll"),
            Quantity("r", "rad/s", "turn rate that the wheels roll"),
        ),
        disturbances=(
            Quantity("slip", "m/s", "slip along the wheels"),
            Quantity("skid", "m/s", "slip across the wheels, to the left"),
            Quantity("turn_slip", "rad/s", "slip of the turn"),
        ),
        rates={
            "x": (u - slip) * cos - skid * sin,
            "y": (u - slip) * sin + skid * cos,
            "psi": r - turn_slip,
        },
        parameters=(
            *rolled,
            *(Parameter(n, unit, what, value=x) for n, (unit, what, x) in ground.items()),
        ),
        input_bounds=wheels,
        disturbance_bounds=Box(tuple(-symbol(n) for n in ground), tuple(map(symbol, ground))),
        pfaffian=(PfaffianRow({"x": -sin, "y": cos}, skid),),
        description="wheeled robot whose wheels slip along and across themselves, and in turns",
        source="slip and skid as bounded perturbations of the kinematics: D. Wang and C. B. Low, "
        "ICRA 2007",
    )
