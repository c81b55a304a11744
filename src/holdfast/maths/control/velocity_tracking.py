"""Forces that track a law for velocities: feedback linearisation and backstepping.

The command of another controller is such a law too. A law has a value for a disturbance where it
measures it or believes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import overload

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import TIME, Parameter, Quantity
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.random_points import full_rank
from holdfast.maths.expressions.traversal import derivatives, exchanged


@checked
def commanded(system: System, outputs: Sequence[str] | None = None) -> Law:
    """The law that hands on what another controller commands: output_i = command_i.

    outputs: names of inputs of the system, by default all of them; or of states that its inputs are
    to track (`track_velocity`). Whoever runs the law hands it `command_NAME` at every sample.

    Raises `DefinitionError` for an unknown name.

    >>> hf.commanded(cart).handed
    (Quantity(name='command_a', unit='m/s^2', description='commanded a', angle=False, role=''),)
    """
    by_name = {q.name: q for q in (*system.states, *system.inputs)}
    names = system.input_names if outputs is None else tuple(outputs)
    for name in names:
        if name not in by_name:
            raise DefinitionError(
                f"'{name}' is neither an input nor a state of system '{system.name}'",
                remedy=suggestion(name, by_name),
            )
    handed = {n: Quantity(f"command_{n}", by_name[n].unit, f"commanded {n}") for n in names}
    return Law(
        "command of another controller", (), {n: h.symbol for n, h in handed.items()},
        handed=tuple(handed.values()),
    )  # fmt: skip


def believed_disturbances(system: System, law: Law) -> dict[sp.Symbol, sp.Expr]:
    """The value that the law uses for each disturbance: measured or believed, else zero."""
    for name in law.believed:
        if name not in system.disturbance_names:
            raise DefinitionError(
                f"law '{law.name}' has a value for '{name}', which is not a disturbance",
                remedy=suggestion(name, system.disturbance_names),
            )
    read = {q.name: q.symbol for q in law.reads}
    return {
        d.symbol: law.believed.get(d.name, read.get(d.name, sp.S.Zero)) for d in system.disturbances
    }


@overload
def track_velocity(system: System, law: Law, gains: Mapping[str, float]) -> Law: ...
@overload
def track_velocity(system: System, law: Switching, gains: Mapping[str, float]) -> Switching: ...
@overload
def track_velocity(
    system: System, law: Law | Switching, gains: Mapping[str, float]
) -> Law | Switching: ...
@checked
def track_velocity(
    system: System, law: Law | Switching, gains: Mapping[str, float]
) -> Law | Switching:
    """The inputs that make velocities w of `system` follow the outputs gamma of `law`.

        wdot = -k (w - gamma) + d/dt gamma          (5.21), (5.22)

    gains: each velocity (a state that `law` outputs) -> its k > 0 [1/s].

    The inputs are solved from the system's own rates, and d/dt gamma is derived along them, with
    the disturbances that the law believes in. Where one gamma depends on another tracked velocity
    w', the rate that w' is given takes the place of dw'/dt. A `Switching` is treated mode by mode.
    With more inputs than velocities, each input has its share by least squares.

    Raises `DefinitionError` when the law's outputs are not states, there are more of them than
    inputs, the inputs cannot be solved for, or d/dt gamma would need the answer:
    gamma depends on an input-driven state that is not tracked, or on itself in a circle; or if
    d/dt gamma is unknown: gamma varies with the law's lookup table (bang-bang velocities do so
    only where they switch).

    >>> boat = hf.systems.marine_vehicle()
    >>> law = hf.track_velocity(boat, hf.laws.steer_marine(boat), {"u": 5.0, "r": 9.0})
    >>> sorted(law.outputs)
    ['tau_r', 'tau_u']
    """
    if isinstance(law, Switching):
        return law.map_laws(
            lambda mode: track_velocity(system, mode, gains), f"{law.name}, velocities tracked"
        )
    if law.safeguard is not None:
        raise DefinitionError(
            f"law '{law.name}' has a safeguard on its velocities",
            remedy="track the velocities first, then safeguard the inputs",
        )
    velocities = law.output_names
    for name, gamma in law.outputs.items():
        if law.lookup is not None and any(gamma.diff(s) != 0 for s in law.lookup.symbols):
            raise DefinitionError(
                f"output '{name}' of law '{law.name}' varies with its lookup table, whose rate is "
                "not known",
                expected="velocities constant between switches, as the optimal ones of a box",
            )
    for name in velocities:
        if name not in system.state_names:
            raise DefinitionError(
                f"law '{law.name}' gives '{name}', which is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    if set(gains) != set(velocities):
        odd = sorted(set(gains) ^ set(velocities))[0]
        raise DefinitionError(
            f"gain for '{odd}' is " + ("missing" if odd in velocities else "not needed"),
            expected="one gain for each of " + ", ".join(velocities),
        )
    for name, value in gains.items():
        if not value > 0:
            raise DefinitionError(f"gain of '{name}' is {value}", expected="> 0")
    if len(velocities) > len(system.inputs):
        raise DefinitionError(
            f"law '{law.name}' gives {len(velocities)} velocities, system '{system.name}' has "
            f"{len(system.inputs)} inputs",
            expected="at most as many velocities as inputs",
        )
    tracking = tuple(
        Parameter(f"k_{n}", "1/s", f"tracking gain of {n}", value=float(gains[n]))
        for n in velocities
    )
    rates = _believed_rates(system, law)
    inputs = [q.symbol for q in system.inputs]
    zero = dict.fromkeys(inputs, sp.S.Zero)
    effect = sp.Matrix([[rates[n].diff(u) for u in inputs] for n in velocities])
    if effect.free_symbols & set(inputs) or not _regular(effect):
        raise DefinitionError(
            f"the inputs of system '{system.name}' cannot be solved for the rates of "
            + ", ".join(velocities),
            expected="rates affine in the inputs with a regular matrix",
        )
    wanted = _wanted_rates(
        system, law, {n: g.symbol for n, g in zip(velocities, tracking, strict=True)}
    )
    driven = [wanted[n] - rates[n].xreplace(zero) for n in velocities]
    inverse = effect.inv() if effect.is_square else _least_squares(effect)
    solved = [
        sp.Add(*(a * b for a, b in zip(inverse.row(i), driven, strict=True) if a != 0))
        for i in range(inverse.rows)
    ]
    return Law(
        name=f"{law.name}, velocities tracked",
        reads=(*system.states, *(d for d in system.disturbances if d in law.reads)),
        outputs=dict(zip(system.input_names, solved, strict=True)),
        parameters=(*law.parameters, *tracking, *system.parameters),
        signals=law.signals,
        conditions=law.conditions,
        lookup=law.lookup,
        handed=law.handed,
        description=law.description,
        source="; ".join(filter(None, (law.source, "thesis (5.21), (5.22)"))),
        empirical=law.empirical or system.empirical,
    )


def _regular(effect: sp.Matrix) -> bool:
    """Whether some inputs give any rates of the velocities."""
    return bool(effect.det() != 0) if effect.is_square else full_rank(sp.ImmutableMatrix(effect))


def _least_squares(effect: sp.Matrix) -> sp.Matrix:
    """E^T (E E^T)^-1, without SymPy's expansion of the entries."""
    square = effect * effect.T
    entries = sp.Matrix(*square.shape, lambda i, k: sp.Dummy(f"e{min(i, k)}{max(i, k)}"))
    values = dict(zip(entries, square, strict=True))
    inverse = (entries.adjugate() / entries.det()).xreplace(values)
    return sp.Matrix(effect.T * inverse)


