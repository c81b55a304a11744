"""Steer a system in chained form to the origin."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.arguments import checked
from holdfast.maths.catalogue.systems.chained_form import chained_form
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System, check_rates
from holdfast.maths.nonholonomic.chained_feedback import Pole, steer_in_chained_coordinates


@checked
def steer_chained(
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
    """Steer a chained form of any dimension to the origin.

        u1 = -k1 x1,    u2 = -k2 x2 + sum_(j = 3 ... n) (-1)^(j+1) kj xj / x1^(j-2)

    Thesis (4.29) for n = 3 (where k3 = k1 + k2) and (4.30) for n = 4. The ratios
    xj / x1^(j-2) obey an exactly linear closed loop, whose poles [1/s] are `poles`: one number
    for all (-2 by default), or a list of n - 1 (a complex one as a pair [re, im]). Or give the
    `gains` (k2, ..., kn), which are refused unless that loop is stable. From |x1| <
    `threshold` the law first drives x1 away at `escape_speed` for `escape_time` [s] while it
    steers the other states to zero (`escape` = "steer"; "coast" is the thesis's u2 = 0); it
    stops at |x1| <= `stop`.
    """
    n = len(system.states)
    check_rates("steer_chained", system, chained_form, n)
    one, zero = sp.S.One, sp.S.Zero
    return steer_in_chained_coordinates(
        "steer_chained",
        system.states,
        [q.symbol for q in system.states],
        {"u1": (one, zero), "u2": (zero, one)},
        k1=k1,
        poles=poles,
        gains=gains,
        threshold=threshold,
        escape_speed=escape_speed,
        escape_time=escape_time,
        escape=escape,
        stop=stop,
        description="go to the origin of a chained form of any dimension",
        source="thesis (4.29), (4.30), with the exact gain condition",
    )
