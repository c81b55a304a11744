"""From a law for velocities to a law for forces: feedback linearisation and backstepping."""

from __future__ import annotations

from collections.abc import Mapping
from typing import overload

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.law import Law
from holdfast.maths.quantity import TIME, Parameter, merge_parameters
from holdfast.maths.switching import Switching
from holdfast.maths.system import System


@overload
def track_velocity(system: System, law: Law, gains: Mapping[str, float]) -> Law: ...
@overload
def track_velocity(system: System, law: Switching, gains: Mapping[str, float]) -> Switching: ...
@overload
def track_velocity(
    system: System, law: Law | Switching, gains: Mapping[str, float]
) -> Law | Switching: ...
def track_velocity(
    system: System, law: Law | Switching, gains: Mapping[str, float]
) -> Law | Switching:
    """The inputs that make velocities w of `system` follow the outputs gamma of `law`.

        wdot = -k (w - gamma) + d/dt gamma          (5.21), (5.22)

    `gains` maps each velocity (a state that `law` outputs) to its k > 0 in 1/s. The inputs
    are solved from the system's own rates, and d/dt gamma is derived along them, with every
    disturbance taken as zero: the law does not know it. A `Switching` is treated mode by mode.

    Raises `DefinitionError` when the law's outputs are not states, their number differs from
    that of the inputs, the inputs cannot be solved for, or gamma itself depends on a state
    that the inputs drive directly (then d/dt gamma would need the answer).
    """
    if isinstance(law, Switching):
        return law.map_laws(
            lambda mode: track_velocity(system, mode, gains), f"{law.name}, velocities tracked"
        )
    velocities = law.output_names
    for name in velocities:
        if name not in system.state_names:
            raise DefinitionError(
                f"law '{law.name}' gives '{name}', which is no state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    if set(gains) != set(velocities):
        odd = sorted(set(gains) ^ set(velocities))[0]
        raise DefinitionError(
            f"gain for '{odd}' is " + ("missing" if odd in velocities else "not wanted"),
            expected="one gain for each of " + ", ".join(velocities),
        )
    for name, value in gains.items():
        if not value > 0:
            raise DefinitionError(f"gain of '{name}' is {value}", expected="> 0")
    if len(velocities) != len(system.inputs):
        raise DefinitionError(
            f"law '{law.name}' gives {len(velocities)} velocities, system '{system.name}' has "
            f"{len(system.inputs)} inputs",
            expected="as many velocities as inputs",
        )
    tracking = tuple(
        Parameter(f"k_{n}", "1/s", f"tracking gain of {n}", value=float(gains[n]))
        for n in velocities
    )
    rates = system.undisturbed_rates
    inputs = [q.symbol for q in system.inputs]
    zero = dict.fromkeys(inputs, 0)
    effect = sp.Matrix([[rates[n].diff(u) for u in inputs] for n in velocities])
    if effect.free_symbols & set(inputs) or effect.det() == 0:
        raise DefinitionError(
            f"the inputs of system '{system.name}' cannot be solved for the rates of "
            + ", ".join(velocities),
            expected="rates affine in the inputs with a regular matrix",
        )
    wanted = []
    for name, gain in zip(velocities, tracking, strict=True):
        gamma = law.outputs[name]
        feedforward = gamma.diff(TIME)
        for state in system.states:
            slope = gamma.diff(state.symbol)
            if slope == 0:
                continue
            if rates[state.name].free_symbols & set(inputs):
                raise DefinitionError(
                    f"output '{name}' of law '{law.name}' depends on '{state.name}', which the "
                    "inputs drive directly",
                    expected="velocities that depend on slower states only",
                )
            feedforward += slope * rates[state.name]
        error = system.states[system.state_names.index(name)].symbol - gamma
        wanted.append(-gain.symbol * error + feedforward - rates[name].subs(zero))
    solved = effect.inv() * sp.Matrix(wanted)
    return Law(
        name=f"{law.name}, velocities tracked",
        reads=system.states,
        outputs=dict(zip(system.input_names, solved, strict=True)),
        parameters=merge_parameters(law.parameters, tracking, system.parameters),
        signals=law.signals,
        conditions=law.conditions,
        description=law.description,
        source="; ".join(filter(None, (law.source, "thesis (5.21), (5.22)"))),
    )
