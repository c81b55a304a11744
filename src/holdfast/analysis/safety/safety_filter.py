"""Safety filters and optimal laws from value functions, to simulate, or over a plane of states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from holdfast.analysis.reachability.grid import number
from holdfast.analysis.reachability.problem import is_defined_so, with_disturbance
from holdfast.analysis.reachability.stored_values import Layers
from holdfast.analysis.reachability.value_function import (
    Places,
    ValueFunction,
    steeper_than_its_start,
)
from holdfast.analysis.safety.depth import highest_within
from holdfast.analysis.safety.sampled_value import (
    LEVELS,
    moves_of,
    on_its_grid,
    patience_of,
    points_of,
    sampled_value,
)
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.maths.control.prediction import Prediction, prediction
from holdfast.maths.control.value_filter import (
    against_the_worst,
    keep_sampled_value,
    keep_value,
    optimal_law,
    soonest_law,
)
from holdfast.maths.definitions.law import Law, Lookup
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.maths.games.hamiltonian import hamiltonian

L = TypeVar("L", bound=Law | Switching)

FORMER = "backward-reachable-set"  # what files of former releases call the tube
REACHED = ("capture-basin", "backward-reachable-tube", FORMER)
"""Problems in which the state has to arrive within the time, not to stay."""
LAWFUL = ("viability-kernel", "discriminating-kernel", *REACHED)
"""Problems in which the inputs maximise the value against the disturbances."""

PACE = 2.0
"""The rate of a safety filter [1/s] where none is given and the hold bears it."""

ROUNDING = 1e-9  # of a rate that is exactly the fastest

NEVER = 2.0
"""Horizons after which a state that just does not arrive is said to arrive."""

MANY = 100_000  # nodes near the boundary that a margin is computed from


@checked
def safety_law(
    system: System,
    value: ValueFunction,
    law: L | None = None,
    *,
    rate: float | None = None,
    margin: float | None = None,
    sample_time: float = 0.02,
    delay: float = 0.0,
    scales: Mapping[str, float] | None = None,
    errors: Sequence[float] = (),
    ahead: bool | float = True,
) -> L | Law | Switching:
    """The law that keeps the state in the set V > 0: optimal inputs, or a safety filter.

    Without `law` the optimal inputs, bang-bang within a box: max_u p . f with p = dV/dq (thesis
    (7.3), (7.7)). At a ridge of V these leave a kernel: where the game below is solved, and trial
    runs stay, a safety filter changes them as little as it would change a `law`, and p is the slope
    of W, or of V where W is cut off. It is for `sample_time` alone then; `ahead` false leaves it
    out. The law that arrives soonest in a capture basin is `least_time_law`. The filter is the
    least change of inputs in `scales` that satisfies

        W(q after the sample) >= margin + (1 - rate sample_time) (W(q) - margin)

    for every held disturbance; W is the value of the sampled game (`sampled_value`), whose inputs
    are held for `sample_time`. It does nothing well inside the set and intervenes towards the
    boundary. rate [1/s]: by default `PACE`, or less for a longer hold. margin [unit of V]: by
    default `SampledValue.least`.

    With a `delay` of the measurement [s] q is where the state is predicted to be when the input
    acts, from the inputs that were sent since: the law remembers them, and is a `Switching`. Where
    too many are on their way for that, the margin is `sampled_margin`, the most that V can fall
    before the input responds, which holds from input to input. If no input is found that suffices,
    it is the best one, and runs count it. errors: by how much the input that acts may differ from
    the held one, for each input. ahead: the seconds that each game which is tried may take, about;
    True for 5. A kernel in six states needs minutes.

    Without such a game (where it is `None`, and with `ahead` false, for a law that is to be
    certified) the condition is

        p . f(q, u, d) + rate (V - margin) >= 0   for every disturbance d

    with `sampled_margin` by default.

    law: under the filter; None for the optimal inputs. delay [s]: how old a measurement is. scales:
    input -> the change of it that counts as 1.

    A value function with several times is used at the remaining time and is constant below the
    first; a converged kernel at the last.

    Raises `SimulationError` for a value function of another system, or of a problem in which the
    inputs do not maximise; for an empty set; for a margin below 0; for a rate too fast for the hold
    time, and for the delay where it is not predicted; for a default margin that no state has, or
    trial runs do not bear; for a delay without a `law`; and for a `law` that has to arrive by a
    value function that does not reach down to time 0.

    >>> keep = hf.safety_law(cart, kernel, brake)
    >>> hf.simulate(cart, keep, starts=[[0.9, 0.3]], region=track, horizon=4.0)
    <Result of 1 runs: 1 stayed>
    """
    made, predicted, _ = kept_law(
        system, value, law, rate=rate, margin=margin, sample_time=sample_time, delay=delay,
        scales=scales, errors=errors, ahead=ahead,
    )  # fmt: skip
    return predicted.remembered(made) if predicted else made


@checked
def least_time_law(system: System, value: ValueFunction, *, sample_time: float = 0.02) -> Law:
    """The law that arrives in the least time T of a capture basin: minimum-time feedback.

    It takes the inputs after which T has fallen by the hold, or else those after which it is least:

        T(q after the sample) <= T(q) - sample_time   for every held disturbance

    T is compared where inputs lead, since it jumps: beside a path that just misses the goal its
    slopes mean nothing. Where a path comes within a cell of a jump, or grazes the goal, the state
    may be on the other side of it and arrive later. Outside the basin it raises V.

    value: a capture basin with times of arrival (`ValueFunction.least_time`). sample_time [s]: for
    how long inputs are held, of the run too.

    Raises `SimulationError` for a value function without times of arrival, of another system, or of
    an empty set, for a system without bounded inputs, and for rates that are not affine in them.

    >>> goal = hf.Region("middle", cart.states, (hf.Inequality("near", abs(x) - 0.2, "m"),))
    >>> basin = hf.capture_basin(cart, goal, track, nodes, 4.0)
    >>> soonest = hf.least_time_law(cart, basin)
    >>> hf.simulate(cart, soonest, starts=[[0.8, 0.0]], goal=goal, horizon=4.0, until_goal=True)
    <Result of 1 runs: 1 reached goal>
    """
    model = decided(system, value)
    value.check_times()
    check_not_empty(value)
    number("sample_time is ", sample_time, "seconds, above 0", lambda v: 0 < v < math.inf)
    if not model.inputs or model.input_bounds is None or model.samples:
        raise SimulationError(
            f"the inputs of system '{model.name}' are not bounded, or act otherwise than affinely",
            expected="bounded inputs, in which the rates are affine",
        )
    horizon = value.report.horizon_s
    last = value.last().in_memory()
    arrival = np.ascontiguousarray(last.dataset["arrival"].values).ravel()
    below = np.fmin(last.values().ravel(), 0.0)
    never = horizon * (NEVER + below / min(float(below.min()), -ROUNDING))
    table = np.where(np.isfinite(arrival), -arrival, -never).astype(arrival.dtype)
    return soonest_law(
        model,
        on_its_grid(table, lookup_of(last), sample_time, unit="s", sloped=True),
        points=points_of(model.input_bounds, len(model.inputs)),
        disturbances=moves_of(model.disturbance_bounds, len(model.disturbances)),
        latest=float(never.max()),
    )


class Kept(NamedTuple):
    """A law that keeps a kernel; the prediction whose memory it reads; and whether trial runs of
    its game stay, where one was solved and the margin is its own."""

    law: Any
    predicted: Prediction | None = None
    stays: bool = True


def kept_law(
    system: System,
    value: ValueFunction,
    law: L | None,
    *,
    rate: float | None = None,
    margin: float | None = None,
    sample_time: float = 0.02,
    delay: float = 0.0,
    scales: Mapping[str, float] | None = None,
    errors: Sequence[float] = (),
    ahead: bool | float = True,
    predicts: bool = True,
) -> Kept:
    """As `safety_law`. predicts: whether the law may predict the state over a delay."""
    patience = patience_of(ahead)
    _check_delay(delay)
    model = decided(system, value)
    check_not_empty(value)
    lookup = lookup_of(value)
    number("sample_time is ", sample_time, "seconds, above 0", lambda v: 0 < v < math.inf)
    if law is None and delay:
        raise SimulationError(
            f"the optimal inputs without a law have no margin for a delay of {delay:g} s",
            remedy="give a law: its safety filter has a margin",
        )
    kind = value.report.kind
    looks_ahead = patience and not lookup.timed and not (law is None and kind in REACHED)
    predicted = None
    if looks_ahead and delay and predicts:
        predicted = prediction(model, sample_time, delay)
    pace = _pace(rate, sample_time, 0.0 if predicted else delay)
    if margin is not None:
        number("margin is ", margin, "0 or more: below 0 is outside", lambda v: 0 <= v < math.inf)
    ends_unknown = len(lookup.places) == len(system.states) or lookup.first_time > 0
    if law is not None and kind in REACHED and ends_unknown:
        raise SimulationError(
            f"a law that is kept in a {kind} whose value is not known down to the end need not "
            "arrive",
            expected="values at equally spaced times from 0 to the horizon",
            remedy="compute it with times=[0, ...], or take the optimal inputs alone",
        )
    game, late, little = None, 0.0, LEVELS[0] * (value.report.cell or 1.0)
    deep = max(margin - little, 0.0) if margin is not None else 0.0
    if predicted:
        game = sampled_value(model, value, sample_time, errors, deep, 0.0, patience, delay)
        if margin is None and game is not None and not game.stays:
            raise SimulationError(
                f"inputs that are held for {sample_time:g} s, from what is {delay:g} s old, "
                "lose trial runs from everywhere that they should keep",
                remedy="take a shorter sample time or delay, a finer grid, or give a margin",
            )
    if game is None and looks_ahead:
        predicted, pace = None, _pace(rate, sample_time, delay)
        late = sampled_margin(system, value, sample_time, delay) if delay else 0.0
        above = late if margin is None else deep
        game = sampled_value(model, value, sample_time, errors, above, late, patience)
    if law is None and game is not None and not game.stays and margin is None:
        game = None
    if law is None and game is None:
        if margin is not None:
            raise SimulationError(
                "the optimal inputs have no margin where no sampled game is solved",
                remedy="give a law, or leave the margin out",
            )
        return Kept(optimal_law(model, lookup))
    if game is not None:
        stays = game.stays or margin is not None
        if margin is None:
            margin = game.possible_margin(sample_time, delay)
        filtered = keep_sampled_value(
            model,
            law,
            (game if law else game.leaning(value)).lookup(lookup, sample_time),
            points=game.points,
            disturbances=game.moves,
            errors=game.errors,
            beyond=game.beyond,
            rate=pace,
            margin=margin,
            scales=scales,
            predicted=predicted,
        )
        return Kept(filtered, predicted, stays)
    assert law is not None  # else the optimal inputs are the answer
    if margin is None:
        margin = possible_margin(system, value, sample_time, delay, late or None)
    return Kept(keep_value(model, law, lookup, rate=pace, margin=margin, scales=scales))


def check_not_empty(value: ValueFunction) -> None:
    """Raises `SimulationError` for an empty set."""
    report = value.report
    if not value.highest() > 0:
        raise SimulationError(
            f"the {report.kind} of '{report.region}' is empty after {report.reached_s:.3g} s: "
            "no law keeps any state",
            remedy="shorten the horizon, or allow larger inputs or smaller disturbances",
        )


def _pace(rate: float | None, sample_time: float, unpredicted_delay: float) -> float:
    """A rate that is not too fast, or the usual one: a state that is predicted needs no slower."""
    if rate is None:
        return usual_pace(sample_time, unpredicted_delay)
    check_pace(rate, sample_time, unpredicted_delay)
    return rate


def usual_pace(sample_time: float, delay: float = 0.0) -> float:
    """`PACE`, or the fastest that the sample time and the delay bear."""
    return min(PACE, 1.0 / (sample_time + delay))


def check_pace(rate: float, sample_time: float, delay: float = 0.0) -> None:
    """Raises `SimulationError` for a rate too fast for the sample time and the delay."""
    if not 0 < rate * (sample_time + delay) <= 1 + ROUNDING:
        raise SimulationError(
            f"rate {rate:g} 1/s with a sample time of {sample_time:g} s{_and_late(delay)}",
            expected=f"above 0, at most 1 / {'(sample_time + delay)' if delay else 'sample_time'}",
        )


def _check_delay(delay: float) -> None:
    number("delay is ", delay, "a number of seconds, 0 or more", lambda v: 0 <= v < math.inf)


def _and_late(delay: float) -> str:
    return f" and a delay of {delay:g} s" if delay else ""


@checked
def sampled_margin(
    system: System, value: ValueFunction, sample_time: float, delay: float = 0.0
) -> float:
    """The most that V can fall before the input responds to a measurement.

    With a measurement that is `delay` old and an input held for `sample_time` [s]

        delay max(-min_u min_d p . f) + sample_time max(-min_u min_d p . f + dV/dtau)

    where tau is the remaining time, if a law looks the value up at it (dV/dtau is the difference
    between neighbouring times); otherwise the term is absent.

    sample_time [s]: of the hold. delay [s]: how old a measurement is.

    The maxima are over the nodes at which V is at most two cells, or that margin, from the
    boundary, or `MANY` of them. A state measured with V above the margin has V > 0 until the next
    input, for any input and disturbance. Where V jumps, it is the largest V from which the boundary
    may be reached in the time.

    Raises `SimulationError` for an invalid sample time or delay.

    >>> round(hf.sampled_margin(cart, kernel, 0.02), 3)
    0.064
    """
    positive = "a positive number of seconds"
    number("sample_time is ", sample_time, positive, lambda v: 0 < v < math.inf)
    _check_delay(delay)
    falls, reach = _Falls(system, value), 2.0 * value.report.cell
    if falls.jump:
        return highest_within(value, (delay + sample_time) * falls.speeds())
    while True:
        still, moving = falls.most(reach)
        margin = delay * still + sample_time * moving
        if margin <= reach:
            return margin
        reach = margin  # from this depth a state may fall to the boundary


def possible_margin(
    system: System,
    value: ValueFunction,
    sample_time: float,
    delay: float,
    margin: float | None = None,
) -> float:
    """`sampled_margin`, or `margin` if it is at hand; `SimulationError` where no state has it."""
    if margin is None:
        margin = sampled_margin(system, value, sample_time, delay)
    if not margin < (deepest := value.highest()):
        raise SimulationError(
            f"V may fall by {margin:.3g} before an input answers, held for {sample_time:g} s"
            f"{_and_late(delay)}, and is nowhere above {deepest:.3g}",
            remedy="take a shorter sample time or delay, or give a margin",
        )
    return margin


def worst_disturbance(
    system: System, value: ValueFunction, law: L, aimed_at: Region | None = None
) -> tuple[System, L]:
    """System and law with the disturbance that lowers V most, held like the inputs.

    aimed_at: a region whose margin it lowers if the parameter `adversary_aim` is 1.
    """
    margin = None if aimed_at is None else aimed_at.margin
    steps = [a.step for a in value.grid.axes]
    parameters = () if aimed_at is None else aimed_at.parameters
    model = decided(system, value)
    return against_the_worst(model, law, lookup_of(value), margin, steps, parameters)


def lookup_of(value: ValueFunction) -> Lookup:
    """The value function as a lookup table for a law."""
    axes = value.grid.axes
    places = [a.state.symbol for a in axes]
    low, steps = [a.low for a in axes], [a.step for a in axes]
    counts, periodic = [a.count for a in axes], [a.ends == "periodic" for a in axes]
    times, first = _times(value), 0.0
    if times is not None:
        gaps = np.diff(times)
        if not np.allclose(gaps, gaps[0], rtol=1e-6):
            raise SimulationError(
                "the times of the value function are not equally spaced",
                remedy="compute it at equally spaced times, or at the last only",
            )
        first = float(times[0])
        places.insert(0, float(times[-1]) - TIME)
        low.insert(0, float(times[0]))
        steps.insert(0, float(gaps[0]))
        counts.insert(0, len(times))
        periodic.insert(0, False)
    table = (
        value.law_table(all_times=times is not None),
        np.array(low),
        np.array(steps),
        np.array(counts, dtype=np.int64),
        np.array(periodic),
    )
    unit = value.report.value_unit
    return Lookup(tuple(places), table, first, timed=times is not None, unit=unit)


def _times(value: ValueFunction) -> Array | None:
    """The remaining times at which a law looks the value up; None if it always uses the last.

    It does so if the value function has one time only, and for a converged kernel.
    """
    data, report = value.dataset["value"], value.report
    if "time" not in data.dims or data.sizes["time"] == 1:
        return None
    if report.converged and report.kind not in REACHED:
        return None
    times: Array = data["time"].values
    return times


def decided(system: System, value: ValueFunction) -> System:
    """The system of the value function's problem, with its prescribed disturbances."""
    report = value.report
    if report.kind not in LAWFUL:
        raise SimulationError(
            f"a value function of the kind '{report.kind}'",
            expected="one of " + ", ".join(LAWFUL),
        )
    if report.disturbances == "max":
        raise SimulationError(
            "the value assumes helpful disturbances, on which a law cannot rely",
            remedy='compute it with disturbances="min"',
        )
    if value.names != system.state_names or report.system != system.name:
        raise SimulationError(
            f"the value function belongs to system '{report.system}' with the states "
            + ", ".join(value.names),
            expected=f"system '{system.name}' with " + ", ".join(system.state_names),
        )
    if report.depends_on_time:
        raise SimulationError(
            "the value function depends on time, and is valid at the start of its problem only",
            expected="a time-invariant problem, for a law",
        )
    numbers = report.parameters
    for q in system.parameters:
        if q.name in numbers and float(q.value) != numbers[q.name]:
            raise SimulationError(
                f"the value function was computed with {q.name} = {numbers[q.name]:g}, the system "
                f"has {q.value:g}",
                remedy="compute it again; to simulate another vehicle under this law, use plant",
            )
    if report.definition and not is_defined_so(system, report.definition):
        raise SimulationError(
            f"the rates or the bounds of system '{system.name}' are not those that the value "
            "function was computed with",
            remedy="compute it again; to simulate another vehicle under this law, use plant",
        )
    model = with_disturbance(system, report.disturbance)
    return replace(model, samples=report.samples)


