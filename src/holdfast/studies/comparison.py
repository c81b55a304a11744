"""Comparison of several laws in several cases from the same starts (`[compare]`).

[compare] kernel is the reference kernel, whose starts some law can keep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import decided
from holdfast.analysis.simulation.law_comparison import Comparison, Reference, Trial, trial
from holdfast.arguments import checked
from holdfast.errors import HoldfastError, ScenarioError, check_name, suggestion
from holdfast.execution.arrays import Array
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.numeric import Expression, Values, constant
from holdfast.scenario.build.kernel import depth_inside
from holdfast.scenario.files import (
    Overrides,
    changes_of,
    is_scenario,
    merged,
    read_tables,
    scenario_names,
    scenario_title,
)
from holdfast.scenario.kernel_reference import NamedKernel, named_kernel
from holdfast.scenario.kinds import STANDARD, kind_of
from holdfast.scenario.kinds.closed_loop import Scenario, check_kernels, composed
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import check_overrides
from holdfast.scenario.schema.closed_loop import AlterationSpec, CompareSpec, ScenarioSpec
from holdfast.scenario.schema.values import at, validated

JUDGES = ("viability-kernel", "discriminating-kernel")


@dataclass(frozen=True)
class Judge:
    """The kernel of [compare], and the least depth of counted starts (None: one cell)."""

    name: str
    margin: float | None

    def value(
        self, tables: Mapping[str, Any], scenarios: Sequence[Scenario], progress: Progress
    ) -> tuple[ValueFunction | None, str]:
        """The kernel of a case with these tables, or the reason why it does not apply."""
        try:
            kernel = named_kernel(self.name, tables["system"], tables.get("kernels"))
        except ScenarioError as error:
            return None, error.cause
        for scenario in scenarios:
            if reason := _not_followed(kernel, scenario):
                return None, reason
        value = kernel.value(progress)
        deepest = float(value.values().max())
        if self.margin is None and 0 < deepest <= (cell := self._margin(value)):
            raise ScenarioError(
                f"no state of the kernel is inside by a cell, {cell:.3g} {value.report.value_unit}",
                expected=f"[compare] margin below {deepest:.3g}",
            )
        for scenario in scenarios:
            try:
                decided(scenario.system, value)
                kernel.check_horizon(value, float(scenario.settings["horizon"]))
            except HoldfastError as error:
                return None, error.cause
        return value, ""

    def _margin(self, value: ValueFunction) -> float:
        return value.report.cell if self.margin is None else self.margin

    def reference(self, value: ValueFunction, starts: Array) -> Reference:
        """The kernel's values at the starts, whose shape is (starts, states)."""
        report = value.report
        return Reference(
            kernel=scenario_title(self.name),
            value=value.at(starts),
            margin=self._margin(value),
            unit=report.value_unit,
            horizon=math.inf if report.converged else report.horizon_s,
        )


def composed_judge(file: str, spec: ScenarioSpec) -> Judge | None:
    """[compare] kernel and margin; `ScenarioError` if it is not a kernel of this system."""
    table = spec.compare
    if table.kernel is None:
        if table.margin is not None:
            raise ScenarioError(f"{file}: compare.margin: needs compare.kernel")
        return None
    with at(file, "compare.kernel"):
        kernel = named_kernel(table.kernel, spec.system, spec.kernels).scenario
        if kernel is None or kernel.kind not in JUDGES:
            raise ScenarioError(
                f"got '{table.kernel}'", expected="a scenario that is a " + " or a ".join(JUDGES)
            )
    margin = None
    if table.margin is not None:
        with at(file, "compare.margin"):
            margin = depth_inside(table.margin, kernel.about)
            if not margin >= 0:
                raise ScenarioError(f"got {margin:g}", expected="a number, at least 0")
    return Judge(table.kernel, margin)


