"""A convergent law and a region to a viable law: blending by distance to the boundary.

For each inequality c_j <= 0 the switching signal

    sigma_j = clip( (cmin_j - c_j) / (cmin_j - cmax_j), 0, 1 ),   cmax_j < cmin_j < 0

is 1 deep inside and 0 near the boundary (thesis (5.26); the printed middle branch is upside
down, E2). With sigma = min_j sigma_j, attained at j*, the velocities are

    w = sigma w_convergent + (1 - sigma) w_viable,j*                      (5.27), (5.29)

and, once near the goal set while a viable law is active, the `hold` law takes over for good:
without that latch the blend has spurious equilibria (E12). From then on no constraint is served
any more; that the goal set lies well inside the region is the designer's to see.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.functions import clip, least, select
from holdfast.maths.law import Law
from holdfast.maths.quantity import Quantity, merge_parameters
from holdfast.maths.region import Region
from holdfast.maths.switching import Switching, Transition

PURSUE, PROTECT, HOLD = "pursue", "protect", "hold"


def switching_signals(
    region: Region, layers: Mapping[str, tuple[float, float]]
) -> dict[str, sp.Expr]:
    """sigma_j before clipping, for every inequality with a layer (cmax_j, cmin_j).

    Raises `DefinitionError` for an unknown inequality or cmax_j < cmin_j < 0 violated.
    """
    signals = {}
    for name, (inner, outer) in layers.items():
        if name not in region.inequality_names:
            raise DefinitionError(
                f"layer for '{name}', which is no inequality of region '{region.name}'",
                remedy=suggestion(name, region.inequality_names),
            )
        if not -math.inf < inner < outer < 0:
            raise DefinitionError(
                f"layer of '{name}' is [{inner:g}, {outer:g}]",
                expected="[cmax, cmin], "
                "cmax < cmin < 0: fully convergent below cmax, fully viable above cmin",
            )
        low, high = sp.Float(inner), sp.Float(outer)
        signals[name] = (high - region.inequality(name).expression) / (high - low)
    return signals


def redesign(
    law: Law,
    region: Region,
    *,
    viable: Mapping[str, Law],
    layers: Mapping[str, tuple[float, float]],
    hold: Law | None = None,
    hold_when: sp.Expr | None = None,
) -> Switching:
    """The viable redesign of `law` for `region`.

    `viable` maps the name of every inequality to the law used at its boundary, `layers` to
    its (cmax, cmin). `hold`, entered for good when `hold_when` >= 0 while a viable law is
    active, is the law that keeps the goal set. Modes: pursue (sigma = 1), protect
    (sigma < 1), hold.

    Raises `DefinitionError` when an inequality lacks a law or a layer, a law gives other
    outputs, or only one of `hold` and `hold_when` is given.
    """
    for what, given in (("viable law", viable), ("layer", layers)):
        for name in region.inequality_names:
            if name not in given:
                raise DefinitionError(f"inequality '{name}' has no {what}")
        for name in given:
            if name not in region.inequality_names:
                raise DefinitionError(
                    f"{what} for '{name}', which is no inequality of region '{region.name}'",
                    remedy=suggestion(name, region.inequality_names),
                )
    if (hold is None) != (hold_when is None):
        raise DefinitionError("'hold' and 'hold_when' are given together or not at all")
    laws = [*viable.values()] + ([hold] if hold else [])
    for other in laws:
        if set(other.outputs) != set(law.outputs):
            raise DefinitionError(
                f"law '{other.name}' gives {', '.join(other.outputs)}",
                expected="the outputs of '" + law.name + "': " + ", ".join(law.outputs),
            )
    raw = switching_signals(region, layers)
    names = list(region.inequality_names)
    sigma = raw[names[0]]
    chosen = dict(viable[names[0]].outputs)
    for name in names[1:]:
        keep = raw[name] - sigma
        chosen = {k: select(keep, chosen[k], viable[name].outputs[k]) for k in chosen}
        sigma = least(sigma, raw[name])
    share = clip(sigma, sp.S.Zero, sp.S.One)
    signals = {f"sigma_{n}": clip(raw[n], sp.S.Zero, sp.S.One) for n in names}
    reads = _united(law, region, *laws)
    parameters = merge_parameters(law.parameters, region.parameters, *(x.parameters for x in laws))
    blend = Law(
        name=f"{law.name} blended with viable laws",
        reads=reads,
        outputs={k: share * law.outputs[k] + (1 - share) * chosen[k] for k in law.outputs},
        parameters=parameters,
        conditions=law.conditions,
    )
    modes = {PURSUE: law, PROTECT: blend}
    transitions = []
    if hold is not None:
        modes[HOLD] = hold
        transitions.append(Transition(PROTECT, HOLD, hold_when))
    transitions += [Transition(PURSUE, PROTECT, 1 - sigma), Transition(PROTECT, PURSUE, sigma - 1)]
    return Switching(
        name=f"{law.name}, viable in {region.name}",
        modes=modes,
        transitions=tuple(transitions),
        initial=PURSUE,
        signals=signals,
        extra_parameters=parameters,
        description=f"{law.description} Redesigned to stay in {region.name}.",
        source="thesis (5.26)-(5.29), corrected",
    )


def _united(law: Law, region: Region, *others: Law) -> tuple[Quantity, ...]:
    reads = [*law.reads, *region.reads, *(q for other in others for q in other.reads)]
    return tuple({q.name: q for q in reads}.values())
