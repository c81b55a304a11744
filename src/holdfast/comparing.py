"""`[compare]` of a scenario: several laws, in several cases, from the same starts."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from holdfast.analysis.comparison import Comparison, Trial, trial
from holdfast.checking import at, validated
from holdfast.errors import ScenarioError, suggestion
from holdfast.scenario import Scenario, composed
from holdfast.schema import AlterationSpec, CompareSpec, ScenarioSpec
from holdfast.sources import read_tables, scenario_names, scenario_title

LAW_TABLES = ("law", "redesign", "tracking", "safeguard", "observer", "safety")
"""What makes the law of a scenario."""


def compare(
    name: str,
    laws: Sequence[str] | None = None,
    cases: Sequence[str] | None = None,
    *,
    overrides: Iterable[str] = (),
    runs: int | None = None,
    seed: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Comparison:
    """Every law in every case of the scenario of that name or file.

    laws: names in its table [compare.laws], its own name for its own law, or the names or files
    of other scenarios, whose law is taken; by default its own and all of the table. cases: names
    in [compare.cases], by default all, or the scenario as it is where there are none. runs: how
    many starts, by default [compare] runs, or the scenario's. progress: called with what is
    worked on and the finished fraction.

    Raises `ScenarioError` for unknown names and for a law or a case that cannot be composed.
    """
    shown, text, data = read_tables(name, [*overrides])
    base = validated(ScenarioSpec, data, shown)
    if base.region is None or base.goal is None:
        raise ScenarioError(f"{shown}: a comparison needs a [region] and a [goal]")
    own = scenario_title(shown)
    known = _known_laws(own, base.compare)
    chosen = {n: known.get(n) or _of_scenario(shown, n, known) for n in laws or known}
    table = base.compare.cases or {"as it is": AlterationSpec()}
    for case in cases or ():
        if case not in table:
            raise ScenarioError(
                f"{shown}: [compare.cases] has no '{case}'", remedy=suggestion(case, table)
            )
    picked = {n: table[n] for n in cases or table}
    if not all(len(set(given)) == len(given) for given in (laws or (), cases or ())):
        raise ScenarioError(f"{shown}: a law or a case is named twice")
    wanted = runs if runs is not None else base.compare.runs
    trials: list[Trial] = []
    total = len(chosen) * len(picked)
    for case, alteration in picked.items():
        for law, change in chosen.items():
            what = f"{law}, {case}"

            def tell(fraction: float, what: str = what) -> None:
                if progress is not None:
                    progress(what, (len(trials) + fraction) / total)

            tell(0.0)
            with at(shown, f"compare: {what}"):
                altered = _altered(_altered(data, change), alteration)
                scenario = _composed(shown, text, altered, wanted, seed)
                trials.append(trial(law, case, scenario.run(tell), scenario.plane))
    titles = {n: c.title or n.replace("_", " ") for n, c in chosen.items()}
    return Comparison(
        title=base.scenario.title,
        scenario=own,
        laws=titles,
        cases={n: c.title or n for n, c in picked.items()},
        trials=tuple(trials),
        horizon=float(scenario.settings["horizon"]),
        seed=int(scenario.settings["seed"]),
    )


def variant(name: str, law: str, case: str | None = None, runs: int | None = None) -> Scenario:
    """The scenario of that name with one law of its comparison, in one of its cases.

    Raises `ScenarioError` for an unknown law or case.
    """
    shown, text, data = read_tables(name)
    base = validated(ScenarioSpec, data, shown)
    known = _known_laws(scenario_title(shown), base.compare)
    data = _altered(data, known.get(law) or _of_scenario(shown, law, known))
    if case is not None:
        if case not in base.compare.cases:
            raise ScenarioError(
                f"{shown}: [compare.cases] has no '{case}'",
                remedy=suggestion(case, base.compare.cases),
            )
        data = _altered(data, base.compare.cases[case])
    return _composed(shown, text, data, runs, None)


def _known_laws(own: str, spec: CompareSpec) -> dict[str, AlterationSpec]:
    return {own: AlterationSpec(title=spec.title or f"law of {own}"), **spec.laws}


def _of_scenario(file: str, name: str, known: Mapping[str, Any]) -> AlterationSpec:
    """The law of another scenario as an alteration of this one."""
    if name not in scenario_names() and not name.endswith(".toml"):
        raise ScenarioError(
            f"{file}: no law '{name}' to compare",
            expected="a name in [compare.laws], or a scenario whose law is taken",
            remedy=suggestion(name, [*known, *scenario_names()]),
        )
    _, _, data = read_tables(name)
    taken = {n: data[n] for n in LAW_TABLES if n in data}
    return AlterationSpec.model_validate(
        {"title": f"law of {scenario_title(name)}", "without": list(LAW_TABLES), **taken}
    )


def _altered(data: Mapping[str, Any], change: AlterationSpec) -> dict[str, Any]:
    """The tables without those to leave out, and with what is given merged in."""
    result = {n: copy.deepcopy(t) for n, t in data.items() if n not in change.without}
    _merge(result, change.model_extra or {})
    return result


def _merge(into: dict[str, Any], given: Mapping[str, Any]) -> None:
    for name, value in given.items():
        if isinstance(value, Mapping) and isinstance(into.get(name), dict):
            _merge(into[name], value)
        else:
            into[name] = copy.deepcopy(value)


def _composed(
    shown: str, text: str, data: Mapping[str, Any], runs: int | None, seed: int | None
) -> Scenario:
    left = {n: t for n, t in data.items() if n not in ("compare", "reference", "figures")}
    spec = validated(ScenarioSpec, left, shown)
    if seed is not None:
        spec = spec.model_copy(update={"run": spec.run.model_copy(update={"seed": seed})})
    return composed(shown, text, spec, runs)
