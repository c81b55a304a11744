"""Car-like robot, by the position of its rear or of its front axle."""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.catalogue.systems.limits import Limit, limited
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import FlatOutput, PfaffianRow, System

SOURCE = "R. M. Murray and S. S. Sastry, Nonholonomic motion planning, IEEE TAC 38(5), 1993"


@checked
def car(
    wheelbase: float = 0.5,
    speed_limit: float | None = None,
    speed_least: float | None = None,
    steering_rate_limit: float | None = None,
) -> System:
    """Car-like robot, by the position (x, y) of the middle of its rear axle.

        x' = v cos(psi)    psi'   = v tan(delta) / wheelbase
        y' = v sin(psi)    delta' = w

    Neither axle slips sideways: -sin(psi) x' + cos(psi) y' = 0 (rear) and -sin(psi + delta) x' +
    cos(psi + delta) y' + wheelbase cos(delta) psi' = 0 (front). Inputs: speed v of the rear axle
    [m/s], steering rate w [rad/s]. Beyond |delta| = 90 deg the model has no meaning. A steering
    angle is limited by a region (`steering_angle`).

    speed_limit [m/s]: None for none. speed_least [m/s]: by default -speed_limit; above 0 the car
    does not stop. steering_rate_limit [rad/s]: None for none.

    Raises `DefinitionError` for a `speed_least` without a `speed_limit` above it.
    """
    psi, delta, v, w, base = (symbol(n) for n in ("psi", "delta", "v", "w", "wheelbase"))
    front = psi + delta
    parameters, bounds = limited(*_limits(speed_limit, speed_least, steering_rate_limit))
    return System(
        name="car",
        states=_states("rear"),
        inputs=_inputs("rear"),
        rates={
            "x": v * sp.cos(psi),
            "y": v * sp.sin(psi),
            "psi": v * sp.tan(delta) / base,
            "delta": w,
        },
        parameters=(*_wheelbase(wheelbase), *parameters),
        input_bounds=bounds,
        pfaffian=(
            PfaffianRow({"x": -sp.sin(psi), "y": sp.cos(psi)}),
            PfaffianRow({"x": -sp.sin(front), "y": sp.cos(front), "psi": base * sp.cos(delta)}),
        ),
        description="car-like robot, by the middle of its rear axle",
        source=f"{SOURCE}; a system for the method of thesis chapter 4",
    )


@checked
def front_axle_car(
    wheelbase: float = 0.5,
    speed_limit: float | None = None,
    speed_least: float | None = None,
    steering_rate_limit: float | None = None,
) -> System:
    """Car-like robot, by the position (x, y) of the middle of its front axle.

        x' = v cos(psi + delta)    psi'   = v sin(delta) / wheelbase
        y' = v sin(psi + delta)    delta' = w

    The same robot as `car`; no two of these coordinates begin and end a chained form, but the
    position of the rear axle does, which is declared as the flat output. Inputs: speed v of the
    front wheel [m/s], steering rate w [rad/s].

    speed_limit, speed_least [m/s], steering_rate_limit [rad/s]: as of `car`.
    """
    psi, delta, v, w, base = (symbol(n) for n in ("psi", "delta", "v", "w", "wheelbase"))
    front = psi + delta
    parameters, bounds = limited(*_limits(speed_limit, speed_least, steering_rate_limit))
    return System(
        name="front_axle_car",
        states=_states("front"),
        inputs=_inputs("front"),
        rates={
            "x": v * sp.cos(front),
            "y": v * sp.sin(front),
            "psi": v * sp.sin(delta) / base,
            "delta": w,
        },
        parameters=(*_wheelbase(wheelbase), *parameters),
        input_bounds=bounds,
        pfaffian=(
            PfaffianRow({"x": -sp.sin(front), "y": sp.cos(front)}),
            PfaffianRow({"x": -sp.sin(psi), "y": sp.cos(psi), "psi": -base}),
        ),
        flat_output=FlatOutput(
            first=symbol("x") - base * sp.cos(psi) + base,
            last=(
                sp.tan(delta) / (base * sp.cos(psi) ** 3),
                sp.tan(psi),
                symbol("y") - base * sp.sin(psi),
            ),
        ),
        description="car-like robot, by the middle of its front axle",
        source=f"{SOURCE}; a system for the method of thesis chapter 4",
    )


def _states(axle: str) -> tuple[Quantity, ...]:
    return (
        Quantity("x", "m", f"position of the {axle} axle"),
        Quantity("y", "m", f"position of the {axle} axle"),
        Quantity("psi", "rad", "heading", angle=True),
        Quantity("delta", "rad", "steering angle", angle=True),
    )


def _inputs(axle: str) -> tuple[Quantity, ...]:
    return (
        Quantity("v", "m/s", f"speed of the {axle} axle"),
        Quantity("w", "rad/s", "steering rate"),
    )


def _limits(
    speed: float | None, least: float | None, steering: float | None
) -> tuple[Limit, Limit]:
    return (
        Limit("speed", "m/s", "speed", speed, least),
        Limit("steering_rate", "rad/s", "steering rate", steering),
    )


def _wheelbase(value: float) -> tuple[Parameter, ...]:
    return (Parameter("wheelbase", "m", "distance between the axles", value=value, above=0.0),)
