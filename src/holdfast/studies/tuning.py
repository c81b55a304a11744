"""Gains that follow from conditions: all of them met at every corner, and best for a cost.

What gains cost is measured in closed loop: many candidates in one simulation, from the same starts.
Candidates are Sobol points, of which the admissible ones begin a differential evolution.

The gains that may be chosen, and the ranges they are searched in, are those of a scenario's law.
Each law is built as the scenario builds it, with all refusals. The closed loop is compiled once for
all, since the expressions are the same and only the parameters differ.
"""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution
from scipy.stats import qmc

from holdfast.analysis.safety.gain_conditions import JudgedCondition, corners_of, judged
from holdfast.analysis.simulation.files import NamedArrays
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.sweep_table import COSTS, Candidate, Costs, Tuning
from holdfast.arguments import checked
from holdfast.errors import GainWarning, HoldfastError, ScenarioError
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.resources import Progress
from holdfast.execution.simulation.settings import Outcome, Settings
from holdfast.maths.catalogue import laws
from holdfast.maths.catalogue.signature import arguments, leading_argument
from holdfast.maths.definitions.law import GainCondition, Law
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.nonholonomic.chained_feedback import POLE
from holdfast.scenario.build.closed_loop import composed_law, drawn_names
from holdfast.scenario.build.composer import Composer, composed_system
from holdfast.scenario.files import (
    Overrides,
    changes_of,
    edited_text,
    overridden,
    read_tables,
)
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import check_overrides, scenario_of
from holdfast.scenario.schema.closed_loop import ScenarioSpec
from holdfast.scenario.schema.values import validated
from holdfast.studies.comparison import in_case
from holdfast.studies.scenario_parameter import Knob, find_knob, last_part
from holdfast.studies.sweep import Axis, Over, read_over

PREFIX = "law."


class LawFamily:
    """The laws of the scenario of these tables at other numbers of [law]."""

    def __init__(self, file: str, data: dict[str, Any]) -> None:
        self.file, self.data = file, data
        spec = validated(ScenarioSpec, data, file)
        composer = Composer(file)
        self._system = composed_system(composer, spec.system)
        composer.drawn = drawn_names(composer, self._system, spec.varied)
        self._region = composer.region(spec.region, "region") if spec.region is not None else None
        self._composer = composer
        self._first = self._built(data)

    def at(self, settings: Iterable[str]) -> tuple[dict[str, float], tuple[GainCondition, ...]]:
        """The parameters by name, and the conditions, of the law with overrides law.KEY=VALUE.

        Raises what the law raises, and `ScenarioError` for a number that changes the law's
        expressions rather than a parameter.
        """
        law = self._built(overridden("", self.data, settings)[1])
        if _expressions(law) != _expressions(self._first):
            raise ScenarioError(
                f"{self.file}: {', '.join(settings)}: the expressions of the law change with it",
                expected="the key of a number that is a parameter of the law",
            )
        return {p.name: p.value for p in law.parameters}, law.conditions

    def _built(self, data: Mapping[str, Any]) -> Switching:
        spec = validated(ScenarioSpec, data, self.file).model_copy(update=_NO_MORE)
        composer = copy.copy(self._composer)
        composer.known, composer.drawn = dict(composer.known), dict(composer.drawn)
        law, _ = composed_law(composer, spec, self._system, self._region)
        return as_switching(law)


_NO_MORE: dict[str, None] = {"tracking": None, "safeguard": None, "observer": None}
"""Tables that change neither the conditions of a law nor its own parameters."""


def _expressions(law: Switching) -> tuple[object, ...]:
    modes = tuple((n, *mode.outputs.values()) for n, mode in law.modes.items())
    return (modes, law.transitions, tuple(law.signals.items()))


FACTOR = 4.0
"""The default range of a gain is from its own value divided by this to its value times this."""

RANGE = "KEY=LOW:HIGH, a gain and its range"

DIGITS = 4
"""Significant digits of a chosen gain."""

LISTS = ("poles", "gains")
"""Arguments of a law that hold several gains, or one for all."""


