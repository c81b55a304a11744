"""Reproduction of the thesis: every claim is run and judged (`holdfast reproduce`)."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from holdfast.errors import HoldfastError, ScenarioError
from holdfast.host.files import code_digest, make_folder, write_text
from holdfast.scenario.files import files_digest
from holdfast.scenario.schema.claims import ChapterSpec, ClaimSpec, TrialSpec
from holdfast.scenario.schema.values import at, validated
from holdfast.studies.process_pool import answers, processes

CHAPTERS = (2, 3, 4, 5, 6, 7)
DONE = "trial.json"

HOLDS, CONDITION, FAILS = "holds", "holds with a condition", "does not hold"


@dataclass(frozen=True)
class Found:
    """The result of a trial: its number, and the folder of its figures; `trouble` after a failure.

    refusal: the error with which holdfast refuses to run it, if the record expects one.
    """

    number: float | None
    folder: Path
    figures: tuple[str, ...] = ()
    trouble: str = ""
    refusal: str = ""

    def within(self, spec: TrialSpec) -> bool:
        """Whether the claim holds in the trial."""
        low, high = spec.needs
        return self.number is not None and low <= self.number <= high

    def as_recorded(self, spec: TrialSpec) -> bool:
        """Whether the number, or the refusal, agrees with the record."""
        if spec.refused:
            return bool(self.refusal)
        return self.number is not None and abs(self.number - spec.recorded) <= spec.within


@dataclass(frozen=True)
class Judged:
    """A claim with the results of its trials."""

    chapter: int
    claim: ClaimSpec
    stated: Found
    conditioned: Found | None

    @property
    def trials(self) -> tuple[tuple[TrialSpec, Found], ...]:
        """The specification of every trial, and its result."""
        pairs = [(self.claim.stated, self.stated)]
        if self.claim.conditioned is not None and self.conditioned is not None:
            pairs.append((self.claim.conditioned, self.conditioned))
        return tuple(pairs)

    @property
    def verdict(self) -> str:
        """The verdict from the numbers; "" without numbers."""
        if any(outcome.trouble for _, outcome in self.trials):
            return ""
        holds = [outcome.within(spec) for spec, outcome in self.trials]
        if holds[0]:
            return HOLDS
        return CONDITION if any(holds) else FAILS

    @property
    def problems(self) -> tuple[str, ...]:
        """The differences from the record."""
        said = [outcome.trouble for _, outcome in self.trials if outcome.trouble]
        if said:
            return tuple(said)
        if self.verdict != self.claim.verdict:
            said.append(f"{self.verdict}, recorded: {self.claim.verdict}")
        said += [
            "it is not refused"
            if spec.refused
            else f"{outcome.number:.6g}, recorded: {spec.recorded:g} +- {spec.within:g}"
            for spec, outcome in self.trials
            if not outcome.as_recorded(spec)
        ]
        return tuple(said)


def chapter(number: int) -> ChapterSpec:
    """The claims of a chapter; `ScenarioError` for a chapter without claims."""
    if number not in CHAPTERS:
        raise ScenarioError(f"chapter {number} has no claims", expected=f"one of {CHAPTERS}")
    name = f"chapter-{number}.toml"
    text = (resources.files("holdfast.studies.thesis") / name).read_text("utf-8")
    return validated(ChapterSpec, tomllib.loads(text), name)


def reproduce(
    folder: Path,
    chapters: Sequence[int] = CHAPTERS,
    *,
    quick: bool = False,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Judged, ...]:
    """Every claim of the chapters, judged by its trials; quick: only trials of a few seconds.

    Trials run in `workers` processes, by default one for every core. The result of a trial is kept
    in a separate folder below `folder`, named by the digest of the trial and of the code: a second
    call, after an interruption or not, runs only the missing ones.

    `Judged.problems` lists trials that are refused or fail. Raises `ScenarioError` for a chapter
    without claims, `OutputError` for a folder that cannot be written, and if the operating system
    killed a process.
    """
    chosen = dict.fromkeys(chapters)
    claims = [(n, c) for n in chosen for c in chapter(n).claims if c.quick or not quick]
    wanted = {digest(spec): spec for _, claim in claims for spec in _trials(claim)}
    places = {key: folder / "trials" / key for key in wanted}
    missing = {key: spec for key, spec in wanted.items() if not (places[key] / DONE).exists()}
    make_folder(folder / "trials")
    total = len(wanted)

    def tell(what: str) -> None:
        if progress is not None:
            done = total - len(missing)
            progress(what, done / total)

    tell("reproducing")
    if missing:
        count = min(workers or os.cpu_count() or 1, len(missing))
        asked = [  # the last chapters take longest and start first
            (key, (missing[key].model_dump(), places[key])) for key in reversed(missing)
        ]
        with processes(count) as pool:
            for key, _ in answers(pool, _run, asked, len(asked), lambda: tell("reproducing")):
                name = missing.pop(key).scenario
                tell(name or "reproducing")
    outcomes = {key: _read(place) for key, place in places.items()}
    return tuple(
        Judged(
            number,
            claim,
            outcomes[digest(claim.stated)],
            outcomes[digest(claim.conditioned)] if claim.conditioned is not None else None,
        )
        for number, claim in claims
    )


def _trials(claim: ClaimSpec) -> Iterator[TrialSpec]:
    yield claim.stated
    if claim.conditioned is not None:
        yield claim.conditioned


def digest(spec: TrialSpec) -> str:
    """The digest of a trial's result: of its specification, of the code and of its files."""
    asked = spec.model_dump(
        include={"scenario", "set", "runs", "function", "arguments", "number", "refused"}
    )
    text = code_digest() + files_digest() + json.dumps(asked, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


# -- one trial, in a worker process -----------------------------------------------------------


def _run(asked: tuple[Mapping[str, Any], Path]) -> None:
    run_trial(*asked)


def run_trial(asked: Mapping[str, Any], folder: Path) -> None:
    """Run the trial, draw its figures, and write its result; a refusal is written too."""
    spec = TrialSpec.model_validate(asked)
    make_folder(folder)
    said: dict[str, Any] = {"number": None, "figures": [], "trouble": "", "refusal": ""}
    try:
        if spec.scenario is not None:
            summary = _run_scenario(spec.scenario, spec.set, spec.runs, folder)
            said["figures"] = sorted(p.stem for p in folder.glob("*.png"))
            said["number"] = number_in(summary, spec.number)
        else:
            assert spec.function is not None
            said["number"] = number_in(_called(spec.function, spec.arguments), spec.number)
    except HoldfastError as error:
        awaited = spec.refused and spec.refused in str(error)
        said["refusal" if awaited else "trouble"] = str(error)
    except Exception as error:  # a failing trial must not end the others
        said["trouble"] = f"{type(error).__name__}: {error}"
    write_text(folder / DONE, json.dumps(said, indent=2) + "\n")


def _run_scenario(name: str, changes: list[str], runs: int | None, folder: Path) -> dict[str, Any]:
    from holdfast.scenario.load import load_scenario

    scenario = load_scenario(name, changes, runs)
    answer = scenario.run()
    scenario.write(answer, folder)
    if trouble := scenario.trouble(answer):
        raise ScenarioError(trouble)
    if (drawn := scenario.interactive(answer)) is not None:
        write_text(folder / "interactive.json", json.dumps(drawn))
    summary: dict[str, Any] = answer.summary()
    return summary


def _called(function: str, arguments: Mapping[str, Any]) -> object:
    module, _, name = function.rpartition(".")
    place = f"holdfast.{module}" if module else "holdfast"
    return getattr(importlib.import_module(place), name)(**arguments)


def number_in(said: object, where: str) -> float:
    """The number at names joined by dots, of a table or of an object; a / b divides two of them."""
    with at("claim", where or "number"):
        number, *others = [_leaf(said, part.strip()) for part in where.split(" / ")]
        for other in others:
            if not other:
                raise ScenarioError("a division by zero")
            number /= other
        return number


def _leaf(said: object, where: str) -> float:
    for name in where.split(".") if where else ():
        if isinstance(said, Mapping):
            names, inner = list(said), said.get(name)
        elif isinstance(said, Sequence):
            names = [str(i) for i in range(len(said))]
            inner = said[int(name)] if name in names else None
        else:
            names, inner = [], getattr(said, name, None)
        if inner is None:
            raise ScenarioError(f"unknown name '{name}'", expected=", ".join(map(str, names)))
        said = inner
    if not isinstance(said, int | float):
        raise ScenarioError(f"{said!r} is not a number")
    return float(said)


def _read(place: Path) -> Found:
    said = json.loads((place / DONE).read_text("utf-8"))
    figures = tuple(said["figures"])
    return Found(said["number"], place, figures, said["trouble"], said["refusal"])
