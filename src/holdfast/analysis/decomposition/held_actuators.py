"""Actuators that lag, under commands that are held and that follow old measurements.

    T a' = s(u) - a,   s(u) = a_m + k (s(w) - a_m)

a_m is the measured thrust. While u is held the thrust moves on, and what acts is not w but

    s(w) + (1 - 1 / k) (a - a_m)

"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import sympy as sp

from holdfast.analysis.decomposition.parts_value import ROUNDING, PartsValue, SolvedPart
from holdfast.analysis.reachability.grid import number
from holdfast.analysis.safety.safety_filter import possible_margin
from holdfast.errors import SimulationError
from holdfast.maths.decomposition.prediction import lags
from holdfast.maths.definitions.sets.linear_image import LinearImage

SAMPLE_TIME = 0.02
"""That of `safety_law` [s]."""
SETTLED = 20
"""Time constants after which a response has died out."""
BEYOND = ROUNDING / 2
"""Share of what w may do that a thrust may go beyond it, below what counts as outside."""


def check_held(value: PartsValue, options: Mapping[str, Any]) -> None:
    """Refuse a sample time or a delay in which an actuator would leave its share.

    An actuator stays in its share, whatever w has been, if its response to w is never negative: the
    response settles at w, so that the thrust is a mean of the w until then.
    """
    found = value.decomposition.prediction
    if found is None or found.gain <= 1:
        return
    held, late = _times(options)
    for actuator, constant in zip(found.actuators, _constants(value), strict=True):
        if overshoot(constant, found.gain, held, late) > BEYOND:
            raise SimulationError(
                f"actuator '{actuator.name}' with a lag of {constant:.4g} s, which its commands "
                f"make {found.gain:.4g} times faster, would leave its share in inputs held for "
                f"{held:g} s" + (f" with a delay of {late:g} s" if late else ""),
                remedy="take a shorter sample time or delay, or a larger lag_share",
            )


def overshoot(constant: float, gain: float, held: float, late: float) -> float:
    """The sum of what is negative of the thrusts at the samples after one with w = 1, from rest."""
    fade = math.exp(-held / constant)
    thrust, commands = [0.0], list[float]()
    for n in range(math.ceil(SETTLED * (constant + late) / held) + 2):
        seen, ago = 0.0, n * held - late
        if ago > 0:
            i = min(int(ago / held), n)
            gone = math.exp(-(ago - i * held) / constant)
            seen = thrust[n] if i == n else thrust[i] * gone + (1 - gone) * commands[i]
        commands.append(gain * (n == 0) + (1 - gain) * seen)
        thrust.append(fade * thrust[n] + (1 - fade) * commands[n])
    return -math.fsum(a for a in thrust if a < 0)


def held_errors(value: PartsValue, options: Mapping[str, Any]) -> tuple[float, ...]:
    """By how much the input that acts may differ from w while u is held, for each input."""
    found = value.decomposition.prediction
    if found is None or found.gain <= 1:
        return ()
    return tuple((1 - 1 / found.gain) * moved for moved in _moved(value, options))


def _moved(value: PartsValue, options: Mapping[str, Any]) -> list[float]:
    """How far the thrust of each actuator may move while u is held."""
    found = value.decomposition.prediction
    assert found is not None
    held, late = _times(options)
    return [
        min(1.0, (1 - math.exp(-(held + late) / constant)) * found.gain) * (high - low)
        for (low, high), constant in zip(found.intervals, _constants(value), strict=True)
    ]


def held_margin(
    value: PartsValue, solved: SolvedPart, options: Mapping[str, Any]
) -> dict[str, Any]:
    """The options with a margin for all that acts while inputs are held, if none is given."""
    found = value.decomposition.prediction
    if found is None or found.gain <= 1 or options.get("margin") is not None:
        return dict(options)
    held, late = _times(options)
    wider = 1.0
    for (low, high), moved in zip(found.intervals, _moved(value, options), strict=True):
        wider = max(wider, 1 + (1 - 1 / found.gain) * moved / min(-low, high))
    system = solved.part.system
    bounds = system.input_bounds
    assert bounds is not None
    more = LinearImage(sp.ImmutableMatrix(sp.Float(wider) * sp.eye(bounds.dimension)), bounds)
    wide, whole = replace(system, input_bounds=more), solved.value.reported(definition="")
    return {**options, "margin": possible_margin(wide, whole, held, late)}


def _times(options: Mapping[str, Any]) -> tuple[float, float]:
    """The sample time and the delay [s]."""
    held, late = options.get("sample_time", SAMPLE_TIME), options.get("delay", 0.0)
    return (
        number("sample_time is ", held, "a positive number of seconds", lambda v: 0 < v < math.inf),
        number("delay is ", late, "a number of seconds, 0 or more", lambda v: 0 <= v < math.inf),
    )


def _constants(value: PartsValue) -> list[float]:
    """The time constants of the actuators [s]."""
    system = value.decomposition.system
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    return [float(lag.constant.xreplace(numbers)) for lag in lags(system)]
