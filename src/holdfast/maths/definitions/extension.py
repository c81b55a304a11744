"""Inputs that become states, and states that become inputs: extension, lags, and model reduction.

Dynamic extension makes inputs states, and constraints on them constraints of the state. An actuator
that acts late has a lag of first order, and a limit on how fast it changes. In a reduced model
states become inputs or disturbances (`promote`), or are left out; the bounds of a velocity that
becomes an input are those that the inputs can hold steadily.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from numbers import Real
from typing import Annotated

import sympy as sp

from holdfast.arguments import Unit, checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.bounds import Bounds, Box, product, section
from holdfast.maths.definitions.quantity import TIME, Parameter, Quantity, symbol
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import clip

LOOKED_AT = 64
"""Number of values tried below the first doubled value that cannot be held."""
LARGEST = 1e9
"""Beyond this a value counts as unbounded."""


@checked
def steady_bounds(system: System, states: tuple[str, ...]) -> Box:
    """The interval around 0 of every state in which the inputs can hold it, as a box.

    A value s of a state with the rate f + g . u is held while some u within the input bounds gives

        f(s) + g(s) . u = 0

    with all other states and the disturbances 0: still water. The interval ends at the first value
    that cannot be held. Each state is taken by itself, so that a corner of the box may be more than
    the inputs can hold together. In the unit of the state, at the values of the parameters.

    states: their names, one interval for each.

    Raises `DefinitionError` for an unknown state, inputs without bounds, a rate that depends on
    time or is not affine in the inputs, and a state that the inputs cannot hold at 0 or hold at
    any value.

    >>> hf.steady_bounds(hf.systems.marine_vehicle(), ("u",)).upper
    (1.21047117320802,)
    """
    for name in states:
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )
    if system.input_bounds is None:
        raise DefinitionError(
            f"system '{system.name}' has no bounds for its inputs",
            expected="bounds, for the velocities that they hold",
        )
    sides = [(-_furthest(system, n, -1.0), _furthest(system, n, 1.0)) for n in states]
    return Box(tuple(low for low, _ in sides), tuple(high for _, high in sides))


def _furthest(system: System, name: str, side: float) -> float:
    """The largest distance from 0, on one side, at which the state can be held."""
    holds = _holds(system, name)
    if not holds(0.0):
        raise DefinitionError(
            f"the inputs of system '{system.name}' cannot hold '{name}' at 0",
            remedy=f"give an interval: {name} = [lowest, highest]",
        )
    high = 1e-6
    while holds(side * high):
        high *= 2
        if high > LARGEST:
            raise DefinitionError(
                f"the inputs of system '{system.name}' hold every value of '{name}'",
                remedy=f"give an interval: {name} = [lowest, highest]",
            )
    low = 0.0
    for k in range(1, LOOKED_AT):  # a gap below the end is not stepped over
        if not holds(side * high * k / LOOKED_AT):
            high *= k / LOOKED_AT
            break
        low = high * k / LOOKED_AT
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if holds(side * middle) else (low, middle)
    return low


def _holds(system: System, name: str) -> Callable[[float], bool]:
    rate = sp.sympify(system.rates[name])
    inputs = [q.symbol for q in system.inputs]
    if rate.has(TIME):
        raise DefinitionError(
            f"the rate of '{name}' depends on time, so that no value is held steadily",
            remedy=f"give an interval: {name} = [lowest, highest]",
        )
    gains = [rate.diff(u) for u in inputs]
    if any(g.free_symbols & set(inputs) for g in gains):
        raise DefinitionError(
            f"the rate of '{name}' is not affine in the inputs", expected="f + g . u"
        )
    state = next(q.symbol for q in system.states if q.name == name)
    others = (*system.states, *system.disturbances)
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    numbers |= {q.symbol: sp.S.Zero for q in others if q.symbol != state}
    drift = rate.xreplace(dict.fromkeys(inputs, sp.S.Zero)).xreplace(numbers)
    drift, *gains = (e.xreplace(numbers) for e in (drift, *gains))
    assert system.input_bounds is not None
    bounds = system.input_bounds.at({q.symbol: q.value for q in system.parameters})

    @cache
    def reach(*gain: float) -> tuple[float, float]:
        """The least and the largest of g . u."""
        return -bounds.support_value([-g for g in gain]), bounds.support_value(gain)

    def holds(value: float) -> bool:
        here = {state: sp.Float(value)}
        f, *g = (float(e.xreplace(here)) for e in (drift, *gains))
        if not all(map(math.isfinite, (f, *g))):
            return False
        least, most = reach(*g)
        return least <= -f <= most

    return holds


@checked
def promote(
    system: System,
    states: tuple[str, ...],
    bounds: Bounds | None = None,
    *,
    disturbances: tuple[str, ...] = (),
    disturbance_bounds: Bounds | None = None,
) -> System:
    """The subsystem in which `states` are the inputs, and the former inputs are gone.

    states: those that become inputs. bounds: of the new inputs; None for none. disturbances: states
    that become disturbances, listed before the existing ones. disturbance_bounds: of these.
    `steady_bounds` gives the `bounds` that the former inputs can hold.

    The subsystem Sigma_1 of section 5.4.2 is promote(marine_vehicle, ("u", "r")); (7.4) of the
    thesis has the sway velocity "v" as a disturbance too.

    Raises `DefinitionError` for an unknown state, or when a remaining rate contains an old input.

    >>> hf.promote(cart, ("v",), hf.Box((-0.5,), (0.5,))).input_names
    ('v',)
    """
    promoted = (*states, *disturbances)
    _check_names(system, promoted)
    rates = {n: r for n, r in system.rates.items() if n not in promoted}
    old_inputs = {q.symbol for q in system.inputs}
    for name, rate in rates.items():
        if rate.free_symbols & old_inputs:
            raise DefinitionError(
                f"the rate of '{name}' depends on an input of system '{system.name}'",
                expected="only promoted states to be driven by the inputs",
                remedy=f"promote '{name}' too",
            )
    by_name = {q.name: q for q in system.states}
    name = f"{system.name}, {' and '.join(states)} as inputs"
    if disturbances:
        name += f", {' and '.join(disturbances)} as disturbance"
    felt = system.disturbance_bounds
    if disturbances:
        felt = product(disturbance_bounds, felt) if system.disturbances else disturbance_bounds
    return System(
        name=name,
        states=tuple(q for q in system.states if q.name not in promoted),
        inputs=tuple(by_name[n] for n in states),
        rates=rates,
        parameters=system.parameters,
        disturbances=(*(by_name[n] for n in disturbances), *system.disturbances),
        input_bounds=bounds,
        disturbance_bounds=felt,
        pfaffian=tuple(row for row in system.pfaffian if not set(row.coefficients) & set(promoted)),
        description=system.description,
        source=system.source,
        promoted=promoted,
        empirical=system.empirical,
    )


@checked
def subsystem(system: System, states: tuple[str, ...]) -> System:
    """The subsystem of these states, whose rates do not depend on the others.

    states: the names of those that stay.

    (7.5) of the thesis is the subsystem of ("u", "v", "r"). Disturbances that no remaining rate
    depends on are left out.

    Raises `DefinitionError` for an unknown state, and for a rate that depends on a state that is
    left out.

    >>> hf.subsystem(hf.systems.marine_vehicle(), ("u", "v", "r")).state_names
    ('u', 'v', 'r')
    """
    _check_names(system, states)
    rates = {n: r for n, r in system.rates.items() if n in states}
    others = {q.symbol for q in system.states if q.name not in states}
    for name, rate in rates.items():
        if outside := rate.free_symbols & others:
            raise DefinitionError(
                f"the rate of '{name}' depends on '{min(map(str, outside))}'",
                expected="states whose rates depend on no other",
            )
    used = set().union(*(r.free_symbols for r in rates.values()))
    felt = [q.symbol in used for q in system.disturbances]
    if not any(felt):
        bounds: Bounds | None = None
    else:
        felt = felt if _separable(system.disturbance_bounds, felt) else [True] * len(felt)
        bounds = section(system.disturbance_bounds, felt)
    return replace(
        system,
        name=f"{system.name}, {', '.join(states)} alone",
        states=tuple(q for q in system.states if q.name in states),
        rates=rates,
        disturbances=tuple(q for q, k in zip(system.disturbances, felt, strict=True) if k),
        disturbance_bounds=bounds,
        pfaffian=(),
    )


def _separable(bounds: Bounds | None, felt: list[bool]) -> bool:
    try:
        section(bounds, felt)
    except DefinitionError:
        return False
    return True


def _check_names(system: System, names: Iterable[str]) -> None:
    for name in names:
        if name not in system.state_names:
            raise DefinitionError(
                f"'{name}' is not a state of system '{system.name}'",
                remedy=suggestion(name, system.state_names),
            )


@checked
def dynamic_extension(
    system: System, inputs: tuple[str, ...], rates: Bounds | None = None
) -> System:
    """The system in which `inputs` are states, whose rates are inputs within `rates`.

        q' = f(q, u),   u' = u_rate

    With a velocity as input its rate is an acceleration, with a force it is how fast an actuator
    acts.

    inputs: their names. rates: the bounds of the new inputs, in the unit of the input per second;
    None for none.

    A region may then constrain u, and f too, such as an acceleration. The bounds that u had do not
    bound the new inputs: `input_limits` gives them as constraints of the state, which belong in the
    region.

    Raises `DefinitionError` for an unknown input, and where the others are not free of those that
    are extended.

    >>> hf.dynamic_extension(robot, ("v",), hf.Box((-1,), (1,))).state_names
    ('x', 'y', 'psi', 'v')
    """
    for name in inputs:
        if name not in system.input_names:
            raise DefinitionError(
                f"'{name}' is not an input of system '{system.name}'",
                remedy=suggestion(name, system.input_names),
            )
    by_name = {q.name: q for q in system.inputs}
    extended = tuple(by_name[name] for name in inputs)  # `rates` are in this order
    remaining = tuple(q for q in system.inputs if q.name not in inputs)
    new = tuple(
        Quantity(f"{q.name}_rate", per_second(q.unit), f"rate of {q.description or q.name}")
        for q in extended
    )
    left = (
        section(system.input_bounds, [q in remaining for q in system.inputs]) if remaining else None
    )
    return replace(
        system,
        name=f"{system.name}, {' and '.join(inputs)} as states",
        states=(*system.states, *extended),
        inputs=(*remaining, *new),
        rates={**system.rates, **{q.name: symbol(f"{q.name}_rate") for q in extended}},
        input_bounds=product(left or free_box(len(remaining)), rates or free_box(len(new)))
        if remaining
        else rates,
    )


@checked
def input_limits(system: System, inputs: tuple[str, ...] | None = None) -> Region:
    """The bounds of the inputs of a system as a region of its dynamic extension.

    inputs: those that are extended, by default all. Raises `DefinitionError` for inputs without
    bounds, and for a set that is not a polytope.

    >>> hf.input_limits(robot, ("v",)).inequality_names
    ('v_high', 'v_low')
    """
    names = system.input_names if inputs is None else inputs
    chosen = [q for q in system.inputs if q.name in names]
    bounds = section(system.input_bounds, [q in chosen for q in system.inputs])
    if bounds is None:
        raise DefinitionError(
            f"the inputs {', '.join(names)} of system '{system.name}' have no bounds",
            expected="bounds, to be constraints of the extended system",
        )
    inequalities = []
    for number, (normal, offset) in enumerate(bounds.half_spaces(), start=1):
        felt = [(n, q) for n, q in zip(normal, chosen, strict=True) if n != 0]
        name = f"limit_{number}"
        if len(felt) == 1:
            name = f"{felt[0][1].name}_{'high' if felt[0][0] > 0 else 'low'}"
        expression = sp.Add(*(n * q.symbol for n, q in felt)) - offset
        inequalities.append(Inequality(name, expression, felt[0][1].unit))
    return Region(
        name=f"limits of {' and '.join(names)}",
        reads=tuple(chosen),
        inequalities=tuple(inequalities),
        parameters=system.parameters,
        description="the bounds of inputs that are states",
        source="dynamic extension",
    )


@checked
def both(first: Region, second: Region) -> Region:
    """The states in both regions; the name and the text are those of the first.

    first, second: regions, whose inequalities have different names.

    >>> hf.both(track, slow).inequality_names
    ('end', 'fast')
    """
    reads = {q.name: q for q in (*first.reads, *second.reads)}
    return replace(
        first,
        reads=tuple(reads.values()),
        inequalities=(*first.inequalities, *second.inequalities),
        parameters=(*first.parameters, *second.parameters),
        scene=(*first.scene, *second.scene),
    )


@checked
def panning(system: System, rate: Annotated[float, Unit("rad/s")], *, name: str = "pan") -> System:
    """The system with a camera that pans: its direction is a state, the pan rate an input.

        pan' = pan_rate,   |pan_rate| <= rate

    rate: the fastest [rad/s]. name: of the state, an angle from the heading of the vehicle
    [rad], positive to its left; the input is NAME_rate. Two cameras have two names.

    A limit of the angle is a constraint: `pan_limit` of `targets_in_view`. Raises
    `DefinitionError` for a rate that is not above 0, and a name that the system has already.

    >>> hf.panning(robot, 1.0).input_names
    ('v', 'r', 'pan_rate')
    """
    if not 0 < rate < math.inf:
        raise DefinitionError(f"rate of '{name}' is {rate!r}", expected="a number of rad/s above 0")
    turned = Quantity(f"{name}_rate", "rad/s", f"rate of {name}")
    for new in (name, turned.name):
        if new in {q.name for q in (*system.states, *system.inputs, *system.parameters)}:
            raise DefinitionError(
                f"system '{system.name}' has a quantity '{new}' already",
                remedy="give the camera another name",
            )
    side = sp.Float(rate)
    before = system.input_bounds or free_box(len(system.inputs))
    camera = Box((-side,), (side,))
    return replace(
        system,
        name=f"{system.name}, camera that pans",
        states=(*system.states, Quantity(name, "rad", "angle of the camera", angle=True)),
        inputs=(*system.inputs, turned),
        rates={**system.rates, name: turned.symbol},
        input_bounds=product(before, camera) if system.inputs else camera,
    )


def free_box(count: int) -> Box:
    """No bounds, as a set: a product with it keeps those of the others."""
    return Box((-sp.oo,) * count, (sp.oo,) * count)


def per_second(unit: str) -> str:
    """m/s -> m/s^2, N -> N/s"""
    if unit.endswith("/s"):
        return f"{unit}^2"
    return "1/s" if unit == "1" else f"{unit}/s"


PREFIX = "actual_"
LAG, SLEW = "_lag", "_slew"
"""Endings of the parameters by which a system declares the lag and the slew of an actuator."""


@checked
def lagged(
    system: System,
    lag: Mapping[str, float] | None = None,
    slew: Mapping[str, float] | None = None,
) -> System:
    """`system` whose actuators act through a lag: what is asked for comes later, and not faster.

        qdot = f(q, a, d),   adot_i = (u_i - a_i) / T_i,   within [-R_i, R_i]

    lag: input, or actuator such as a thruster -> T_i [s], above 0; slew: the same -> R_i [its unit
    per second]. Without both, those that the system declares: parameters NAME_lag and NAME_slew.

    a_i is the state actual_NAME, 0 at the start unless given. The inputs keep their names and
    bounds, so that a law or a filter of `system` runs on the lagged system as it is; a law derived
    from the lagged system itself would know the lag.

    Of actuators, u_i is the share of actuator i in the inputs that the limited actuators produce
    (`LinearImage.allocate`), and M a drives the system. With more actuators than inputs that share
    is the least-squares one, so that at their limits only its sum is what they really give.

    Raises `DefinitionError` for unknown names, inputs and actuators together, and numbers that are
    not above 0.

    >>> hf.lagged(cart, {"a": 0.2}).rates["actual_a"]
    (a - actual_a)/lag_a
    """
    as_declared = lag is None
    if lag is None:
        if slew is not None:
            raise DefinitionError("slew without a lag", expected="both, or neither")
        lag, slew = declared(system, LAG), declared(system, SLEW)
        if not lag:
            raise DefinitionError(
                f"system '{system.name}' declares no lag", expected="{input or actuator: seconds}"
            )
    slew = {} if slew is None else slew
    units = actuator_units(system)
    members = _members(system, [*lag, *slew])
    for what, table in (("lag", lag), ("slew", slew)):
        for name, value in table.items():
            if isinstance(value, bool) or not (isinstance(value, Real) and 0 < value < math.inf):
                raise DefinitionError(f"{what} of '{name}' is {value!r}", expected="above 0")
    if not lag:
        raise DefinitionError("lag is empty", expected="{input: seconds}")
    if alone := [name for name in slew if name not in lag]:
        raise DefinitionError(f"slew of '{alone[0]}' without its lag", expected="both")
    constant = {n: symbol(n + LAG if as_declared else f"lag_{n}") for n in lag}
    fastest = {n: symbol(n + SLEW if as_declared else f"slew_{n}") for n in slew}
    parameters = [
        Parameter(f"lag_{n}", "s", f"time constant of {n}", value=float(v), above=0)
        for n, v in lag.items()
    ] + [
        Parameter(f"slew_{n}", per_second(units[n]), f"fastest {n}", value=float(v), above=0)
        for n, v in slew.items()
    ]
    asked = [q.symbol for q in system.inputs]
    acting = {n: symbol(PREFIX + n) for n in lag}
    if members == system.actuators:
        shares = dict(zip(members, system.allocated(asked), strict=True))
        produced = system.produced([acting.get(n, shares[n]) for n in members])
        actual = dict(zip(asked, produced, strict=True))
    else:
        shares = {n: symbol(n) for n in members}
        actual = {symbol(n): a for n, a in acting.items()}
    rates = {name: rate.xreplace(actual) for name, rate in system.rates.items()}
    for name in lag:
        change: sp.Expr = (shares[name] - acting[name]) / constant[name]
        if name in slew:
            change = clip(change, -fastest[name], fastest[name])
        rates[PREFIX + name] = change
    return replace(
        system,
        name=f"{system.name}, {' and '.join(lag)} late",
        states=(
            *system.states,
            *(Quantity(PREFIX + n, units[n], f"{n} that acts") for n in lag),
        ),
        rates=rates,
        parameters=system.parameters if as_declared else (*system.parameters, *parameters),
    )


def declared(system: System, ending: str) -> dict[str, float]:
    """Input or actuator -> the lag or the slew that the system declares for it."""
    values = {p.name: p.value for p in system.parameters}
    return {n: values[n + ending] for n in actuator_units(system) if n + ending in values}


def actuator_units(system: System) -> dict[str, str]:
    """Every input, and every actuator that produces them, with its unit."""
    unit = system.inputs[0].unit if system.inputs else "1"
    return {q.name: q.unit for q in system.inputs} | dict.fromkeys(system.actuators, unit)


def _members(system: System, names: Sequence[str]) -> tuple[str, ...]:
    """The inputs or the actuators, whichever the names are of."""
    for name in names:
        if name not in actuator_units(system):
            raise DefinitionError(
                f"'{name}' is not an input of system '{system.name}'",
                remedy=suggestion(str(name), actuator_units(system)),
            )
    of_actuators = [name in system.actuators for name in names]
    if any(of_actuators) and not all(of_actuators):
        raise DefinitionError(
            "lag of inputs and of the actuators that produce them", expected="one or the other"
        )
    return system.actuators if any(of_actuators) else system.input_names
