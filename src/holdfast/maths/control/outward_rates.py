"""Outward rates: the speed of a system towards the boundary of a region.

The viability condition of the thesis, (5.11): at a state z on the boundary the velocity is
admissible when every active constraint has outward rate grad c_j . qdot <= 0.
"""

from __future__ import annotations

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System


@checked
def outward_rates(system: System, region: Region, law: Law | None = None) -> dict[str, sp.Expr]:
    """d/dt c_j along the system, for every inequality: { name: grad c_j . f(q, u, d) }.

    With a `law`, its outputs take the place of the inputs. Raises `DefinitionError` when
    the region reads a state that the system does not have.
    """
    check_reads(system, region)
    rates = {c.name: system.derivative(c.expression) for c in region.inequalities}
    if law is None:
        return rates
    closed = {q.symbol: law.outputs[q.name] for q in system.inputs}
    return {name: rate.subs(closed) for name, rate in rates.items()}


def check_reads(system: System, region: Region) -> None:
    """Refuse a region that reads an unknown state or depends on time."""
    check_still(region)
    check_states(system, region)


def check_still(region: Region) -> None:
    """Refuse a region that depends on time."""
    if region.moves:
        raise DefinitionError(
            f"region '{region.name}' depends on time",
            expected="a stationary region; only kernels and reachable sets allow a moving one",
        )


def check_states(system: System, region: Region) -> None:
    """Refuse a region that reads an unknown state."""
    missing = [q.name for q in region.reads if q.name not in system.state_names]
    if missing:
        raise DefinitionError(
            f"region '{region.name}' reads '{missing[0]}', which is not a state of system "
            f"'{system.name}'",
            expected="states among " + ", ".join(system.state_names),
        )
