"""Scenario files with [decompose]: a set put together from those of parts, and tried.

What scenarios that ask for a set of states share stands here: on one grid, or put together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from holdfast.analysis.decomposition.decompose import decompose, solve_parts
from holdfast.analysis.decomposition.decomposition import Decomposition
from holdfast.analysis.decomposition.parts_law import (
    PartsPromise,
    box_of_starts,
    check_parts,
    default_parts_promise,
)
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.analysis.simulation.law_comparison import Entry
from holdfast.errors import ScenarioError, SimulationError
from holdfast.execution.resources import Progress
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region, drawn_shapes
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.scenario.build.kernel import Apart
from holdfast.scenario.kinds.base import Bar, Composed
from holdfast.scenario.schema.kernel import SetFiguresSpec
from holdfast.scenario.schema.values import at


@dataclass(frozen=True, eq=False, repr=False)
class SetScenario(Composed):
    """A composed scenario whose answer is a set of states.

    options: of the march. promised: of the trials in closed loop, by 0 runs left out; None: a
    kernel is tried by default. certificate: arguments of `hf.certify` that the file has.
    held: of a figure, the values of the states that are not drawn.
    """

    name: str
    file: str
    text: str
    title: str
    kind: str
    description: str
    source: str
    system: System
    region: Region | None
    goal: Region | None
    origin: Region | None
    law: Law | Switching | None
    horizon: float
    forever: bool
    inner: bool
    options: Mapping[str, Any]
    promised: Mapping[str, Any] | None
    certificate: Mapping[str, Any]
    figures: SetFiguresSpec
    held: Mapping[str, float]

    @property
    def by_default(self) -> bool:
        """Whether its promise is tried although the file does not ask for it."""
        return self.promised is None and self.kind in ("viability-kernel", "discriminating-kernel")

    @property
    def trials(self) -> Mapping[str, Any] | None:
        """The trials that the file asks for."""
        return self.promised if self.promised and self.promised["runs"] else None

    @property
    def about(self) -> Region:
        """The value function that the march begins with."""
        region = self.goal or self.origin or self.region
        assert region is not None
        return region

    @property
    def drawn_around(self) -> dict[str, Any]:
        """Of its figures: the shapes of the region and of what the set leads to, the inequalities
        within which it leads there, and parameters."""
        regions = [r for r in (self.region, self.goal, self.origin) if r is not None]
        within = None if self.region is self.about else self.region
        about = (shape for r in regions if r is not within for shape in r.scene)
        return {
            "scene": (*about, *drawn_shapes(within, None)),
            "parameters": {q.name: q.value for r in regions for q in r.parameters},
        }

    def trouble(self, answer: Any) -> str:
        trouble: str = answer.trouble
        return trouble

    def on_device(self, device: str) -> Self:
        return replace(self, options={**self.options, "device": device})

    def marched_on(self, *, cluster: Any = None, on_disk: Path | None = None) -> Self:
        choices = {"cluster": cluster, "on_disk": on_disk}
        chosen = {k: v for k, v in choices.items() if v is not None}
        return replace(self, options={**self.options, **chosen})

    @property
    def uses_all_cores(self) -> bool:
        return True

    @property
    def seed(self) -> int:
        return int((self.promised or {}).get("seed", 0))

    @property
    def given(self) -> Mapping[str, Any]:
        disturbance: Mapping[str, Any] = self.options.get("disturbance", {})
        return disturbance


@dataclass(frozen=True)
class PartsResult:
    """The value that is put together, and what its promise came to, where it was tried."""

    value: PartsValue
    promise: PartsPromise | None
    trouble: str = ""

    def save(self, path: Path) -> Path:
        return self.value.save(path)

    def summary(self) -> dict[str, Any]:
        """For summary.json."""
        whole = self.value.decomposition
        parts = [
            {"states": list(s.value.names), "coordinates": _texts(s.part.coordinates), "set": v}
            for s, v in ((s, s.value.summary()) for parts in self.value.parts for s in parts)
        ]
        table: dict[str, Any] = {
            "verdict": whole.verdict,
            "guarantee": whole.guarantee,
            "reasons": list(whole.reasons),
            "parts": parts,
        }
        return table | ({"promise": self.promise.summary()} if self.promise else {})


def _told(whole: Decomposition, number: int) -> str:
    """The system, and what a figure of one of its parts shows of it."""
    said = [whole.verdict]
    if len(whole.parts) > 1:
        said.append(f"part {number} of {len(whole.parts)}")
    if whole.prediction is not None:
        said.append("over predicted states")
    return f"{whole.system.name}\n{', '.join(said)}"


def _texts(table: Mapping[str, Any]) -> dict[str, str]:
    return {n: str(e) for n, e in table.items()}


@dataclass(frozen=True, eq=False, repr=False)
class PartsScenario(SetScenario):
    """A composed scenario whose answer is a value put together from those of parts."""

    apart: Apart

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.inner:
            raise ScenarioError(
                f"{self.file}: march.inner: of a set that is put together", remedy="leave it out"
            )
        if self.promised is not None and self.kind not in (
            "viability-kernel",
            "discriminating-kernel",
        ):
            raise ScenarioError(
                f"{self.file}: promise: of a {self.kind} that is put together",
                expected="a kernel, whose states stay",
                remedy="leave it out",
            )
        if isinstance(self.law, Switching):
            raise ScenarioError(f"{self.file}: law: a law with modes", expected="one with one mode")

    @cached_property
    def decomposition(self) -> Decomposition:
        """The parts; `ScenarioError` for what would not be sound."""
        how = self.apart
        with at(self.file, "decompose"):
            return decompose(
                self.system,
                self.region or (None if self.goal else self.origin),
                kind=self.kind,
                goal=self.goal if self.kind == "capture-basin" else None,
                disturbances=self.options.get("disturbances", "min"),
                disturbance=self.options.get("disturbance"),
                box=how.grid["box"] if "lag_share" in how.how else None,
                **how.how,
            )

    def run(self, progress: Progress | None = None) -> PartsResult:
        """The value, and its promise tried in closed loop."""
        over, options = dict(self.apart.grid), dict(self.options)
        box = over.pop("box")
        for key in ("disturbance", "disturbances"):
            options.pop(key, None)
        with at(self.file, "march"):
            value = solve_parts(
                self.decomposition,
                None if "lag_share" in self.apart.how else box,
                horizon=self.horizon,
                progress=progress,
                **over,
                **options,
            ).reported(title=self.title, scenario=self.name, scenario_text=self.text)
        if self.region is None or (self.trials is None and not self.by_default):
            return PartsResult(value, None)
        if self.trials is None:
            return self._tried_by_default(value)
        tried = {"horizon": self.horizon, **self.trials}
        try:
            with at(self.file, "promise"):
                promise = check_parts(
                    value,
                    self.region,
                    box_of_starts(value),
                    law=self.law if isinstance(self.law, Law) else None,
                    disturbance=self.options.get("disturbance"),
                    **tried,
                )
        except ScenarioError as error:  # the marches were long: their values are not thrown away
            return PartsResult(value, None, str(error))
        return PartsResult(value.tried(promise), promise)

    def _tried_by_default(self, value: PartsValue) -> PartsResult:
        """For about a second; what cannot be tried was not asked for."""
        try:
            promise = default_parts_promise(value)
        except SimulationError:
            return PartsResult(value, None)
        return PartsResult(value if promise is None else value.tried(promise), promise)

    def drawn(self, answer: PartsResult, folder: Path, bar: Bar | None) -> list[Path]:
        """The set of every part."""
        from holdfast.presentation.figures import style
        from holdfast.presentation.figures.value_function import value_function_figure

        files, whole = [], answer.value.decomposition
        alike = {k: v for k, v in self.options.items() if k in ("band", "precision")}
        for k, (part, value) in enumerate(zip(whole.parts, answer.value.values, strict=True), 1):
            plane = self.figures.plane
            if plane is not None and not set(plane) <= set(value.names):
                plane = None
            held = {n: v for n, v in self.held.items() if n in value.names}
            in_states = set(plane or value.names[:2]) <= set(whole.system.state_names)
            begun = set_on_grid(part.about, value.grid, **alike)
            drawn = value_function_figure(
                value.reported(system=_told(whole, k)),
                plane=plane,
                at=held or None,
                others={part.about.name.replace("_", " "): begun},
                **(self.drawn_around if in_states else {}),
            )
            files += style.write(drawn, folder, f"set_{k}")
        return files

    def report(self, answer: PartsResult, files: Sequence[Path]) -> str:
        from holdfast.presentation.text.values import parts_text

        return parts_text(self.title, answer.value, answer.promise, list(files))

    def complaints(self, answer: PartsResult) -> list[str]:
        said = [answer.trouble] if answer.trouble else []
        if answer.promise is not None and answer.promise.verdict:
            said.append(answer.promise.verdict)
        if self.forever and not answer.value.converged:
            said.append(
                f"the infinite-horizon set was requested, and a march did not converge within "
                f"{self.horizon:g} s; raise march.horizon"
            )
        return said

    def tally(self, part: range | None, threads: int) -> dict[str, Entry]:
        """The sizes of the sets of the parts, and the result of the promise."""
        answer = self.run()
        entries = {
            f"fraction_{k}": Entry(
                "most", float(v.fraction()), 0.0, "1", "share of the part's grid in its set"
            )
            for k, v in enumerate(answer.value.values, 1)
        }
        if (promise := answer.promise) is not None:
            for name, rate, says in (
                ("promised", promise.promised, "share of the region's states that is promised"),
                ("kept", promise.inside, "share kept inside the set"),
            ):
                entries[name] = Entry("share", rate.count, rate.total, "1", says)
        return entries