@dataclass(frozen=True)
class Gain:
    """A gain with its key, its value in the scenario, and its range in the unit of the range."""

    axis: Axis
    own: float

    @property
    def key(self) -> str:
        return self.axis.knob.key

    @property
    def unit(self) -> str:
        return self.axis.over.unit or self.axis.knob.unit

    def at(self, share: float) -> float:
        """The value at that share of the range, 0 to 1, to `DIGITS` digits."""
        low, high = self.axis.over.values
        value = low * (high / low) ** share if low * high > 0 else low + share * (high - low)
        return float(f"{value:.{DIGITS}g}")

    def share(self, value: float) -> float:
        """The inverse of `at`, before rounding; outside [0, 1] for a value out of the range."""
        low, high = self.axis.over.values
        if low * high > 0:
            return math.log(value / low) / math.log(high / low) if value * low > 0 else math.nan
        return (value - low) / (high - low)

    def settings(self, value: float) -> tuple[str, ...]:
        """The overrides KEY=VALUE."""
        return self.axis.settings(value)


def gains_of(scenario: Scenario, data: Mapping[str, Any], asked: Iterable[str]) -> list[Gain]:
    """The gains that are asked for, "k1=0.05:0.5" or "k1" alone, or all of the law's.

    Raises `ScenarioError` for a law without gains, a key that is none of [law], and a gain that is
    no number.
    """
    texts = list(asked) or _all(scenario, data)
    if not texts:
        raise ScenarioError(
            f"{scenario.file}: the law '{data['law'].get('name', scenario.law.name)}' "
            "names no gains",
            remedy="name numbers of [law] with --gain KEY=LOW:HIGH",
        )
    gains = [_gain(scenario, data, text) for text in texts]
    keys = [gain.key for gain in gains]
    for key in keys:
        if keys.count(key) > 1:
            raise ScenarioError(f"--gain {key}: occurs twice")
    return gains


def _all(scenario: Scenario, data: Mapping[str, Any]) -> list[str]:
    table = data["law"]
    function = next((f for f in laws.ALL if f.__name__ == table.get("name")), None)
    flagged = {p.name for p in scenario.law.parameters if p.gain}
    if function is None:
        return [n for n in table.get("parameters", {}) if n in flagged]
    leading = int(leading_argument(function) == "system")
    structural, numeric = arguments(function, leading)
    names = [f"{PREFIX}{n}" for n in numeric if n in flagged]
    for name in LISTS:
        listed = table.get(name)
        if isinstance(listed, list):
            places = [i for i, v in enumerate(listed) if isinstance(v, int | float)]
            names += [f"{PREFIX}{name}.{i}" for i in places]
    if "poles" in structural and not isinstance(table.get("poles"), list) and "gains" not in table:
        names.append(f"{PREFIX}poles")
    return names


def _gain(scenario: Scenario, data: Mapping[str, Any], text: str) -> Gain:
    name = text.partition("=")[0].strip()
    knob = _knob(scenario, data, name)
    if not knob.key.startswith(PREFIX):
        raise ScenarioError(f"--gain {name}: the key is {knob.key}", expected="a number of [law]")
    if knob.own is None:  # the file leaves the law's own value
        mine = [p.value for p in scenario.law.parameters if p.name == last_part(knob.key)]
        knob = replace(knob, own=mine[0] if mine else None)
    if knob.own is None or not math.isfinite(knob.own):
        raise ScenarioError(f"--gain {name}: {knob.key} is not a number")
    if "=" in text:
        over = read_over(text, latin=True, option="--gain", expected=RANGE)
    else:
        over = _around(scenario, knob, knob.own)
    return Gain(Axis(knob.key, knob, over), knob.own)


def _knob(scenario: Scenario, data: Mapping[str, Any], name: str) -> Knob:
    if name in ("poles", f"{PREFIX}poles") and "poles" not in data["law"]:
        key = f"{PREFIX}poles"
        return Knob(key, "poles", "1/s", POLE, lambda value: (f"{key}={value}",))
    return find_knob(scenario, data, name)


def _around(scenario: Scenario, knob: Knob, value: float) -> Over:
    """From a quarter to four times the value, counted from the parameter's lower limit."""
    name = last_part(knob.key)
    least: Sequence[float] = [p.above for p in scenario.law.parameters if p.name == name]
    floor = least[0] if least and math.isfinite(least[0]) else 0.0
    if value == floor:
        raise ScenarioError(
            f"--gain {name}: its value is {value:g}, around which there is no range",
            expected=f"--gain {name}=LOW:HIGH",
        )
    ends = [floor + (value - floor) / FACTOR, floor + (value - floor) * FACTOR]
    return Over(knob.key, tuple(sorted(ends)), "", True)


