"""The law of a value that is put together: that of its part, in the states of the whole system.

Actuators that lag, under commands that are held and that follow old measurements:

    T a' = s(u) - a,   s(u) = a_m + k (s(w) - a_m)

a_m is the measured thrust. While u is held the thrust moves on, and what acts is not w but

    s(w) + (1 - 1 / k) (a - a_m)

The set that is put together is validated in closed loop (Monte Carlo), on the whole system.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypedDict, Unpack

import numpy as np
import sympy as sp

from holdfast.analysis.decomposition.parts_value import ROUNDING, PartsValue, SolvedPart
from holdfast.analysis.reachability.grid import by_name, number, whole
from holdfast.analysis.reachability.problem import with_disturbance
from holdfast.analysis.safety.promise import (
    CONFIRMED,
    EVERY,
    FELL_SHORT,
    FROM_INSIDE,
    confirmation,
    shortfall,
)
from holdfast.analysis.safety.safety_filter import decided, kept_law, possible_margin
from holdfast.analysis.safety.sampled_value import patience_of, sampled_value
from holdfast.analysis.safety.validation import (
    CONSTANT,
    FALLS,
    INSIDE,
    SWINGING,
    SWITCHING,
    at_rest,
    schedules,
)
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.analysis.simulation.simulate import simulate
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.settings import Outcome
from holdfast.maths.control.safety_filter import Row, check_fit, input_scales
from holdfast.maths.decomposition.prediction import lags
from holdfast.maths.definitions.law import Law, Safeguard
from holdfast.maths.definitions.quantity import merge_parameters
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.sets.linear_image import LinearImage
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import clip

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
    prediction = value.decomposition.prediction
    if prediction is None or prediction.gain <= 1:
        return
    held, late = _times(options)
    for actuator, constant in zip(prediction.actuators, _constants(value), strict=True):
        if overshoot(constant, prediction.gain, held, late) > BEYOND:
            raise SimulationError(
                f"actuator '{actuator.name}' with a lag of {constant:.4g} s, which its commands "
                f"make {prediction.gain:.4g} times faster, would leave its share in inputs held "
                f"for {held:g} s" + (f" with a delay of {late:g} s" if late else ""),
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
    prediction = value.decomposition.prediction
    if prediction is None or prediction.gain <= 1:
        return ()
    return tuple((1 - 1 / prediction.gain) * moved for moved in _moved(value, options))


def _moved(value: PartsValue, options: Mapping[str, Any]) -> list[float]:
    """How far the thrust of each actuator may move while u is held."""
    prediction = value.decomposition.prediction
    assert prediction is not None
    held, late = _times(options)
    return [
        min(1.0, (1 - math.exp(-(held + late) / constant)) * prediction.gain) * (high - low)
        for (low, high), constant in zip(prediction.intervals, _constants(value), strict=True)
    ]


def held_margin(
    value: PartsValue, solved: SolvedPart, options: Mapping[str, Any]
) -> dict[str, Any]:
    """The options with a margin for all that acts while inputs are held, if none is given."""
    prediction = value.decomposition.prediction
    if prediction is None or prediction.gain <= 1 or options.get("margin") is not None:
        return dict(options)
    held, late = _times(options)
    wider = 1.0
    for (low, high), moved in zip(prediction.intervals, _moved(value, options), strict=True):
        wider = max(wider, 1 + (1 - 1 / prediction.gain) * moved / min(-low, high))
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


class FilterOptions(TypedDict, total=False):
    """Those of `safety_law`, but what follows from the parts."""

    rate: float | None
    margin: float | None
    sample_time: float
    delay: float
    ahead: bool | float


@checked
def parts_law(
    value: PartsValue,
    law: Law | None = None,
    *,
    scales: Mapping[str, float] | None = None,
    **options: Unpack[FilterOptions],
) -> Law:
    """The law that keeps the whole system in the set: optimal inputs, or a safety filter of `law`.

    It is that of `safety_law` for the part, without `law` the optimal inputs without a game, with
    the part's states and inputs as functions of the whole: of predicted actuators u = k w + (1 - k)
    a, with the choice w of the part.

    scales: input -> the change of it that counts as 1. options: those of `safety_law`; its margin
    allows for everything that w and the actuators may do while u is held.

    `sample_time` is checked for the optimal inputs too, if it is given. A filter keeps an input
    that the part does not need within its bounds.

    Raises `SimulationError` for a value of several parts: these are systems of their own, whose
    laws are those of `safety_law`, and `PartsValue.inputs` gives the inputs of all of them; and for
    a sample time or a delay in which actuators would leave their share. Raises
    `DefinitionError` for a law that has no safety filter, as `safety_law` does.

    >>> apart = hf.decompose(gusty, track, kind="discriminating-kernel")
    >>> value = hf.solve_parts(apart, {"x": (-1.2, 1.2), "v": (-1.6, 1.6)}, 21, 4.0)
    >>> hf.parts_law(value, brake)
    Law 'brake, kept safe' of x, v
      a = -c*v - k*x
      kept by 2 conditions
      looks up a table at x, v
      parameters: safety_rate = 2 1/s, safety_margin = 0.012 1, k = 1 1/s^2, c = 2 1/s
    """
    solved = only_part(value)
    system = value.decomposition.system
    of_part = solved.part.system
    asked = None
    if law is not None or "sample_time" in options:
        check_held(value, options)
    inner: dict[str, Any] = dict(options)
    if law is None:
        inner["ahead"] = False
    else:
        check_fit(system, law)
        if law.lookup is not None:
            raise DefinitionError(f"law '{law.name}' has a value function already")
        asked = Law("asked", of_part.states, dict.fromkeys(of_part.input_names, sp.S.Zero))
        hold, errors = options.get("sample_time", SAMPLE_TIME), held_errors(value, options)
        part = decided(of_part, solved.value)
        patience = patience_of(options.get("ahead", True))
        game = (part, solved.value, hold, errors)
        if solved.value.report.converged and sampled_value(*game, patience=patience):
            inner["errors"] = errors
        else:
            inner = held_margin(value, solved, options)
    every = input_scales(system, scales or {})
    inside = {n: s for n, s in (scales or {}).items() if n in of_part.input_names}
    made: Law = kept_law(of_part, solved.value, asked, scales=inside, predicts=False, **inner).law
    there = {q.symbol: solved.part.coordinates[q.name] for q in of_part.states}
    gain, command = _command(value, solved)
    assert made.lookup is not None
    lookup = made.lookup.subs(there)
    signals = {n: e.xreplace(there) for n, e in made.signals.items()}
    if law is None:
        chosen = {n: e.xreplace(there) for n, e in made.outputs.items()}
        return replace(
            made,
            name=f"{made.name} of {system.name}",
            reads=system.states,
            outputs={n: gain * chosen.get(n, sp.S.Zero) + e for n, e in command.items()},
            parameters=merge_parameters(made.parameters, system.parameters),
            lookup=lookup,
            signals=signals,
        )
    assert made.safeguard is not None
    guard = _with_rows(made.safeguard.subs(there), _unneeded(value, solved), system.input_names)
    guard = _in_commands(guard, of_part.input_names, gain, _clipped(value, command))
    reads = {q.name: q for q in (*law.reads, *system.states)}
    return replace(
        law,
        name=f"{law.name}, kept safe",
        reads=tuple(reads.values()),
        parameters=merge_parameters(made.parameters, system.parameters, law.parameters),
        lookup=lookup,
        signals={**law.signals, **signals},
        safeguard=replace(guard, scales={n: guard.scales.get(n, every[n]) for n in command}),
    )


def only_part(value: PartsValue) -> SolvedPart:
    """The one part of a value; `SimulationError` for one of several."""
    if len(value.parts) != 1 or len(value.parts[0]) != 1:
        raise SimulationError(
            f"one law for {len(value.values)} parts",
            expected="a value of one part",
            remedy="take the safety_law of each part and its value, or PartsValue.inputs",
        )
    return value.parts[0][0]


def _command(value: PartsValue, solved: SolvedPart) -> tuple[sp.Expr, dict[str, sp.Expr]]:
    """k and b of the command u = k w + b, for every input of the whole."""
    prediction = value.decomposition.prediction
    names = value.decomposition.system.input_names
    if prediction is None:
        return sp.S.One, dict.fromkeys(names, sp.S.Zero)
    none = {q.symbol: sp.S.Zero for q in solved.part.system.inputs}
    return sp.Float(prediction.gain), {n: prediction.command[n].xreplace(none) for n in names}


def _clipped(value: PartsValue, command: Mapping[str, sp.Expr]) -> dict[str, sp.Expr]:
    """b with actuators in their share, so that no command leaves its bounds wherever they are."""
    prediction = value.decomposition.prediction
    if prediction is None:
        return dict(command)
    ends = zip(prediction.actuators, prediction.intervals, strict=True)
    held = {a.symbol: clip(a.symbol, sp.Float(low), sp.Float(high)) for a, (low, high) in ends}
    return {n: e.xreplace(held) for n, e in command.items()}


def _unneeded(value: PartsValue, solved: SolvedPart) -> list[Row]:
    """The bounds of the inputs that the part does not need, over all inputs.

    A part with predicted actuators has all of them: they count as those of one set.
    """
    system = value.decomposition.system
    bounds = system.input_bounds
    needed = [n in solved.part.system.input_names for n in system.input_names]
    if bounds is None or all(needed):
        return []
    rows = bounds.half_spaces()
    return [
        (n, b) for n, b in rows if all(e == 0 for e, mine in zip(n, needed, strict=True) if mine)
    ]


def _with_rows(guard: Safeguard, rows: Sequence[Row], names: Sequence[str]) -> Safeguard:
    """A safeguard with more hard rows, over all of the inputs."""
    none = (sp.S.Zero,) * len(guard.offsets)
    normals = {n: guard.normals.get(n, none) for n in names}
    more = {n: tuple(normal[i] for normal, _ in rows) for i, n in enumerate(names)}
    hard = guard.hard
    return replace(
        guard,
        normals={n: (*row[:hard], *more[n], *row[hard:]) for n, row in normals.items()},
        offsets=(*guard.offsets[:hard], *(b for _, b in rows), *guard.offsets[hard:]),
        hard=hard + len(rows),
    )


def _in_commands(
    guard: Safeguard, names: Sequence[str], gain: sp.Expr, command: Mapping[str, sp.Expr]
) -> Safeguard:
    """Half-spaces of w = (u - b) / k as half-spaces of u."""
    normals = guard.normals
    offsets = tuple(
        offset + sp.Add(*(normals[n][j] * b / gain for n, b in command.items()))
        for j, offset in enumerate(guard.offsets)
    )
    return replace(
        guard,
        normals={n: tuple(e / gain for e in row) for n, row in normals.items()},
        offsets=offsets,
        foresight=guard.foresight and guard.foresight.of(names, list(command), gain, command),
    )


DRAWS = 200
"""Most batches of random states."""

RUNS, SAMPLES = 100, 100_000
"""Of the trial by default: the starts, and the samples of their runs at most."""


@dataclass(frozen=True)
class PartsPromise:
    """States of the region, drawn in a box: how many are promised, and how many of each are kept.

    promised: of the states drawn in the region. share: of the set that is more than `margin`
    inside, which was tried. inside: promised states, kept against every disturbance tried; outside:
    the others, kept against none or against constant ones by the same law: what the set gives away
    at least, None where every state is promised. edge: promised states at most `margin` inside.
    """

    promised: Rate
    inside: Rate
    outside: Rate | None
    horizon: float
    margin: float
    sample_time: float
    share: float = 1.0
    edge: Rate | None = None

    @property
    def outcome(self) -> str:
        """CONFIRMED, FROM_INSIDE or FELL_SHORT."""
        if not self.held:
            return FELL_SHORT
        whole = self.share == 1 or (self.edge is not None and self.edge.count == self.edge.total)
        return CONFIRMED if whole else FROM_INSIDE

    @property
    def kept_share(self) -> float:
        """The share of the set in which no start is lost."""
        if not self.held:
            return 0.0
        return 1.0 if self.outcome == CONFIRMED else self.share

    @property
    def conclusion(self) -> str:
        """What the runs come to, as a sentence."""
        if self.verdict:
            return self.verdict
        whence = "" if self.outcome == CONFIRMED else f"{self.margin:.3g}"
        return confirmation(self.kept_share, EVERY, whence, self.edge)

    @property
    def held(self) -> bool:
        return self.inside.count == self.inside.total

    @property
    def verdict(self) -> str:
        """The shortfall as a sentence, or an empty text."""
        return "" if self.held else shortfall(self.inside, f"{self.margin:g}")

    def summary(self) -> dict[str, Any]:
        """The content of summary.json."""
        return {
            "horizon_s": self.horizon,
            "margin": self.margin,
            "sample_time_s": self.sample_time,
            "held": self.held,
            "share_of_set": self.share,
            "outcome": self.outcome,
            "conclusion": self.conclusion,
            "promised": self.promised.summary(),
            "inside": self.inside.summary(),
            "edge": self.edge.summary() if self.edge else None,
            "outside": self.outside.summary() if self.outside else None,
        }


@checked
def check_parts(
    value: PartsValue,
    region: Region,
    box: Mapping[str, tuple[float, float]],
    *,
    law: Law | None = None,
    disturbance: Mapping[str, float] | None = None,
    runs: int = 1000,
    margin: float = 0.0,
    horizon: float = 1.0,
    sample_time: float = 0.02,
    rate: float | None = None,
    seed: int = 0,
) -> PartsPromise:
    """Simulate the whole system from `runs` promised states, V > margin, and as many others.

    The states are drawn uniformly in a box of all states and lie in the region. law: kept safe
    (`parts_law`), or None for the optimal inputs. Raises `SimulationError` for a value of several
    parts, for a sample time in which actuators would leave their share, and where no state is
    promised.
    """
    whole("runs: ", runs, 1)
    whole("seed: ", seed, 0)
    system = value.decomposition.system
    for name in system.state_names:
        if name not in by_name("box", box, '{"x": (0, 1)}'):
            raise SimulationError(
                f"the box of the starts has no interval for '{name}'",
                expected="intervals of all states of the whole system",
                remedy="leave out the promise where states are relative or do not matter",
            )
    steered = parts_law(value, law, sample_time=sample_time, rate=rate)
    model = with_disturbance(system, disturbance or {})
    inside, edge, outside, promised, share = _drawn(value, region, box, runs, margin, seed)
    if not len(inside):
        raise SimulationError(
            f"no state of the set is further inside than {margin:g}",
            expected="a set with states in the box",
            remedy="take a finer grid, or a smaller margin",
        )

    def rate_of(starts: Array, kinds: tuple[str, ...]) -> Rate:
        stays = np.ones(len(starts), dtype=bool)
        for kind in kinds:
            more: dict[str, Any] = {}
            if kind:
                varying = schedules(model)
                more = {
                    "disturbance": varying.expressions,
                    "varied": varying.drawn(kind, horizon, sample_time),
                }
            result = simulate(
                model, steered, starts=starts, region=region, horizon=horizon,
                sample_time=sample_time, record_every=horizon, start_outside=True, seed=seed,
                **more,
            )  # fmt: skip
            stays &= result.arrays["outcome"].values == int(Outcome.STAYED)
        return Rate(int(stays.sum()), len(stays))

    every = (CONSTANT, INSIDE, SWITCHING, SWINGING) if model.disturbances else ("",)
    return PartsPromise(
        promised=promised,
        inside=rate_of(inside, every),
        outside=rate_of(outside, every[:1]) if len(outside) else None,
        horizon=horizon,
        margin=margin,
        sample_time=sample_time,
        share=share,
        edge=rate_of(edge, every) if len(edge) else None,
    )


def default_parts_promise(value: PartsValue) -> PartsPromise | None:
    """The promise of a kernel that was put together here: `RUNS` starts for its horizon at most.

    The law is the filter around inputs of zero, held for an Euler step of the marches. The starts
    inside have the largest change of V over a cell of any part, where a state of the set has it.

    Raises `SimulationError` where it cannot be tried.
    """
    whole = value.decomposition
    if whole.kept is None or any(v.claim is None for v in value.values):
        return None
    reports = [v.report for v in value.values]
    hold = min(r.euler_step for r in reports)
    horizon = min(min(r.horizon_s for r in reports), SAMPLES * hold / RUNS)
    deepest = min(v.highest() for v in value.values)
    cell = max(r.cell for r in reports)
    margin = cell if cell < deepest else 0.0
    constants = reports[0].disturbance
    disturbance = {n: float(v) for n, v in constants.items()}
    return check_parts(
        value, whole.kept, box_of_starts(value), disturbance=disturbance, runs=RUNS, margin=margin,
        horizon=horizon, sample_time=hold, law=at_rest(whole.system), rate=FALLS / hold,
    )  # fmt: skip


def box_of_starts(value: PartsValue) -> dict[str, tuple[float, float]]:
    """The box of the starts: of the grids, and of the states that the domain bounds.

    A state that no part reads begins at 0.
    """
    whole = value.decomposition
    box: dict[str, tuple[float, float]] = {}
    for solved in (s for parts in value.parts for s in parts):
        for axis in solved.value.grid.axes:
            if axis.name in whole.system.state_names:
                box.setdefault(axis.name, (axis.low, axis.high))
    for name, interval in ((n, i) for p in whole.parts for n, i in p.cut.items()):
        box.setdefault(name, interval)
    if whole.prediction is not None:
        names = (a.name for a in whole.prediction.actuators)
        box |= dict(zip(names, whole.prediction.intervals, strict=True))
    read = {s for p in whole.parts for e in p.coordinates.values() for s in e.free_symbols}
    for q in whole.system.states:
        if q.symbol not in read:
            box.setdefault(q.name, (0.0, 0.0))
    return box


def _drawn(
    value: PartsValue,
    region: Region,
    box: Mapping[str, tuple[float, float]],
    runs: int,
    margin: float,
    seed: int,
) -> tuple[Array, Array, Array, Rate, float]:
    """States inside, nearer to the edge, and outside the set; of the region's states the share that
    is inside the set, and of these the share that is deeper than the margin."""
    system: System = value.decomposition.system
    low, high = (np.array([box[n][k] for n in system.state_names]) for k in (0, 1))
    symbols = [q.symbol for q in system.states]
    safe = Evaluator([region.margin], symbols, region.parameters)
    generator = np.random.default_rng(seed)
    sides: dict[bool, list[Array]] = {True: [], False: []}
    near: list[Array] = []
    count = total = deep = 0
    for _ in range(DRAWS):
        states = generator.uniform(low, high, (20 * runs, len(low)))
        states = states[safe.values(states)[:, 0] > 0]
        levels = value.at(states)
        there = levels > 0
        count, total = count + int(there.sum()), total + len(states)
        sides[True].append(states[levels > margin])
        near.append(states[there & (levels <= margin)])
        deep += len(sides[True][-1])
        sides[False].append(states[~there])
        if all(sum(map(len, some)) >= runs for some in sides.values()):
            break
    inside, outside = (np.vstack(sides[k])[:runs] for k in (True, False))
    edge = np.vstack(near)[: (runs + 1) // 2]
    return inside, edge, outside, Rate(count, max(total, 1)), deep / max(count, 1)