def _believed_rates(system: System, law: Law) -> dict[str, sp.Expr]:
    """The rates with the disturbances that the law reads or believes in, the others zero."""
    still = believed_disturbances(system, law)
    return dict(zip(system.rates, exchanged(system.rates.values(), still), strict=True))


def _wanted_rates(system: System, law: Law, gains: Mapping[str, sp.Symbol]) -> dict[str, sp.Expr]:
    """wdot = -k (w - gamma) + d/dt gamma of each tracked velocity, in terms of the states."""
    rates = _believed_rates(system, law)
    inputs = {q.symbol for q in system.inputs}
    wanted: dict[str, sp.Expr] = {}
    under_way: list[str] = []

    def rate(name: str, output: str) -> sp.Expr:
        if name in gains:
            if name in under_way:
                raise DefinitionError(
                    f"outputs of law '{law.name}' depend on each other in a circle: "
                    + " -> ".join([*under_way, name]),
                    expected="velocities that depend on slower states, or on one another in order",
                )
            return track(name)
        if rates[name].free_symbols & inputs:
            raise DefinitionError(
                f"output '{output}' of law '{law.name}' depends on '{name}', which the "
                "inputs drive directly",
                expected="velocities that depend on slower states only",
            )
        return rates[name]

    def track(name: str) -> sp.Expr:
        if name not in wanted:
            under_way.append(name)
            gamma = law.outputs[name]
            slopes = derivatives(gamma, [*(q.symbol for q in system.states), TIME])
            moving = [(q.name, slopes[q.symbol]) for q in system.states]
            feedforward = slopes[TIME] + sp.Add(
                *(slope * rate(q, name) for q, slope in moving if slope != 0)
            )
            error = system.states[system.state_names.index(name)].symbol - gamma
            wanted[name] = -gains[name] * error + feedforward
            under_way.pop()
        return wanted[name]

    return {name: track(name) for name in gains}