INSTANTS = 400
"""Samples of the inputs, about, from which the effort is taken."""

MOST_CORNERS = 4
"""Corners that are simulated from every start; the conditions are judged at all of them."""

TOGETHER = 3000
"""Runs that are simulated together, which bounds the memory."""

NEAR = 0.05
"""A start nearer to a constraint than this share of the farthest start counts as that far."""

Numbers = Mapping[str, float]


class Measure:
    """The costs of laws that differ in their parameters, from the starts of a scenario.

    Each start is simulated with the draws of the scenario and, for at most two draws, at each of
    their corners. The cost of a candidate is the larger of both.
    """

    def __init__(self, scenario: Scenario, base: Numbers) -> None:
        samples = round(scenario.settings["horizon"] / scenario.settings["sample_time"])
        stride = next(
            d for d in range(1, samples + 1) if samples % d == 0 and samples / d <= INSTANTS
        )
        every = stride * scenario.settings["sample_time"]
        self.instants = samples // stride + 1
        self.scenario = replace(
            scenario.with_settings(record_every=every), law=without_conditions(scenario.law)
        )
        self.base = base
        varied = scenario.varied
        self.varied = [varied]
        if varied.draws and not varied.vertices and 2 ** len(varied.draws) <= MOST_CORNERS:
            self.varied.append(replace(varied, vertices=tuple(varied.draws)))

    def costs(self, laws: Sequence[Numbers], progress: Progress | None = None) -> list[Costs]:
        """The costs of laws with these parameters, in their order."""
        worst: list[Costs] = []
        heaviest = max(v.turns for v in self.varied) * self.scenario.starts.count
        some = max(1, TOGETHER // heaviest)
        for first in range(0, len(laws), some):
            part = laws[first : first + some]
            each = [self._simulated(varied, part) for varied in self.varied]
            worst += [_worse(costs) for costs in zip(*each, strict=True)]
            if progress is not None:
                progress(min(first + some, len(laws)) / len(laws))
        return worst

    def _simulated(self, varied: Varied, laws: Sequence[Numbers]) -> list[Costs]:
        names = [n for n in self.base if any(law[n] != self.base[n] for law in laws)]
        cases = {n: [law[n] for law in laws] for n in names}
        if not cases:  # all of them are the law of the scenario
            return [self._costs(replace(self.scenario, varied=varied), 1)[0]] * len(laws)
        return self._costs(replace(self.scenario, varied=replace(varied, cases=cases)), len(laws))

    def _costs(self, scenario: Scenario, cases: int) -> list[Costs]:
        result = scenario.run()
        corners = len(scenario.varied.corners)
        horizon = float(scenario.settings["horizon"])

        def folded(values: Array) -> Array:
            """(case, corner), the means over the starts."""
            return values.reshape(-1, cases, corners).mean(axis=0)

        lost = folded(_lost(result).astype(np.float64)).mean(axis=1)
        time = folded(_time(result, horizon)).max(axis=1)
        effort = folded(_effort(result.arrays, horizon)).max(axis=1)
        clearance = folded(_clearance(result.arrays)).min(axis=1)
        return [Costs(*map(float, row)) for row in zip(time, effort, clearance, lost, strict=True)]


def without_conditions(law: Law | Switching) -> Law | Switching:
    """The same law; its conditions, which are judged elsewhere, are not judged in every run."""
    if isinstance(law, Switching):
        return law.map_laws(lambda mode: replace(mode, conditions=()), law.name)
    return replace(law, conditions=())


def _worse(costs: Sequence[Costs]) -> Costs:
    return Costs(
        max(c.time for c in costs),
        max(c.effort for c in costs),
        min(c.clearance for c in costs),
        max(c.lost for c in costs),
    )


def _lost(result: Result) -> Truths:
    outcome = result.arrays["outcome"].values
    wanted = [Outcome.REACHED] if result.arrays.attrs.get("goal") else [Outcome.STAYED]
    lost: Truths = ~np.isin(outcome, wanted)
    return lost


def _time(result: Result, horizon: float) -> Array:
    """Seconds until a run is in the goal for good; the horizon for one that is lost."""
    if not result.arrays.attrs.get("goal"):
        return np.full(len(result.arrays["outcome"].values), np.nan)
    since = result.arrays["goal_time"].values
    return np.where(_lost(result) | ~np.isfinite(since), horizon, since)


def _effort(data: NamedArrays, horizon: float) -> Array:
    """The integral of sum (input / limit)^2 [s]; infinite for a run that diverged."""
    axis = "actuator" if data["actuator"].values.shape[-1] else "input"
    values = data[axis].values
    scale = np.ones(values.shape[-1])
    if f"{axis}_high" in data:
        size = np.maximum(np.abs(data[f"{axis}_low"].values), np.abs(data[f"{axis}_high"].values))
        scale = size.reshape(-1, size.shape[-1]).max(axis=0)
        scale = np.where(np.isfinite(scale) & (scale > 0), scale, 1.0)
    power = ((values / scale) ** 2).sum(axis=-1)
    mean = (power[:, 1:] + power[:, :-1]).mean(axis=1) / 2
    return np.where(np.isfinite(mean), mean, 1e6) * horizon


def _clearance(data: NamedArrays) -> Array:
    """The share of its distance at the start that a run keeps from its worst constraint."""
    worst, first = data["worst_constraint"].values, data["constraint"].values[:, 0]
    if not worst.shape[-1]:
        return np.full(len(worst), np.nan)
    floor = np.maximum(NEAR * np.nanmax(-first, axis=0), 1e-12)
    least: Array = (-worst / np.maximum(-first, floor)).min(axis=1)
    return least


FIRST, MOST = 6, 9
"""Powers of 2: Sobol points that are judged first, and at most, until enough are admissible."""

REPAIRS = 25
"""Generations in which the least slack is raised where no point is admissible."""

REFUSED = -1e3
"""The slack of gains that the law refuses."""


@dataclass(frozen=True)
class Trial:
    """Gains by key, the parameters of their law, and its conditions where they are worst."""

    key: tuple[float, ...]
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    conditions: tuple[JudgedCondition, ...]

    @property
    def slack(self) -> float:
        """The least of all conditions."""
        return min((c.slack for c in self.conditions), default=math.inf)


class UnmetError(Exception):
    """No gains meet all conditions: the condition that is worst at the best gains.

    alone: whether it is met nowhere, even without the others.
    """

    def __init__(
        self, condition: JudgedCondition | None, gains: Mapping[str, float], alone: bool
    ) -> None:
        super().__init__()
        self.condition, self.gains, self.alone = condition, gains, alone


Build = Callable[[Sequence[float]], Trial | None]


def best_of(
    build: Build,
    gains: Sequence[Gain],
    costs: Callable[[Sequence[Trial]], list[float]],
    margin: float,
    candidates: int,
    seed: int,
    tell: Callable[[str, float], None],
) -> None:
    """Let `costs` see about `candidates` admissible trials that become cheaper.

    build: the trial at shares of the ranges of the gains. Raises `UnmetError`.
    """
    count = len(gains)
    population = min(max(6 * count, 8), 32, max(candidates // 2, 5))
    points = _admissible(build, gains, margin, population, seed, tell)

    def slack(x: Array) -> Array:
        trials = [build(column) for column in np.atleast_2d(x.T)]
        return np.array([[REFUSED if t is None else t.slack for t in trials]])

    def cost(x: Array) -> Array:
        trials = [build(column) for column in np.atleast_2d(x.T)]
        return np.array(costs([t for t in trials if t is not None]))

    differential_evolution(
        cost,
        [(0.0, 1.0)] * count,
        constraints=NonlinearConstraint(slack, margin, np.inf),
        init=points,
        maxiter=max(1, candidates // population - 1),
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
        rng=np.random.default_rng(seed),
    )


def _admissible(
    build: Build,
    gains: Sequence[Gain],
    margin: float,
    population: int,
    seed: int,
    tell: Callable[[str, float], None],
) -> Array:
    """`population` points, admissible ones first; the gains of the scenario, if they are."""
    sampler = qmc.Sobol(len(gains), rng=np.random.default_rng(seed))
    shares = [gain.share(gain.own) for gain in gains]
    points = [shares] if all(0 <= s <= 1 for s in shares) else []
    slacks: list[float] = []
    for power in range(FIRST, MOST + 1):
        points += sampler.random(2 ** (power if power == FIRST else power - 1)).tolist()
        for point in points[len(slacks) :]:
            trial = build(point)
            slacks.append(REFUSED if trial is None else trial.slack)
            tell("conditions", 0.1 * len(slacks) / 2**MOST)
        if sum(s >= margin for s in slacks) >= population:
            break
    order = sorted(range(len(points)), key=lambda i: (slacks[i] < margin, i))
    if slacks[order[0]] < margin:
        points.append(_repaired(build, points, slacks, margin, seed))
        order.insert(0, len(points) - 1)
    return np.array([points[i] for i in order[:population]])


def _repaired(
    build: Build,
    points: Sequence[Sequence[float]],
    slacks: Sequence[float],
    margin: float,
    seed: int,
) -> list[float]:
    """A point whose least slack is at least the margin, found by raising it; else `UnmetError`."""
    trials = [t for t in map(build, points) if t is not None]

    def shortfall(x: Array) -> Array:
        repaired = [build(column) for column in np.atleast_2d(x.T)]
        trials.extend(t for t in repaired if t is not None)
        return np.array([-REFUSED if t is None else -t.slack for t in repaired])

    best = sorted(range(len(points)), key=lambda i: -slacks[i])[: max(8, 4 * len(points[0]))]
    answer = differential_evolution(
        shortfall,
        [(0.0, 1.0)] * len(points[0]),
        init=np.array([points[i] for i in best]),
        maxiter=REPAIRS,
        vectorized=True,
        updating="deferred",
        polish=False,
        rng=np.random.default_rng(seed),
        callback=lambda intermediate_result: intermediate_result.fun <= -margin,
    )
    if answer.fun <= -margin:
        repaired: list[float] = answer.x.tolist()
        return repaired
    if not trials:
        raise UnmetError(None, {}, alone=True)
    final = max(trials, key=lambda t: t.slack)
    alone = [
        c
        for i, c in enumerate(final.conditions)
        if all(t.conditions[i].slack < margin for t in trials)
    ]
    short = alone or [c for c in final.conditions if c.slack < margin]
    raise UnmetError(min(short, key=lambda c: c.slack), final.gains, alone=bool(alone))


STARTS = 16
"""Starts of every candidate, by default."""

CHECKED = 5
"""Candidates that are simulated again from fresh starts."""

FRESH = 200
"""Fresh starts at most for these."""

Tell = Callable[[str, float], None]


@checked
def tune(
    scenario: str,
    cost: str = "time",
    *,
    gains: Iterable[str] = (),
    margin: float = 0.1,
    candidates: int = 200,
    runs: int = STARTS,
    seed: int | None = None,
    case: str | None = None,
    overrides: Overrides = (),
    progress: Tell | None = None,
) -> Tuning:
    """Gains of a scenario's law that meet every condition at every corner, best for a cost.

        minimise   cost(k)      subject to   limit_i(k, c) - value_i(k, c) >= margin max(|.|, |.|)

    for every condition i and every corner c of the varied numbers, as the law knows them and as the
    simulated vehicle has them. The conditions are those of the law (`GainCondition`); the costs are
    measured in closed loop, as means over the starts at the worst corner: cost: "time" to the goal,
    "effort" or "clearance" to the constraints (`Costs`). Gains that lose more runs than the
    scenario's own are not chosen.

    gains: "k1=0.05:0.5", "law.k2" or, by default, every gain of the law, each from a quarter of
    its value to four times as much. margin: relative, at least 0 and below 1. candidates: about
    how many are simulated, in differential evolution (R. Storn and K. Price, 1997) that begins
    with Sobol points. runs: starts of each. The chosen gains and the scenario's own are then
    simulated together from fresh starts, as many as the scenario has and 200 at most. case: a
    case of the scenario's [compare] to tune in, such as a wrong model. The same seed gives the
    same gains.

    Raises `ScenarioError` for a law without gains or conditions, an unknown cost, a cost that the
    scenario does not have, and, naming one condition with its value, limit, corner and
    consequence, if no gains in the ranges meet all conditions.

    >>> few = {"candidates": 10, "runs": 1, "overrides": ["run.horizon=4"]}
    >>> hf.tune("ch4-integrator", gains=["k2=0.5:1"], **few).gains
    {'law.k2': 1.0}
    """
    changes = changes_of(overrides)
    _check(cost, margin, candidates, runs)
    tell = progress or (lambda what, share: None)

    def tables(changes: Sequence[str]) -> tuple[str, str, dict[str, Any]]:
        shown, text, data = read_tables(scenario, changes)
        return shown, text, data if case is None else in_case(shown, data, case)

    shown, text, data = tables(changes)
    loaded = _closed_loop(shown, text, data, runs, seed)
    check_overrides(changes, [loaded], lambda s: [scenario_of(*tables(s), runs, seed)])
    _check_cost(loaded, cost)
    chosen = gains_of(loaded, data, gains)
    tell("preparing", 0.0)
    loaded = loaded.kept()
    trials = _Trials(loaded, LawFamily(shown, data), chosen)
    first = trials.at({gain.key: gain.own for gain in chosen})
    if not first.conditions:
        raise ScenarioError(
            f"{shown}: the law '{data['law'].get('name', loaded.law.name)}' has no conditions",
            expected="a law with gain conditions (GainCondition)",
        )
    measure = Measure(loaded, first.parameters)
    (before,) = measure.costs([first.parameters])
    by_key = {first.key: before} if first.slack >= margin else {}
    scale = abs(before.of(cost)) or 1.0

    def costs(some: Sequence[Trial]) -> list[float]:
        missing = {t.key: t for t in some if t.key not in by_key}
        measured = measure.costs([t.parameters for t in missing.values()])
        by_key.update(zip(missing, measured, strict=True))
        tell(f"{len(by_key)} candidates", min(0.1 + 0.8 * len(by_key) / candidates, 0.9))
        return [by_key[t.key].of(cost) / scale + 1e3 * by_key[t.key].lost for t in some]

    try:
        best_of(trials.of, chosen, costs, margin, candidates, loaded.seed, tell)
    except UnmetError as unmet:
        raise _refusal(shown, unmet, margin) from None
    admissible = sorted(
        (trials.built[key] for key in by_key),
        key=lambda t: (max(by_key[t.key].lost - before.lost, 0.0), by_key[t.key].of(cost), t.key),
    )
    tell("fresh starts", 0.92)
    fresh = _fresh(shown, text, data, loaded.seed + 1).kept()
    again = Measure(fresh, first.parameters)
    able = admissible[:CHECKED]
    if first.key in by_key and first not in able:
        able.append(first)  # where all others lose more runs
    reference, *others = again.costs([first.parameters, *(t.parameters for t in able)])
    place = min(
        range(len(able)),
        key=lambda i: (max(others[i].lost - reference.lost, 0.0), others[i].of(cost), i),
    )
    best = able[place]
    settings = [s for gain in chosen for s in gain.settings(best.gains[gain.key])]
    tell("done", 1.0)
    return Tuning(
        title=loaded.title,
        scenario=scenario if scenario.endswith(".toml") else loaded.name,
        case=case or "",
        cost=cost,
        margin=margin,
        seed=loaded.seed,
        gains=dict(best.gains),
        shipped=dict(first.gains),
        units={gain.key: gain.unit for gain in chosen},
        conditions=best.conditions,
        shipped_conditions=first.conditions,
        candidates=tuple(Candidate(dict(t.gains), t.slack, by_key[t.key]) for t in admissible),
        shipped_costs=before,
        before=reference,
        after=others[place],
        tried=len(trials.built),
        starts=loaded.starts.count,
        checked=fresh.starts.count,
        corners=2 ** len(loaded.varied.draws),
        instants=measure.instants,
        text=edited_text(scenario, [*changes, *settings]),
    )


def _check(cost: str, margin: float, candidates: int, runs: int) -> None:
    if cost not in COSTS:
        raise ScenarioError(f"the cost is '{cost}'", expected=" or ".join(COSTS))
    if not 0 <= margin < 1:
        raise ScenarioError(f"the margin is {margin:g}", expected="at least 0 and below 1")
    if candidates < 10:
        raise ScenarioError(f"{candidates} candidates", expected="at least 10")
    if runs < 1:
        raise ScenarioError(f"{runs} starts", expected="at least 1")


def _closed_loop(
    shown: str, text: str, data: dict[str, Any], runs: int | None, seed: int | None
) -> Scenario:
    made = scenario_of(shown, text, data, runs, seed)
    if isinstance(made, Scenario) and made.surroundings is not None:
        raise ScenarioError(f"{shown}: it has obstacles that move, which no tuning counts with")
    if not isinstance(made, Scenario) or made.law.handed:
        raise ScenarioError(
            f"{shown}: it has no law of its own to tune", expected="a closed loop with a [law]"
        )
    return made


def _fresh(shown: str, text: str, data: dict[str, Any], seed: int) -> Scenario:
    """The scenario with other random starts, `FRESH` at most."""
    whole = _closed_loop(shown, text, data, None, seed)
    if whole.starts.count <= FRESH:
        return whole
    return _closed_loop(shown, text, data, FRESH, seed)


def _check_cost(scenario: Scenario, cost: str) -> None:
    missing = {"time": scenario.goal is None, "clearance": scenario.region is None}
    if missing.get(cost):
        table = "goal" if cost == "time" else "region"
        others = [c for c in COSTS if not missing.get(c)]
        raise ScenarioError(
            f"{scenario.file}: the cost '{cost}' needs a [{table}]",
            remedy=f"take --cost {' or '.join(others)}",
        )


class _Trials:
    """Laws at gains, with their conditions judged; each is built once."""

    def __init__(self, scenario: Scenario, family: LawFamily, gains: Sequence[Gain]) -> None:
        self.family, self.gains = family, gains
        self.built: dict[tuple[float, ...], Trial] = {}
        self.refused: dict[tuple[float, ...], HoldfastError] = {}
        fields = {n: v for n, v in scenario.settings.items() if n in Settings.__dataclass_fields__}
        self.settings = Settings(**fields)
        regions = [r.parameters for r in (scenario.region, scenario.goal) if r is not None]
        parameters = [
            *scenario.system.parameters,
            *scenario.law.parameters,
            *(p for r in regions for p in r),
        ]
        self.numbers = {p.name: p.value for p in parameters}
        self.corners = corners_of(scenario.varied, scenario.plant, self.numbers, scenario.seed)

    def of(self, shares: Sequence[float]) -> Trial | None:
        """The law at these shares of the ranges; None if it is refused."""
        gains = {g.key: g.at(s) for g, s in zip(self.gains, shares, strict=True)}
        key = tuple(gains.values())
        if key in self.refused:
            return None
        try:
            return self.at(gains)
        except HoldfastError as error:
            self.refused[key] = error
            return None

    def at(self, gains: Mapping[str, float]) -> Trial:
        """The law at these gains; raises what it raises."""
        key = tuple(gains.values())
        if key not in self.built:
            settings = [s for g in self.gains for s in g.settings(gains[g.key])]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", GainWarning)
                parameters, conditions = self.family.at(settings)
            judgements = judged(
                conditions, {**self.numbers, **parameters}, self.corners, self.settings
            )
            self.built[key] = Trial(key, dict(gains), parameters, judgements)
        return self.built[key]


def _refusal(shown: str, unmet: UnmetError, margin: float) -> ScenarioError:
    worst = unmet.condition
    if worst is None:
        return ScenarioError(
            f"{shown}: the law refuses all gains in the ranges", remedy="other ranges with --gain"
        )
    gains = ", ".join(f"{k} = {v:g}" for k, v in unmet.gains.items())
    together = "" if unmet.alone else " together with the others"
    needs = f", less a margin of {100 * margin:g} %" if margin else ""
    return ScenarioError(
        f"{shown}: no gains in the ranges meet the condition on {worst.condition}{together}: "
        f"at best it is {worst.value:.4g}, its limit {worst.limit:.4g}{needs}, {worst.where} "
        f"(with {gains}): {worst.consequence} ({worst.source})",
        remedy="wider ranges with --gain, a smaller --margin, or a smaller range of what varies",
    )
