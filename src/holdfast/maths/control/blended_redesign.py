"""Viable redesign of a convergent law: blending by the distance to the region's boundary.

For each inequality c_j <= 0 the switching signal

    sigma_j = clip( (cmin_j - c_j) / (cmin_j - cmax_j), 0, 1 ),   cmax_j < cmin_j < 0

is 1 deep inside and 0 near the boundary (thesis (5.26); the printed middle branch is upside
down, E2: 0 at cmax, 1 at cmin). With sigma = min_j sigma_j, attained at j*, the velocities are

    w = sigma w_convergent + (1 - sigma) w_viable,j*                      (5.27), (5.29)

and in a current, where they are relative to the water, likewise (5.39), (5.40).

Once near the goal set while a viable law is active, the `hold` law takes over for good:
without that latch the blend has spurious equilibria (E12). From then on no constraint is
enforced: the designer has to place the goal set well inside the region.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, check_name, suggestion
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching, Transition
from holdfast.maths.expressions.functions import clip, least, select

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
                f"layer for '{name}', which is not an inequality of region '{region.name}'",
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


@checked
def redesign(
    law: Law,
    region: Region,
    *,
    viable: Mapping[str, Law],
    layers: Mapping[str, tuple[float, float]],
    hold: Law | None = None,
    hold_when: sp.Expr | None = None,
    goal: Mapping[str, float] | None = None,
    as_printed: bool = False,
) -> Switching:
    """The viable redesign of `law` for `region`.

    viable: the name of every inequality -> the law used at its boundary. layers: the same names ->
    (cmax, cmin), in the unit of the inequality. hold: the law that keeps the goal set, entered for
    good while a viable law is active. hold_when: an expression; it is entered where this is >= 0.

    Modes: pursue (sigma = 1), protect (sigma < 1), hold. A disturbance that one of the laws
    measures is measured in every mode.

    goal: the state that `law` converges to (states left out are 0; by default the parameters
    goal_x, goal_y of the law, where it has them, and heading 0). as_printed: whether to take the
    middle branch of (5.26) as the thesis prints it.

    Raises `DefinitionError` when an inequality lacks a law or a layer, a law gives other
    outputs, only one of `hold` and `hold_when` is given, two laws contain different values of a
    disturbance, or the goal is outside the region or inside a layer, where the convergent law is
    never fully active.

    >>> boat, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    >>> face = dict.fromkeys(view.inequality_names, hf.laws.face_target(boat))
    >>> layers = dict.fromkeys(view.inequality_names, (-0.1, -0.03))
    >>> law = hf.redesign(hf.laws.steer_marine(boat), view, viable=face, layers=layers)
    >>> list(law.modes)
    ['pursue', 'protect']
    """
    for what, table in (("viable law", viable), ("layer", layers)):
        for name in region.inequality_names:
            if name not in table:
                raise DefinitionError(f"inequality '{name}' has no {what}")
        for name in table:
            if name not in region.inequality_names:
                raise DefinitionError(
                    f"{what} for '{name}', which is not an inequality of region '{region.name}'",
                    remedy=suggestion(name, region.inequality_names),
                )
    region.check_still()
    if (hold is None) != (hold_when is None):
        raise DefinitionError("'hold' and 'hold_when' are given together or not at all")
    if not isinstance(as_printed, bool):
        raise DefinitionError(f"as_printed is {as_printed!r}", expected="true or false")
    laws = [*viable.values()] + ([hold] if hold else [])
    for other in laws:
        if set(other.outputs) != set(law.outputs):
            raise DefinitionError(
                f"law '{other.name}' gives {', '.join(other.outputs)}",
                expected="the outputs of '" + law.name + "': " + ", ".join(law.outputs),
            )
    depth = switching_signals(region, layers)
    _check_goal(law, region, layers, goal)
    raw = {n: _printed(s) for n, s in depth.items()} if as_printed else depth
    names = list(region.inequality_names)
    sigma, deep = raw[names[0]], depth[names[0]]
    chosen = dict(viable[names[0]].outputs)
    for name in names[1:]:
        keep = raw[name] - sigma
        chosen = {k: select(keep, chosen[k], viable[name].outputs[k]) for k in chosen}
        sigma, deep = least(sigma, raw[name]), least(deep, depth[name])
    share = clip(sigma, sp.S.Zero, sp.S.One)
    reads = _united(law, region, *laws)
    parameters = (*law.parameters, *region.parameters, *(p for x in laws for p in x.parameters))
    believed = _beliefs(law, *laws)

    def completed(mode: Law) -> Law:
        return replace(mode, reads=reads, parameters=parameters, believed=believed)

    blend = Law(
        name=f"{law.name} blended with viable laws",
        reads=reads,
        outputs={k: share * law.outputs[k] + (1 - share) * chosen[k] for k in law.outputs},
        parameters=parameters,
        conditions=tuple({c: None for x in (law, *laws) for c in x.conditions}),
        believed=believed,
    )
    modes = {PURSUE: completed(law), PROTECT: blend}
    transitions = []
    if hold is not None:
        modes[HOLD] = completed(hold)
        transitions.append(Transition(PROTECT, HOLD, hold_when))
    transitions += [Transition(PURSUE, PROTECT, 1 - deep), Transition(PROTECT, PURSUE, deep - 1)]
    return Switching(
        name=f"{law.name}, viable in {region.name}",
        modes=modes,
        transitions=tuple(transitions),
        initial=PURSUE,
        signals={f"sigma_{n}": clip(raw[n], sp.S.Zero, sp.S.One) for n in names},
        extra_parameters=parameters,
        description=f"{law.description} Redesigned to stay in {region.name}.",
        source="thesis (5.26)-(5.29), (5.39), (5.40), "
        + ("as printed" if as_printed else "corrected"),
    )


def _printed(signal: sp.Expr) -> sp.Expr:
    """(5.26) as printed, from the corrected signal s: 1 - s in the middle, 0 and 1 outside it."""
    return select(1 - signal, select(signal, 1 - signal, sp.S.Zero), sp.S.One)


def _check_goal(
    law: Law,
    region: Region,
    layers: Mapping[str, tuple[float, float]],
    goal: Mapping[str, float] | None,
) -> None:
    """Refuse a goal of the convergent law at which that law is overridden."""
    read = [q.name for q in region.reads]
    if goal is None:
        constants = {p.name: p.value for p in law.parameters}
        if not {"goal_x", "goal_y"} <= set(constants) or not set(read) <= {"x", "y", "psi"}:
            return
        goal = {"x": constants["goal_x"], "y": constants["goal_y"]}
    names = {q.name for q in (*law.reads, *region.reads)}
    for name in goal:
        check_name(name, names, DefinitionError, f"goal of '{name}'")
    values = {p.symbol: sp.Float(p.value) for p in region.parameters}
    values |= {q.symbol: sp.Float(goal.get(q.name, 0.0)) for q in region.reads}
    pose = ", ".join(f"{n} = {goal.get(n, 0.0):g}" for n in read)
    for c in region.inequalities:
        number, inner = c.expression.xreplace(values).evalf(), layers[c.name][0]
        value = float(number) if number.is_real else math.nan
        if not value < inner:
            where = "inside the switching layer" if value <= 0 else "outside the region"
            raise DefinitionError(
                f"the goal of '{law.name}' ({pose}) is {where}: '{c.name}' is {value:.4g} "
                f"{c.unit} there, its layer [{layers[c.name][0]:g}, {layers[c.name][1]:g}]",
                expected=f"below {inner:g}",
                remedy="move the goal, or choose a thinner layer",
            )


def _beliefs(*laws: Law) -> dict[str, sp.Expr]:
    """The values that all laws believe of the disturbances, which must agree."""
    agreed: dict[str, sp.Expr] = {}
    for law in laws:
        for name, belief in law.believed.items():
            if agreed.setdefault(name, belief) != belief:
                raise DefinitionError(
                    f"law '{law.name}' takes '{name}' for {belief}, another law for {agreed[name]}",
                    expected="one belief in all laws",
                )
    return agreed


def _united(law: Law, region: Region, *others: Law) -> tuple[Quantity, ...]:
    reads = [*law.reads, *region.reads, *(q for other in others for q in other.reads)]
    return tuple({q.name: q for q in reads}.values())