def _not_followed(kernel: NamedKernel, scenario: Scenario) -> str:
    """The reason why this kernel does not apply to the scenario's plant, or an empty text.

    Measurements (noise, delay, an observer) do not matter: they do not change the viable states.
    """
    solved = kernel.scenario
    assert isinstance(solved, KernelScenario)
    if scenario.varied:
        return "it is varied from run to run"
    if scenario.plant:
        return "the vehicle is not that of [system], for which the kernel is computed"
    if solved.system.state_names != scenario.system.state_names:
        return "the states are " + ", ".join(scenario.system.state_names)
    assert scenario.region is not None
    if _said(solved.about, solved.system) != _said(scenario.region, scenario.system):
        return f"the kernel belongs to another region, '{solved.about.name}'"
    numbers: Mapping[str, float] = solved.options.get("disturbance", {})
    for name, number in numbers.items():
        if constant(scenario.disturbance.get(name, 0)) != number:
            return f"{name} is not {number:g}, the value of the kernel"
    return ""


def _said(region: Region, system: System) -> tuple[Expression, Values]:
    """The definition of a set of states: its margin, and the numbers in it."""
    values = {q.symbol: q.value for q in (*system.parameters, *region.parameters)}
    return region.margin, {s: v for s, v in values.items() if s in region.margin.free_symbols}


LAW_TABLES = ("law", "redesign", "tracking", "safeguard", "observer", "safety")
"""The tables that define the law of a scenario."""