class _Falls:
    """The largest fall rate of V near the boundary, for any inputs and disturbance."""

    def __init__(self, system: System, value: ValueFunction) -> None:
        model = decided(system, value)
        h = hamiltonian(model, inputs="min", disturbances="min")
        states = [q.symbol for q in model.states]
        self.value = value
        self.rise = Evaluator([h.value], [*states, *h.costates], model.parameters)
        self.parameters = parameters_of(value, model)
        times = _times(value)
        known_at: list[float | None] = [None] if times is None else [float(t) for t in times]
        self.jump = value.stored is None and times is None and steeper_than_its_start(value)
        self.spans = list(pairwise(known_at))
        if known_at[0] != 0.0:  # below the first time V is constant
            self.spans.insert(0, (known_at[0], known_at[0]))

    def speeds(self) -> Array:
        """The largest speed along every axis in the set, for any inputs and disturbance."""
        axes, layers = self.value.grid.axes, self.value.layers(None)
        within = _near(layers, layers, math.inf)
        points = np.stack([a.nodes[k] for a, k in zip(axes, within, strict=True)], axis=1)
        largest = []
        for way in np.eye(len(axes)):
            rows = [np.hstack([points, np.tile(s * way, (len(points), 1))]) for s in (1.0, -1.0)]
            largest.append(-min(self.rise.values(q, self.parameters)[:, 0].min() for q in rows))
        return np.array(largest)

    def most(self, reach: float) -> tuple[float, float]:
        """The largest fall of V [1/s] where 0 < V <= reach: at one time, and as time runs down.

        At least 0. Between two times V is linear, so that its falls are at most those at the two.
        """
        still = moving = 0.0
        for before, after in self.spans:
            low, high = (self.value.layers(t) for t in (before, after))
            places = _near(low, high, reach)
            if not len(places[0]):
                continue
            points = np.stack(
                [a.nodes[k] for a, k in zip(self.value.grid.axes, places, strict=True)], axis=1
            )
            gap = 0.0 if before is None or after is None else after - before
            drift = (high[places] - low[places]) / gap if gap else 0.0
            for t in {before, after}:
                slopes = self.value.gradient(points, t)
                fall = -self.rise.values(np.hstack([points, slopes]), self.parameters)[:, 0]
                still, moving = max(still, fall.max()), max(moving, (fall + drift).max())
        return float(still), float(moving)


