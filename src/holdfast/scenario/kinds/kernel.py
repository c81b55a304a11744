"""Scenario files that ask for a kernel, a reachable set or a basin: composed, solved, tried."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.posed_march import finer
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.promise import Promise
from holdfast.analysis.safety.safety_filter import FORMER
from holdfast.analysis.safety.validation import check_promise, default_promise
from holdfast.analysis.simulation.law_comparison import Entry
from holdfast.errors import RenamedWarning, ScenarioError, SimulationError
from holdfast.execution.resources import Progress, check_trials
from holdfast.maths.definitions.region import Region
from holdfast.scenario.build.kernel import kernel_parts
from holdfast.scenario.files import overridden
from holdfast.scenario.kinds import kind_of
from holdfast.scenario.kinds.base import Bar, Kind
from holdfast.scenario.kinds.parts import PartsScenario, SetScenario
from holdfast.scenario.schema.kernel import ASKED, PROBLEMS
from holdfast.scenario.schema.values import at


@dataclass(frozen=True)
class KernelResult:
    """The value function, and whether its promise was kept, where it was tried.

    trouble: why it could not be tried, where it was asked for; untried: why it was not.
    """

    value: ValueFunction
    promise: Promise | None
    trouble: str = ""
    untried: str = ""

    def _repr_html_(self) -> str:
        return self.value._repr_html_()

    def save(self, path: Path) -> Path:
        return self.value.save(path)

    def answers(self, scenario: KernelScenario) -> bool:
        """Whether the set asked for was found: one that lasts is there once the march converged.

        A kernel of which nothing is left stays empty.
        """
        report = self.value.report
        gone = report.empty and scenario.kind.endswith("kernel")
        return not scenario.forever or report.converged or gone

    def summary(self) -> dict[str, Any]:
        """For summary.json."""
        tried = {"promise": self.promise.summary()} if self.promise else {}
        return {**self.value.summary(), **tried}


@dataclass(frozen=True, eq=False, repr=False)
class KernelScenario(SetScenario):
    """A composed scenario whose answer is a value function."""

    grid: Grid

    def solve(self, progress: Progress | None = None) -> ValueFunction:
        """The value function alone."""
        about: tuple[Region | None, ...] = (self.about,)
        if self.kind == "capture-basin":
            about = (self.goal, self.region)
        with at(self.file, "march", self.text):
            value = ASKED[self.kind](
                self.system, *about, self.grid, self.horizon, progress=progress, **self.options
            )
            if self.inner:
                value = value.inner()
        return value.reported(title=self.title, scenario=self.name, scenario_text=self.text)

    def run(self, progress: Progress | None = None) -> KernelResult:
        """The value function, and its promise tried in closed loop."""
        return self._tried(progress, by_default=self.by_default)

    def _tried(self, progress: Progress | None, *, by_default: bool) -> KernelResult:
        trials = self.trials
        if trials is not None:
            with at(self.file, "promise"):  # before a march that may take long
                check_trials(trials["runs"], len(self.system.states))
        share = 0.6 if trials is not None else 0.9 if by_default else 1.0

        def first(fraction: float) -> None:
            if progress is not None:
                progress(share * fraction)

        def second(fraction: float) -> None:
            if progress is not None:
                progress(share + (1 - share) * fraction)

        value = self.solve(first)
        asked = by_default or trials is not None
        if not value.highest() > 0:
            why = "the set is empty and has no state to start from" if asked else ""
            return KernelResult(value, None, untried=why)
        if by_default:
            return self._tried_by_default(value, second)
        if trials is None:
            return KernelResult(value, None, untried="" if self.promised is None else "runs = 0")
        try:
            with at(self.file, "promise"):
                tried = check_promise(
                    self.system,
                    value,
                    self.region,
                    goal=self.goal,
                    law=self.law,
                    progress=second,
                    **trials,
                )
        except ScenarioError as error:  # the march was long: its value is not thrown away
            return KernelResult(value, None, str(error))
        return KernelResult(value.tried(tried), tried)

    def _tried_by_default(self, value: ValueFunction, progress: Progress) -> KernelResult:
        """For about a second; what cannot be tried is said, and was not asked for."""
        try:
            tried = default_promise(self.system, value, progress)
        except SimulationError as error:
            return KernelResult(value, None, untried=str(error))
        return KernelResult(value if tried is None else value.tried(tried), tried)

    @cached_property
    def begun(self) -> ValueFunction:
        """The value function that the march begins with, in as little memory as the march."""
        alike = {k: v for k, v in self.options.items() if k in ("band", "precision")}
        return set_on_grid(self.about, finer(self.grid, self.options.get("refine", 1)), **alike)

    def drawn(self, answer: KernelResult, folder: Path, bar: Bar | None) -> list[Path]:
        """The set, and the optimal inputs where they are asked for."""
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.value_function import value_function_figure

        around: dict[str, Any] = {
            "others": {self.about.name.replace("_", " "): self.begun},
            **self.drawn_around,
        }
        plane = self.figures.plane
        drawn = value_function_figure(answer.value, plane=plane, at=self.held or None, **around)
        files = style.write(drawn, folder, "set")
        if self.figures.inputs:
            files += style.write(self._law_figure(answer, around), folder, "law")
        return files

    def _law_figure(self, answer: KernelResult, around: dict[str, Any]) -> Any:
        """The optimal inputs in the plane of the figures; around: what is drawn beside the set."""
        from holdfast.analysis.safety.safety_filter import optimal_inputs
        from holdfast.presentation.figures.value_function import optimal_input_figure

        names = self.system.state_names
        plane = self.figures.plane or (names[0], names[1])
        held = {n: self.held.get(n, 0.0) for n in names if n not in plane}
        inputs, velocity = optimal_inputs(self.system, answer.value, plane, held)
        chosen = {n: inputs[n] for n in self.figures.inputs}
        return optimal_input_figure(answer.value, chosen, velocity, plane=plane, at=held, **around)

    def report(self, answer: KernelResult, files: Sequence[Path]) -> str:
        from holdfast.presentation.text.values import value_text

        listed = list(files)
        return value_text(answer.value, answer.promise, self.begun, listed, untried=answer.untried)

    def complaints(self, answer: KernelResult) -> list[str]:
        if answer.trouble:
            return [answer.trouble]
        said = []
        if answer.promise is not None and answer.promise.verdict:
            said.append(answer.promise.verdict)
        if not answer.answers(self):
            said.append(
                f"the infinite-horizon kernel was requested, and the march did not converge within "
                f"{self.horizon:g} s; raise march.horizon"
            )
        return said

    def interactive(self, answer: KernelResult) -> dict[str, Any] | None:
        from holdfast.presentation.html.interactive import set_data

        return set_data(answer.value)

    def tally(self, part: range | None, threads: int) -> dict[str, Entry]:
        """The size of the set, the outcome of the march, and the result of the promise."""
        answer = self._tried(None, by_default=False)
        report = answer.value.report
        numbers = (
            ("fraction", answer.value.fraction(), "1", "share of the grid in the set"),
            ("volume", answer.value.volume(), "1", "volume of the set"),
            ("answered", answer.answers(self), "1", "1 where the set asked for was found"),
            ("converged", report.converged, "1", "1 where nothing changes any more"),
            ("reached", report.reached_s, "s", "time marched"),
        )
        entries = {
            name: Entry("most", float(v), 0.0, unit, says) for name, v, unit, says in numbers
        }
        for k, trials in enumerate(answer.promise.inside if answer.promise else ()):
            says = f"share kept inside the set against {trials.what}"
            entries[f"kept_{k}"] = Entry("share", trials.kept.count, trials.kept.total, "1", says)
        return entries


def is_kernel(file: str, data: Mapping[str, Any]) -> bool:
    """Whether the tables ask for a set of states; `ScenarioError` for an unknown kind."""
    return kind_of(file, data) in KINDS


def _compose(
    file: str, text: str, data: dict[str, Any], runs: int | None, seed: int | None
) -> KernelScenario | PartsScenario:
    more = {"runs": runs, "seed": seed}
    options = {k: v for k, v in more.items() if v is not None}
    if options and "promise" not in data:
        raise ScenarioError(f"--{min(options)}: {file} has no [promise]", remedy="leave it out")
    changes = [f"promise.{k}={v}" for k, v in options.items()]
    text, data = overridden(text, data, changes)
    if "decompose" in data:
        return PartsScenario(file=file, text=text, **kernel_parts(file, data))
    return composed_kernel(file, text, data)


def composed_kernel(file: str, text: str, data: Mapping[str, Any]) -> KernelScenario:
    """The scenario of these tables; `ScenarioError` with the key for what is wrong with them."""
    if "decompose" in data:
        raise ScenarioError(
            f"{file}: decompose: a set put together from parts has no grid of all its states",
            expected="a kernel on one grid here",
            remedy="take hf.parts_law and hf.PartsValue",
        )
    return KernelScenario(file=file, text=text, **kernel_parts(file, data))


def _compose_former(
    file: str, text: str, data: dict[str, Any], runs: int | None, seed: int | None
) -> KernelScenario | PartsScenario:
    new = "backward-reachable-tube"
    warnings.warn(
        f"{file}: scenario.kind: '{FORMER}' is now '{new}'; the set at exactly the horizon is "
        "'backward-reachable-at'",
        RenamedWarning,
        stacklevel=2,
    )
    renamed = {**data, "scenario": {**data["scenario"], "kind": new}}
    return _compose(file, text, renamed, runs, seed)


KINDS = (*(Kind(name, _compose) for name in PROBLEMS), Kind(FORMER, _compose_former))
