"""Laws from a value function: the optimal input, and a safety filter that preserves the value.

The constraints can be kept where V > 0. With p = dV/dq, the optimal input maximises
p . f(q, u, d) (thesis (7.3), (7.7)). A given law is left unchanged as long as, for every
disturbance d,

    p . f(q, u, d) + rate (V - margin) >= 0

so that the filter does nothing well inside the set and intervenes progressively as V approaches
the margin (V as a control barrier function: A. D. Ames et al., European Control Conference 2019).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar, cast

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.control.prediction import Prediction, held_motion
from holdfast.maths.control.safety_filter import check_fit, input_rows, input_scales, over_time
from holdfast.maths.definitions.law import Foresight, Law, Lookup, Safeguard, SampledLookup
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import least, select
from holdfast.maths.games.hamiltonian import Hamiltonian, hamiltonian

L = TypeVar("L", bound=Law | Switching)


ADVERSARY_AIM = symbol("adversary_aim")
"""A parameter of `against_the_worst`: 0 lowers the value, 1 lowers a margin."""


NO_FLOOR = sp.Float(-1e30)
"""Of a condition that asks for the best there is."""


def _at_costates(
    h: Hamiltonian, table: Mapping[str, sp.Expr], slopes: Sequence[sp.Expr]
) -> dict[str, sp.Expr]:
    costates = dict(zip(h.costates, slopes, strict=True))
    return {name: e.xreplace(costates) for name, e in table.items()}


def optimal_law(system: System, lookup: Lookup) -> Law:
    """The optimal inputs: they raise V most, or lower it least; bang-bang within a box."""
    h = hamiltonian(system)
    return Law(
        name=f"optimal inputs of {system.name}",
        reads=system.states,
        outputs=_at_costates(h, h.inputs, lookup.slopes[-len(system.states) :]),
        parameters=system.parameters,
        signals={"value": lookup.value},
        lookup=lookup,
        description="the inputs that raise the value the most",
        source="thesis (7.3), (7.7)",
    )


def soonest_law(
    system: System,
    lookup: SampledLookup,
    *,
    points: Sequence[Sequence[sp.Expr]],
    disturbances: Sequence[Sequence[sp.Expr]],
    latest: float,
) -> Law:
    """The inputs after which the time of arrival T is least, whatever the disturbance; W = -T.

    They are those nearest to `optimal_law` after which T has fallen by the hold,

        T(q after the sample) <= T(q) - hold   for each of the disturbances

    or else those after which T is least (dynamic programming: R. Bellman, 1957). T is compared
    where inputs lead, so that no slope across a jump of T counts. latest [s]: above all T.
    """
    motion = held_motion(system, sp.Float(lookup.hold), disturbances)
    foresight = Foresight(
        motion.expressions, motion.moves, motion.curved, tuple(map(tuple, points)),
        level=lookup.value + lookup.hold, floor=NO_FLOOR, beyond=sp.Float(latest),
    )  # fmt: skip
    bounds = input_rows(system)
    guard = Safeguard(
        normals={name: tuple(n[i] for n, _ in bounds) for i, name in enumerate(system.input_names)},
        offsets=tuple(b for _, b in bounds),
        hard=len(bounds),
        scales=input_scales(system, {}),
        units=(lookup.unit,),
        foresight=foresight,
    )
    return replace(
        optimal_law(system, lookup),
        name=f"least time of {system.name}",
        signals={"time_to_go": -lookup.value},
        safeguard=guard,
        description="the inputs after which the time of arrival is least",
        source="R. Bellman, Dynamic programming, 1957",
    )


def keep_value(
    system: System,
    law: L,
    lookup: Lookup,
    *,
    rate: float,
    margin: float,
    scales: Mapping[str, float] | None = None,
) -> L:
    """`law` with a safety filter: the least change of its inputs that keeps V above `margin`.

    The last axes of `lookup` are the states; one before them is the time to go, which falls.
    Raises `DefinitionError` for a law that does not give the system's inputs or has a safety filter
    already, and for inputs bounded by a ball of more than three dimensions or by more actuators
    than inputs.
    """
    if not system.inputs:
        raise DefinitionError(f"system '{system.name}' has no inputs")
    hamiltonian(replace(system, samples=0))  # refuses rates that are not affine
    slopes = lookup.slopes[-len(system.states) :]
    gain = sp.Matrix(list(system.rates.values())).jacobian([q.symbol for q in system.inputs])
    none = {q.symbol: sp.S.Zero for q in system.inputs}
    drifting = replace(
        system,
        inputs=(),
        input_bounds=None,
        rates={n: r.xreplace(none) for n, r in system.rates.items()},
        pfaffian=(),
    )
    h = hamiltonian(drifting)
    worst = h.value.xreplace(dict(zip(h.costates, slopes, strict=True)))
    if len(lookup.places) > len(slopes):
        left = lookup.places[0] - sp.Float(lookup.first_time)
        worst -= select(left, lookup.slopes[0], sp.S.Zero)
    room = symbol("safety_rate") * (lookup.value - symbol("safety_margin"))
    bounds = input_rows(system)
    rows = [*bounds, (tuple(-(gain.T * sp.Matrix(slopes))), worst + room)]
    guard = Safeguard(
        normals={name: tuple(n[i] for n, _ in rows) for i, name in enumerate(system.input_names)},
        offsets=tuple(b for _, b in rows),
        hard=len(bounds),
        scales=input_scales(system, scales or {}),
        units=(over_time(lookup.unit, 1),),
        names=("value",),
    )
    return _guarded(system, law, lookup, guard, rate, margin)


def keep_sampled_value(
    system: System,
    law: L | None,
    lookup: SampledLookup,
    *,
    points: Sequence[Sequence[sp.Expr]],
    disturbances: Sequence[Sequence[sp.Expr]],
    errors: Sequence[Sequence[sp.Expr]] = ((),),
    beyond: float,
    rate: float,
    margin: float,
    scales: Mapping[str, float] | None = None,
    predicted: Prediction | None = None,
) -> L | Law:
    """`law` with the least change of its inputs after which W is high enough a sample later.

    None: `optimal_law`, by the slopes of W.

    With the value W of the sampled game, the margin c and the hold T

        W(q after the sample) >= c + (1 - rate T) (W(q) - c)   for each of the disturbances

    or, where no input that is found does it, >= c, or else the most. points: inputs that are tried;
    disturbances, errors: see `held_motion`. beyond: by how much W falls with each cell outside.
    predicted: of a law that sees the state late, where the input acts; q is that state, and the law
    reads what `Prediction.remembered` adds.

    Raises `DefinitionError` as `keep_value` does.
    """
    if not system.inputs:
        raise DefinitionError(f"system '{system.name}' has no inputs")
    hamiltonian(replace(system, samples=0))  # refuses rates that are not affine
    late = predicted.delay if predicted else 0.0
    motion = held_motion(system, sp.Float(lookup.hold), disturbances, errors, late)
    places: Mapping[sp.Symbol, sp.Expr] = predicted.places if predicted else {}
    lookup = replace(lookup.subs(places), predicted=late, sloped=law is None)
    floor = symbol("safety_margin")
    level = floor + (1 - symbol("safety_rate") * lookup.hold) * (lookup.value - floor)
    bounds = input_rows(system)
    guard = Safeguard(
        normals={name: tuple(n[i] for n, _ in bounds) for i, name in enumerate(system.input_names)},
        offsets=tuple(b for _, b in bounds),
        hard=len(bounds),
        scales=input_scales(system, scales or {}),
        units=(lookup.unit,),
        foresight=Foresight(
            tuple(e.xreplace(places) for e in motion.expressions),
            motion.moves,
            motion.curved,
            tuple(map(tuple, points)),
            level,
            least(level, floor),
            sp.Float(beyond),
        ),
    )
    memory = predicted.memory.quantities if predicted else ()
    wanted = optimal_law(system, lookup) if law is None else law
    return _guarded(system, wanted, lookup, guard, rate, margin, memory)


def _guarded(
    system: System,
    law: L,
    lookup: Lookup,
    guard: Safeguard,
    rate: float,
    margin: float,
    memory: Sequence[Quantity] = (),
) -> L:
    """`law`, or each of its modes, with a safeguard over the values of `lookup`."""
    parameters = (
        Parameter("safety_rate", "1/s", "how fast the value may fall", value=float(rate), above=0),
        Parameter("safety_margin", "1", "value to stay above", value=float(margin)),
    )

    def guarded(mode: Law) -> Law:
        check_fit(system, mode)
        if mode.lookup is not None and mode.lookup is not lookup:
            raise DefinitionError(f"law '{mode.name}' has a value function already")
        reads = {q.name: q for q in (*mode.reads, *system.states, *memory)}
        return replace(
            mode,
            name=f"{mode.name}, kept safe",
            reads=tuple(reads.values()),
            parameters=(*mode.parameters, *system.parameters, *parameters),
            signals={**mode.signals, "value": lookup.value},
            lookup=lookup,
            safeguard=guard,
        )

    if isinstance(law, Switching):
        changed = law.map_laws(guarded, f"{law.name}, kept safe")
        return cast(L, replace(changed, signals={**law.signals, "value": lookup.value}))
    return cast(L, guarded(law))


def _difference(function: sp.Expr, state: sp.Symbol, step: float) -> sp.Expr:
    """The central difference over one step, which also exists at a kink of the function."""
    half = sp.Float(step / 2)
    above, below = (function.xreplace({state: state + s * half}) for s in (1, -1))
    return (above - below) / sp.Float(step)


def against_the_worst(
    system: System,
    law: L,
    lookup: Lookup,
    margin: sp.Expr | None = None,
    steps: Sequence[float] = (),
    parameters: tuple[Parameter, ...] = (),
) -> tuple[System, L]:
    """The system and the law against the worst disturbance, chosen at every sample like the inputs.

    The disturbances become inputs; the law's own inputs are saturated by their bounds first. The
    disturbances lower the value along its gradient. If the parameter `adversary_aim` is 1, they
    lower `margin`, an expression of the states and `parameters`, by its differences over `steps`.
    """
    h = hamiltonian(system)
    if isinstance(law.lookup, SampledLookup):
        lookup = replace(law.lookup, sloped=True)
    slopes: Sequence[sp.Expr] = lookup.slopes[-len(system.states) :]
    if margin is not None:
        aimed = [
            _difference(margin, q.symbol, step)
            for q, step in zip(system.states, steps, strict=True)
        ]
        slopes = [
            select(ADVERSARY_AIM - sp.Rational(1, 2), a, b)
            for a, b in zip(aimed, slopes, strict=True)
        ]
        aim = Parameter(ADVERSARY_AIM.name, "1", "target of the disturbance", value=0.0)
        parameters = (*parameters, aim)
    worst = _at_costates(h, h.disturbances, slopes)
    open_system = replace(
        system,
        inputs=(*system.inputs, *system.disturbances),
        disturbances=(),
        input_bounds=None,
        disturbance_bounds=None,
        pfaffian=(),
    )

    def both(mode: Law) -> Law:
        outputs = dict(mode.outputs)
        guard = mode.safeguard
        if guard is None and system.input_bounds is not None:
            wanted = [outputs[n] for n in system.input_names]
            outputs = dict(
                zip(system.input_names, system.input_bounds.saturate(wanted), strict=True)
            )
        if guard is not None:
            zeros = (sp.S.Zero,) * len(guard.offsets)
            guard = replace(
                guard,
                normals={**guard.normals, **dict.fromkeys(system.disturbance_names, zeros)},
                scales={**guard.scales, **dict.fromkeys(system.disturbance_names, sp.S.One)},
                foresight=guard.foresight
                and guard.foresight.of(
                    system.input_names,
                    (*system.input_names, *system.disturbance_names),
                    sp.S.One,
                    dict.fromkeys((*system.input_names, *system.disturbance_names), sp.S.Zero),
                ),
            )
        reads = {q.name: q for q in (*mode.reads, *system.states)}
        return replace(
            mode,
            reads=tuple(q for q in reads.values() if q not in system.disturbances),
            outputs={**outputs, **worst},
            parameters=(*mode.parameters, *system.parameters, *parameters),
            lookup=lookup,
            safeguard=guard,
        )

    if isinstance(law, Switching):
        return open_system, cast(L, law.map_laws(both, f"{law.name}, against the worst"))
    return open_system, cast(L, both(law))