def _near(
    low: Array | Layers, high: Array | Layers, reach: float
) -> tuple[npt.NDArray[np.intp], ...]:
    """Nodes where one of two values is positive and one at most `reach`: all, or `MANY` drawn."""

    def holds(k: int) -> Any:
        return (np.maximum(low[k], high[k]) > 0) & (np.minimum(low[k], high[k]) <= reach)

    places = Places(holds, low.shape)
    if len(places) > MANY:
        return places.at(np.random.default_rng(0).choice(len(places), MANY, replace=False))
    return places.at(np.arange(len(places)))


def parameters_of(value: ValueFunction, system: System) -> dict[str, float]:
    """The parameters of a system with the numbers that a value was computed with."""
    numbers = value.report.parameters
    return {q.name: numbers[q.name] for q in system.parameters if q.name in numbers}


def optimal_inputs(
    system: System, value: ValueFunction, plane: tuple[str, str], held: Mapping[str, float]
) -> tuple[dict[str, Array], tuple[Array, Array]]:
    """At the nodes of a plane: the optimal inputs, and the two rates with the worst disturbance.

    The states outside the plane are held. Arrays of shape (nodes of the first, of the second).
    """
    model = decided(system, value)
    h = hamiltonian(model)
    states = {q.name: q.symbol for q in model.states}
    chosen = {q.symbol: h.inputs[q.name] for q in model.inputs}
    chosen |= {q.symbol: h.disturbances[q.name] for q in model.disturbances}
    rates = [model.rates[n].xreplace(chosen) for n in plane]
    wanted = Evaluator(
        [*h.inputs.values(), *rates], [*states.values(), *h.costates], model.parameters
    )
    axes = {a.name: a.nodes for a in value.grid.axes}
    first, second = np.meshgrid(*(axes[n] for n in plane), indexing="ij")
    columns = dict(held) | {plane[0]: first.ravel(), plane[1]: second.ravel()}
    points = np.stack([np.broadcast_to(columns[n], first.size) for n in states], axis=1)
    values = wanted.values(np.hstack([points, value.gradient(points)]), parameters_of(value, model))
    tables = [column.reshape(first.shape) for column in values.T]
    return dict(zip(h.inputs, tables, strict=False)), (tables[-2], tables[-1])