@checked
def compare(
    name: str,
    laws: Sequence[str] | None = None,
    cases: Sequence[str] | None = None,
    *,
    overrides: Overrides = (),
    runs: int | None = None,
    seed: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Comparison:
    """Every law in every case of the scenario of that name or file.

    laws: names in its table [compare.laws], its own name for its own law, or the names or files
    of other scenarios, whose law is taken; by default its own and all of the table. cases: names
    in [compare.cases], by default all, or the unchanged scenario without that table. runs: the
    number of starts, by default [compare] runs, or the scenario's. progress: called with a label of
    the current work and the finished fraction. With [compare] kernel the starts of every case are
    classified by that kernel for the system of the case, if the kernel applies to it.

    Raises `ScenarioError` for unknown names and for a law or a case that cannot be composed.

    >>> few = {"overrides": ["run.horizon=0.5"], "runs": 1}
    >>> list(hf.compare("wheeled_camera", ["wheeled_camera"], **few).laws)
    ['wheeled_camera']
    """
    changes = changes_of(overrides)
    shown, text, data = read_tables(name, changes)
    if kind_of(shown, data).name != STANDARD:
        raise ScenarioError(
            f"{shown}: laws are compared in closed loops that run from many starts",
            expected=f"a scenario of kind '{STANDARD}'",
        )
    base = validated(ScenarioSpec, data, shown)
    check_kernels(shown, data)
    if base.region is None:
        raise ScenarioError(f"{shown}: a comparison needs a [region]")
    own_name = scenario_title(shown)
    by_law = _known_laws(own_name, base.compare)
    for what, names in (("laws", laws), ("cases", cases)):
        if names is not None and (isinstance(names, str) or not len(names)):
            raise ScenarioError(f"{what} is {names!r}", expected="a list of names, or None for all")
    laws, cases = (None if names is None else list(names) for names in (laws, cases))
    chosen = {n: by_law.get(n) or _of_scenario(shown, n, by_law) for n in laws or by_law}
    table = base.compare.cases or {"as it is": AlterationSpec()}
    for case in cases or ():
        check_name(case, table, ScenarioError, f"{shown}: [compare.cases] has no '{case}'")
    picked = {n: table[n] for n in cases or table}
    if not all(len(set(names)) == len(names) for names in (laws or (), cases or ())):
        raise ScenarioError(f"{shown}: a law or a case is named twice")
    judge = composed_judge(shown, base)
    wanted = runs if runs is not None else base.compare.runs
    trials: list[Trial] = []
    references: dict[str, Reference] = {}
    unjudged: dict[str, str] = {}
    total = len(chosen) * len(picked)

    def telling(what: str) -> Progress:
        def tell(fraction: float) -> None:
            if progress is not None:
                progress(what, (len(trials) + fraction) / total)

        tell(0.0)
        return tell

    def in_case(tables: Mapping[str, Any], case: str) -> dict[str, Scenario]:
        made = {}
        for law, change in chosen.items():
            with at(shown, f"compare: {law}, {case}"):
                altered = _altered(_altered(tables, change), picked[case])
                made[law] = _composed(shown, text, altered, wanted, seed)
        return made

    def every(changes: Sequence[str]) -> list[Scenario]:
        tables = read_tables(name, changes)[2]
        return [one for case in picked for one in in_case(tables, case).values()]

    def alone(changes: Sequence[str]) -> list[Scenario]:
        return [_composed(shown, text, read_tables(name, changes)[2], wanted, seed)]

    try:
        check_overrides(changes, alone(changes), alone)
    except ScenarioError:  # another law or case may depend on it
        check_overrides(changes, every(changes), every)
    for case, alteration in picked.items():
        scenarios = in_case(data, case)
        value, tables = None, _altered(data, alteration)
        if judge is not None:
            with at(shown, f"compare: kernel, {case}"):
                tell = telling(f"kernel, {case}")
                value, reason = judge.value(tables, list(scenarios.values()), tell)
            if value is None:
                unjudged[case] = reason
        for law, scenario in scenarios.items():
            with at(shown, f"compare: {law}, {case}"):
                result = scenario.run(telling(f"{law}, {case}"))
            trials.append(trial(law, case, result, scenario.plane))
        if judge is not None and value is not None:
            starts = result.arrays["state"].values[:, 0]
            references[case] = judge.reference(value, starts)
    titles = {n: c.title or n.replace("_", " ") for n, c in chosen.items()}
    return Comparison(
        title=base.scenario.title,
        scenario=own_name,
        laws=titles,
        cases={n: c.title or n for n, c in picked.items()},
        trials=tuple(trials),
        horizon=float(scenario.settings["horizon"]),
        seed=int(scenario.settings["seed"]),
        to_goal=base.goal is not None,
        references=references,
        unjudged=unjudged,
    )


def variant(
    name: str,
    law: str,
    case: str | None = None,
    runs: int | None = None,
    overrides: Iterable[str] = (),
) -> Scenario:
    """The scenario of that name with one law of its comparison, in one of its cases.

    overrides: `key=value`, applied before the law and the case.

    Raises `ScenarioError` for an unknown law or case.
    """
    shown, text, data = read_tables(name, [*overrides])
    base = validated(ScenarioSpec, data, shown)
    by_law = _known_laws(scenario_title(shown), base.compare)
    data = _altered(data, by_law.get(law) or _of_scenario(shown, law, by_law))
    if case is not None:
        data = in_case(shown, data, case)
    return _composed(shown, text, data, runs, None)


def in_case(shown: str, data: Mapping[str, Any], case: str) -> dict[str, Any]:
    """The tables of a scenario in one of the cases of its comparison; `ScenarioError` for none."""
    cases = validated(ScenarioSpec, data, shown).compare.cases
    check_name(case, cases, ScenarioError, f"{shown}: [compare.cases] has no '{case}'")
    return _altered(data, cases[case])


def _known_laws(name: str, spec: CompareSpec) -> dict[str, AlterationSpec]:
    return {name: AlterationSpec(title=spec.title or f"law of {name}"), **spec.laws}


def _of_scenario(file: str, name: str, by_law: Mapping[str, Any]) -> AlterationSpec:
    """The law of another scenario as an alteration of this one."""
    if not is_scenario(name):
        raise ScenarioError(
            f"{file}: no law '{name}' to compare",
            expected="a name in [compare.laws], or a scenario whose law is taken",
            remedy=suggestion(name, [*by_law, *scenario_names()]),
        )
    _, _, data = read_tables(name)
    taken = {n: data[n] for n in (*LAW_TABLES, "kernels") if n in data}
    return AlterationSpec.model_validate(
        {"title": f"law of {scenario_title(name)}", "without": list(LAW_TABLES), **taken}
    )


def _altered(data: Mapping[str, Any], change: AlterationSpec) -> dict[str, Any]:
    """The tables without the removed ones, and with the given ones merged in."""
    left = {n: t for n, t in data.items() if n not in change.without}
    return merged(left, change.model_extra or {})


def _composed(
    shown: str, text: str, data: Mapping[str, Any], runs: int | None, seed: int | None
) -> Scenario:
    left = {n: t for n, t in data.items() if n not in ("compare", "reference", "figures")}
    spec = validated(ScenarioSpec, left, shown)
    if seed is not None:
        spec = spec.model_copy(update={"run": spec.run.model_copy(update={"seed": seed})})
    return composed(shown, text, spec, runs)
