"""Any marine craft on the plane: its inertia and damping matrices, and fixed thrusters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from holdfast.arguments import checked
from holdfast.errors import ScenarioError
from holdfast.maths.catalogue.systems.planar_craft import CURRENT, STATES, planar_craft
from holdfast.maths.definitions.extension import LAG, SLEW
from holdfast.maths.definitions.quantity import Parameter, Quantity
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.thruster import INPUTS, Thruster
from holdfast.maths.definitions.vehicle_file import THRUSTER, overridden, takes, vehicle_for

_ANY, _POSITIVE = -math.inf, 0.0

PARAMETERS: dict[str, tuple[str, str, float]] = {
    "mass": ("kg", "rigid-body mass m", _POSITIVE),
    "Iz": ("kg m^2", "yaw moment of inertia about the origin", _POSITIVE),
    "x_g": ("m", "centre of gravity ahead of the origin", _ANY),
    "Xudot": ("kg", "surge added mass (negative)", _ANY),
    "Yvdot": ("kg", "sway added mass (negative)", _ANY),
    "Yrdot": ("kg m", "sway force by yaw acceleration", _ANY),
    "Nvdot": ("kg m", "yaw moment by sway acceleration, Yrdot unless given", _ANY),
    "Nrdot": ("kg m^2", "yaw added inertia (negative)", _ANY),
    "Xu": ("N s/m", "linear surge drag (negative)", _ANY),
    "Xuu": ("N s^2/m^2", "surge drag by |u| u", _ANY),
    "Xuuu": ("N s^3/m^3", "surge drag by u^3", _ANY),
    "Yv": ("N s/m", "linear sway drag (negative)", _ANY),
    "Yvv": ("N s^2/m^2", "sway force by |v| v", _ANY),
    "Yr": ("N s", "sway force by r", _ANY),
    "Yrv": ("N s^2/m", "sway force by |r| v", _ANY),
    "Yvr": ("N s^2/m", "sway force by |v| r", _ANY),
    "Yrr": ("N s^2", "sway force by |r| r", _ANY),
    "Nr": ("N m s", "linear yaw drag (negative)", _ANY),
    "Nrr": ("N m s^2", "yaw moment by |r| r", _ANY),
    "Nv": ("N s", "yaw moment by v", _ANY),
    "Nvv": ("N s^2/m", "yaw moment by |v| v", _ANY),
    "Nrv": ("N s^2", "yaw moment by |r| v", _ANY),
    "Nvr": ("N s^2", "yaw moment by |v| r", _ANY),
    "current_limit": ("m/s", "largest speed of the current", _ANY),
}
"""Name -> (unit, meaning, exclusive lower limit) of every number but those of thrusters."""

REQUIRED = ("mass", "Iz", "Xudot", "Yvdot", "Nrdot", "Xu", "Yv", "Nr", "current_limit")
OPTIONAL = tuple(n for n in PARAMETERS if n not in REQUIRED)
LIMITS = ("ahead", "astern")


@takes({**PARAMETERS, **THRUSTER}, optional=OPTIONAL)
@checked
def marine_craft(vehicle: str = "otter", **overrides: float) -> System:
    """A marine craft on the plane by its matrices, in a uniform current.

        xdot = u cos(psi) - v sin(psi) + Vx
        ydot = u sin(psi) + v cos(psi) + Vy           psidot = r
        M nudot + C(nu) nu + D(nu) nu = tau,          nu = (u, v, r)

    u, v are relative to the water; (Vx, Vy) in a ball of radius `current_limit`. M has the
    cross terms of the centre of gravity x_g and of Yrdot, Nvdot; C is derived from M
    (`coriolis_force`); D has the linear, quadratic and cubic terms that the file gives, and a term
    that it leaves out is 0. T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion
    Control, 2nd edition, 2021, chapters 6 and 7. z is up, psi counter-clockwise, y to port: a
    table for z down holds as it is but for the y and the directions of its thrusters.

    Inputs: tau_u [N], tau_r [N m] and, where the thrusters can choose it, tau_v [N], in the set
    that the thrusters produce (`actuation`). Each thruster of the file stands at x, y, pushes along
    its direction from -astern to ahead, and may have a lag and a slew, which act in
    `hf.lagged(craft)`. Rudders and turning thrusters are no thrusters of this system.

    `vehicle` names a shipped vehicle or a vehicle file; `overrides` replaces numbers by name (SI
    units, see `PARAMETERS`; of thruster NAME: NAME_ahead, NAME_astern, NAME_lag, NAME_slew).
    Raises `ScenarioError` for an unknown vehicle or name, `DefinitionError` for thrusters that give
    no surge force or no yaw moment, and for an M that is not positive definite.
    """
    craft = vehicle_for(vehicle, {**PARAMETERS, **THRUSTER}, "marine_craft", OPTIONAL)
    numbers = dict(craft.parameters)
    for name in set(overrides) & set(OPTIONAL) - set(numbers):
        unit, meaning, above = PARAMETERS[name]
        numbers[name] = Parameter(name, unit, meaning, value=1.0, above=above)
    for name, table in craft.thrusters.items():
        _check_name(vehicle, name)
        numbers |= _of_thruster(name, table)
    numbers = overridden(numbers, overrides, "marine_craft")
    _check_inertia(vehicle, {n: p.value for n, p in numbers.items()})
    thrusters = [
        Thruster(
            name,
            t["x"].value,
            t["y"].value,
            t["direction"].value,
            *(numbers[f"{name}_{side}"].symbol for side in LIMITS),
        )
        for name, t in craft.thrusters.items()
    ]
    order = [*PARAMETERS, *(n for n in numbers if n not in PARAMETERS)]
    return planar_craft(
        "marine_craft",
        (numbers[n] for n in order if n in numbers),
        thrusters,
        description=f"marine craft by its matrices, thrusters {', '.join(craft.thrusters)}",
        source="Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2021",
    )


def _check_name(vehicle: str, name: str) -> None:
    """Refuse a thruster whose name means something else, or cannot be a name."""
    Quantity(name)
    if name in (*PARAMETERS, *(q.name for q in (*STATES, *CURRENT, *INPUTS))):
        raise ScenarioError(
            f"vehicle '{vehicle}': '{name}' cannot name a thruster: it is a state, an input or a "
            "parameter of the craft",
            remedy="rename it, such as aft_port",
        )


def _of_thruster(name: str, table: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """The numbers of a thruster that are parameters of the system, by their names there."""
    names = {side: f"{name}_{side}" for side in LIMITS} | {"lag": name + LAG, "slew": name + SLEW}
    return {
        names[key]: replace(p, name=names[key], description=f"{p.description}, {name}")
        for key, p in table.items()
        if key in names
    }


def _check_inertia(vehicle: str, p: Mapping[str, float]) -> None:
    """Refuse an M of which the symmetric part is not positive definite."""
    m22, m33 = p["mass"] - p["Yvdot"], p["Iz"] - p["Nrdot"]
    offset = p["mass"] * p.get("x_g", 0.0)
    sway_by_yaw = p.get("Yrdot", 0.0)
    cross = offset - (sway_by_yaw + p.get("Nvdot", sway_by_yaw)) / 2
    if not (p["mass"] - p["Xudot"] > 0 and m22 > 0 and m22 * m33 > cross**2):
        raise ScenarioError(
            f"vehicle '{vehicle}': its inertia matrix is not positive definite",
            expected="Iz about the origin of the body; added masses negative",
        )
