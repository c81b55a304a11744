"""Gains that follow from conditions: all of them met at every corner, and best for a cost."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from holdfast.analysis.safety.gain_conditions import corners_of, judged
from holdfast.analysis.simulation.tuning import COSTS, Candidate, Tuning
from holdfast.arguments import checked
from holdfast.errors import GainWarning, HoldfastError, ScenarioError
from holdfast.execution.simulation.settings import Settings
from holdfast.scenario.candidates import LawFamily
from holdfast.scenario.edited import edited_text
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import scenario_of
from holdfast.scenario.overrides import check_overrides
from holdfast.studies.comparison.compare import in_case
from holdfast.studies.tuning.gains import Gain, gains_of
from holdfast.studies.tuning.measure import Measure
from holdfast.studies.tuning.search import Trial, UnmetError, best_of

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
    overrides: Iterable[str] = (),
    progress: Tell | None = None,
) -> Tuning:
    """Gains of a scenario's law that meet every condition at every corner, best for a cost.

        minimise   cost(k)      subject to   limit_i(k, c) - value_i(k, c) >= margin max(|.|, |.|)

    for every condition i and every corner c of the varied numbers, as the law knows them and as
    the simulated vehicle has them. The conditions are those of the law (`GainCondition`); the
    costs are measured in closed loop, as means over the starts at the worst corner:
    `cost` = "time" to the goal, "effort" or "clearance" to the constraints (`Costs`). Gains that
    lose more runs than the scenario's own are not chosen.

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
    """
    changes = list(overrides)
    _check(cost, margin, candidates, runs)
    tell = progress or (lambda what, share: None)

    def tables(changes: Sequence[str]) -> tuple[str, str, dict[str, Any]]:
        shown, text, data = read_tables(scenario, changes)
        return shown, text, data if case is None else in_case(shown, data, case)

    shown, text, data = tables(changes)
    own = _closed_loop(shown, text, data, runs, seed)
    check_overrides(changes, [own], lambda s: [scenario_of(*tables(s), runs, seed)])
    _check_cost(own, cost)
    chosen = gains_of(own, data, gains)
    tell("preparing", 0.0)
    own = own.kept()
    trials = _Trials(own, LawFamily(shown, data), chosen)
    first = trials.at({gain.key: gain.own for gain in chosen})
    if not first.conditions:
        raise ScenarioError(
            f"{shown}: the law '{data['law'].get('name', own.law.name)}' has no conditions",
            expected="a law with gain conditions (GainCondition)",
        )
    measure = Measure(own, first.parameters)
    (before,) = measure.costs([first.parameters])
    known = {first.key: before} if first.slack >= margin else {}
    scale = abs(before.of(cost)) or 1.0

    def costs(some: Sequence[Trial]) -> list[float]:
        missing = {t.key: t for t in some if t.key not in known}
        found = measure.costs([t.parameters for t in missing.values()])
        known.update(zip(missing, found, strict=True))
        tell(f"{len(known)} candidates", min(0.1 + 0.8 * len(known) / candidates, 0.9))
        return [known[t.key].of(cost) / scale + 1e3 * known[t.key].lost for t in some]

    try:
        best_of(trials.of, chosen, costs, margin, candidates, own.seed, tell)
    except UnmetError as unmet:
        raise _refusal(shown, unmet, margin) from None
    admissible = sorted(
        (trials.built[key] for key in known),
        key=lambda t: (max(known[t.key].lost - before.lost, 0.0), known[t.key].of(cost), t.key),
    )
    tell("fresh starts", 0.92)
    fresh = _fresh(shown, text, data, own.seed + 1).kept()
    again = Measure(fresh, first.parameters)
    able = admissible[:CHECKED]
    if first.key in known and first not in able:
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
        title=own.title,
        scenario=scenario if scenario.endswith(".toml") else own.name,
        case=case or "",
        cost=cost,
        margin=margin,
        seed=own.seed,
        gains=dict(best.gains),
        shipped=dict(first.gains),
        units={gain.key: gain.unit for gain in chosen},
        conditions=best.conditions,
        shipped_conditions=first.conditions,
        candidates=tuple(Candidate(dict(t.gains), t.slack, known[t.key]) for t in admissible),
        shipped_costs=before,
        before=reference,
        after=others[place],
        tried=len(trials.built),
        starts=own.starts.count,
        checked=fresh.starts.count,
        corners=2 ** len(own.varied.draws),
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


def _check_cost(own: Scenario, cost: str) -> None:
    missing = {"time": own.goal is None, "clearance": own.region is None}
    if missing.get(cost):
        table = "goal" if cost == "time" else "region"
        others = [c for c in COSTS if not missing.get(c)]
        raise ScenarioError(
            f"{own.file}: the cost '{cost}' needs a [{table}]",
            remedy=f"take --cost {' or '.join(others)}",
        )


class _Trials:
    """Laws at gains, with their conditions judged; each is built once."""

    def __init__(self, own: Scenario, family: LawFamily, gains: Sequence[Gain]) -> None:
        self.family, self.gains = family, gains
        self.built: dict[tuple[float, ...], Trial] = {}
        self.refused: dict[tuple[float, ...], HoldfastError] = {}
        fields = {n: v for n, v in own.settings.items() if n in Settings.__dataclass_fields__}
        self.settings = Settings(**fields)
        regions = [r.parameters for r in (own.region, own.goal) if r is not None]
        known = [*own.system.parameters, *own.law.parameters, *(p for r in regions for p in r)]
        self.numbers = {p.name: p.value for p in known}
        self.corners = corners_of(own.varied, own.plant, self.numbers, own.seed)

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
            found = judged(conditions, {**self.numbers, **parameters}, self.corners, self.settings)
            self.built[key] = Trial(key, dict(gains), parameters, found)
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
