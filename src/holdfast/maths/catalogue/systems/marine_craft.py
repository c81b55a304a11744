"""Any marine craft on the plane: its inertia and damping matrices, and its actuators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from holdfast.arguments import checked
from holdfast.errors import ScenarioError
from holdfast.maths.catalogue import actuators
from holdfast.maths.catalogue.systems.planar_craft import CURRENT, STATES, planar_craft
from holdfast.maths.definitions.actuator import INPUTS, Actuator, ActuatorKind
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import overridden, takes, vehicle_for

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
    "Yvvv": ("N s^3/m^3", "sway force by v^3", _ANY),
    "Yr": ("N s", "sway force by r", _ANY),
    "Yrv": ("N s^2/m", "sway force by |r| v", _ANY),
    "Yvr": ("N s^2/m", "sway force by |v| r", _ANY),
    "Yrr": ("N s^2", "sway force by |r| r", _ANY),
    "Yuv": ("N s^2/m^2", "sway force by |u| v", _ANY),
    "Yur": ("N s^2/m", "sway force by |u| r", _ANY),
    "Nr": ("N m s", "linear yaw drag (negative)", _ANY),
    "Nrr": ("N m s^2", "yaw moment by |r| r", _ANY),
    "Nv": ("N s", "yaw moment by v", _ANY),
    "Nvv": ("N s^2/m", "yaw moment by |v| v", _ANY),
    "Nrv": ("N s^2", "yaw moment by |r| v", _ANY),
    "Nvr": ("N s^2", "yaw moment by |v| r", _ANY),
    "Nuv": ("N s^2/m", "yaw moment by |u| v", _ANY),
    "Nur": ("N s^2", "yaw moment by |u| r", _ANY),
    "current_limit": ("m/s", "largest speed of the current", _ANY),
}
"""Name -> (unit, meaning, exclusive lower limit) of every number but those of actuators."""

REQUIRED = ("mass", "Iz", "Xudot", "Yvdot", "Nrdot", "Xu", "Yv", "Nr", "current_limit")
OPTIONAL = tuple(n for n in PARAMETERS if n not in REQUIRED)
LATE = ("lag", "slew")


@takes(PARAMETERS, optional=OPTIONAL, actuators=actuators.ALL)
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
    that fixed thrusters produce; with an actuator of another kind, the inputs of every actuator
    (`actuation`). The kinds are those of `holdfast.maths.catalogue.actuators`: thrusters that push
    along a direction, azimuth thrusters, rudders. A lag and a slew act in `hf.lagged(craft)`.

    vehicle: a shipped vehicle, or the path of a vehicle file. overrides: numbers by name, in SI
    units, in place of those of the file (`PARAMETERS`; of actuator NAME: NAME_ahead, NAME_limit,
    NAME_lag and so on).

    Raises `ScenarioError` for an unknown vehicle or name, `DefinitionError` for actuators that give
    no surge force or no yaw moment, and for an M that is not positive definite.
    """
    craft = vehicle_for(vehicle, PARAMETERS, "marine_craft", OPTIONAL, actuators.ALL)
    numbers = dict(craft.parameters)
    for name in set(overrides) & set(OPTIONAL) - set(numbers):
        unit, meaning, above = PARAMETERS[name]
        numbers[name] = Parameter(name, unit, meaning, value=1.0, above=above)
    for name, (kind, table) in craft.actuators.items():
        _check_name(vehicle, name)
        numbers |= _parameters(name, kind, table)
    numbers = overridden(numbers, overrides, "marine_craft")
    _check_inertia(vehicle, {n: p.value for n, p in numbers.items()})
    parts = [_built(name, kind, table) for name, (kind, table) in craft.actuators.items()]
    order = [*PARAMETERS, *(n for n in numbers if n not in PARAMETERS)]
    return planar_craft(
        "marine_craft",
        (numbers[n] for n in order if n in numbers),
        parts,
        description=f"marine craft by its matrices, {_listed(craft.actuators)}",
        source="Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2021",
    )


def _listed(parts: Mapping[str, tuple[ActuatorKind, object]]) -> str:
    """thrusters port, starboard"""
    kinds = {kind.table: kind.noun + "s" for kind, _ in parts.values()}
    return "; ".join(
        f"{nouns} {', '.join(name for name, (kind, _) in parts.items() if kind.table == table)}"
        for table, nouns in kinds.items()
    )


def _check_name(vehicle: str, name: str) -> None:
    """Refuse an actuator whose name means something else, or cannot be a name."""
    Quantity(name)
    if name in (*PARAMETERS, *(q.name for q in (*STATES, *CURRENT, *INPUTS))):
        raise ScenarioError(
            f"vehicle '{vehicle}': '{name}' cannot name an actuator: it is a state, an input or a "
            "parameter of the craft",
            remedy="rename it, such as aft_port",
        )


def _parameters(
    name: str, kind: ActuatorKind, table: Mapping[str, Parameter]
) -> dict[str, Parameter]:
    """The numbers of an actuator that are parameters of the system, by their names there."""
    return {
        full: replace(p, name=full, description=f"{p.description}, {name}")
        for key, p in table.items()
        if key not in kind.fixed and (full := f"{name}_{key}")
    }


def _built(name: str, kind: ActuatorKind, table: Mapping[str, Parameter]) -> Actuator:
    """The actuator, of the places of its file and the symbols of its parameters."""
    values = {
        key: p.value if key in kind.fixed else symbol(f"{name}_{key}")
        for key, p in table.items()
        if key not in LATE
    }
    return kind.build(name, **values)


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
