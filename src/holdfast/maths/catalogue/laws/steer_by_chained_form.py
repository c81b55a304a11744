"""Steer a system to the origin through chained coordinates found by search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.nonholonomic.chained_feedback import (
    Pole,
    slowed_down,
    steer_in_chained_coordinates,
)
from holdfast.maths.nonholonomic.chained_search import find_chained_form
from holdfast.maths.nonholonomic.structure import structure


@checked
def steer_by_chained_form(
    system: System,
    *,
    k1: float = 1.0,
    poles: Pole | Sequence[Pole] | None = None,
    gains: Sequence[float] | None = None,
    threshold: float = 0.9,
    escape_speed: float = 3.0,
    escape_time: float = 1.0,
    escape: str = "steer",
    stop: float = 1e-9,
) -> Switching:
    """Steer a system to the origin through chained coordinates z(q), found by search.

        v1 = -k1 z1,   v2 = -k2 z2 + sum_(j = 3 ... n) (-1)^(j+1) kj zj / z1^(j-2)

    with z1 and zn two of the states and z_(j-1) = L_g1 z_j / L_g1 z1 (`chained_search`), and
    gains as in `steer_chained`. Local: to the states where the transformation is regular
    (for cars and trailers, angles between bodies and to the x axis below 90 deg), which the
    closed loop does not leave.

    Where the system has bounds of its inputs, all inputs are slowed by one factor, so that the
    largest is within them: the path is the same, and takes longer.

    Raises `DefinitionError` when no pair of states begins and ends a chain, with the reason.
    """
    constraint = structure(system)
    search = find_chained_form(constraint)
    if search.found is None:
        raise DefinitionError(
            f"no chained coordinates found for system '{system.name}': {search.reason}"
        )
    form = search.found.written_out()
    law = steer_in_chained_coordinates(
        "steer_by_chained_form",
        constraint.coordinates,
        form.coordinates,
        {u.name: ab for u, ab in zip(constraint.inputs, form.coefficients, strict=True)},
        k1=k1,
        poles=poles,
        gains=gains,
        threshold=threshold,
        escape_speed=escape_speed,
        escape_time=escape_time,
        escape=escape,
        stop=stop,
        parameters=system.parameters,
        description="go to the origin through chained coordinates that are derived",
        source="R. M. Murray and S. S. Sastry, IEEE TAC 38(5), 1993 (chained form); "
        "thesis (4.30) with the exact gain condition",
    )
    if system.input_bounds is None:
        return law
    return law.map_laws(
        lambda mode: replace(mode, outputs=slowed_down(system, mode.outputs)), law.name
    )
