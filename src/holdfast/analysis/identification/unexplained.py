"""What a model leaves unexplained, as rates within bounds: a disturbance set from a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from holdfast.analysis.identification.identified import HeldOut, Unexplained
from holdfast.analysis.identification.least_squares import Fitted, Problem, fitted
from holdfast.analysis.identification.log import Floats
from holdfast.analysis.identification.shooting import Shooting
from holdfast.analysis.identification.windows import FEWEST, Windows
from holdfast.errors import SimulationError
from holdfast.maths.control.unmodelled import PREFIX, add_unmodelled
from holdfast.maths.definitions.bounds import Box
from holdfast.maths.definitions.extension import per_second
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import symbols_of
from holdfast.maths.identification.measured_motion import MeasuredMotion, measured_motion

SHORTER = (8, 4, 2, 1)
"""Parts of a window over which what is unexplained is constant, the shortest first."""

DOUBT = 2.0
"""Deviations of the noise by which what a window needs may lie beyond the bound."""

JUDGED = 0.5
"""The part of the windows that has to have enough measurements."""

MOST_NOISE = 0.5
"""The part of its spread that noise may give what is unexplained, for a shorter window."""


def pushed_motion(
    system: System, motion: MeasuredMotion, chosen: Sequence[str] | None
) -> MeasuredMotion:
    """The motion with unknown parts of rates: those of `chosen` states.

    By default of the states whose rates have an input or a parameter; of all where there is none.
    """
    states = [q.name for q in motion.states]
    if chosen is None:
        movers = {q.symbol for q in motion.inputs}
        movers |= {p.symbol for p in system.parameters}
        chosen = [n for n in states if symbols_of([system.rates[n]]) & movers] or states
    if missing := [n for n in chosen if n not in states]:
        raise SimulationError(
            f"the log says nothing of '{missing[0]}'", expected="some of " + ", ".join(states)
        )
    free = Box((-1.0,) * len(chosen), (1.0,) * len(chosen))
    pushed = add_unmodelled(system, chosen, free)
    present = {q.name for q in motion.unknown}
    disturbances = [n for n in system.disturbance_names if n in present]
    outputs = dict(zip(motion.names, motion.outputs, strict=True))
    return measured_motion(
        pushed, motion.names, [*(PREFIX + n for n in chosen), *disturbances], outputs
    )


def needed(
    shooting: Shooting,
    system: System,
    windows: Sequence[Windows],
    noise: Floats,
    still: Mapping[str, float],
    log: str,
) -> Unexplained:
    """What the windows need, for the shortest ones in which noise is not most of it.

    windows: of one log, the shortest first. still: the constant disturbances of the log. Raises
    `SimulationError` where half of the windows have too few measurements to tell.
    """
    motion = shooting.motion
    local = [k for k, q in enumerate(motion.unknown) if q.name.startswith(PREFIX)]
    given = np.array([still.get(q.name, 0.0) for q in motion.unknown])
    names = tuple(motion.unknown[k].name.removeprefix(PREFIX) for k in local)
    units = {q.name: per_second(q.unit) for q in system.states}
    told = None
    for some in windows:
        problem = Problem(shooting, some, given, (), local)
        found: Fitted = fitted(problem, np.empty(0), np.empty(0), noise=noise)
        shown = problem.determined(found)
        if shown.sum() < max(FEWEST, JUDGED * len(shown)):
            continue
        n = shooting.states
        told = Unexplained(
            names,
            tuple(units[name] for name in names),
            (),
            (),
            found.local[shown, n:],
            np.sqrt(np.einsum("wii->wi", found.spread)[shown, n:]),
            some.start[shown],
            some.length,
            int((~shown).sum()),
        )
        if max(told.noise_share, default=0.0) <= MOST_NOISE:
            break
    if told is None:
        raise SimulationError(
            f"{log}: the measurements of a window of {windows[-1].length:.3g} s do not show what "
            "the model leaves unexplained",
            remedy="take longer windows, or a log with more measurements",
        )
    return told


def bounded(found: Unexplained, widen: float) -> Unexplained:
    """The box around all that was needed, each half-width `widen` times as large."""
    least, most = found.value.min(axis=0), found.value.max(axis=0)
    middle, half = (least + most) / 2, (most - least) / 2 * widen
    return replace(found, low=tuple((middle - half).tolist()), high=tuple((middle + half).tolist()))


def compared(
    name: str, second: Unexplained, bound: Unexplained, error: Mapping[str, float]
) -> HeldOut:
    """A second log beside the bound of the first."""
    low, high = np.array(bound.low), np.array(bound.high)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-300)
    distance = np.abs(second.value - middle)
    away = distance / half
    surely = (distance - DOUBT * second.by_noise) / half
    return HeldOut(
        name,
        second,
        int((surely > 1.0).any(axis=1).sum()),
        int((away > 1.0).any(axis=1).sum()),
        tuple(away.max(axis=0).tolist()),
        dict(error),
    )
