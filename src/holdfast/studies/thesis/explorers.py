"""The pages in which the trials of the claims run: one for each scenario with its changes."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from holdfast.analysis.load import load
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import HoldfastError
from holdfast.execution.cache import code_digest
from holdfast.execution.resources import Progress
from holdfast.host.writing import make_folder, write_text
from holdfast.scenario.files import files_digest
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema.claims import TrialSpec
from holdfast.studies.exploration import page_of
from holdfast.studies.process_pool import answers, processes
from holdfast.studies.thesis.reproduce import Judged

FOLDER = "explorers"


@dataclass(frozen=True)
class Explorer:
    """The page in which a trial runs; where there is none, the reason, as a sentence."""

    page: Path | None = None
    refusal: str = ""


@dataclass(frozen=True)
class _Solved(KernelScenario):
    """A kernel that a trial has computed, and its file."""

    stored: Path = field(kw_only=True)

    def solve(self, progress: Progress | None = None) -> ValueFunction:
        found = load(self.stored)
        assert isinstance(found, ValueFunction)
        return found


def explored(spec: TrialSpec) -> str:
    """The name of the page of the trial: equal trials share one; "" without a scenario."""
    if spec.scenario is None:
        return ""
    asked = json.dumps([spec.scenario, spec.set, spec.runs])
    digest = hashlib.sha256((code_digest() + files_digest() + asked).encode()).hexdigest()
    return f"{spec.scenario}-{digest[:8]}"


def write_explorers(
    judged: Sequence[Judged],
    folder: Path,
    *,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Explorer]:
    """The page of every trial that can be explored, in a folder below `folder`, by its name.

    A page that is there already is kept. Pages are made in `workers` processes, by default one for
    every core; each file is whole or absent. Raises `OutputError` for a folder that cannot be
    written, and if the operating system killed a process.
    """
    wanted = {
        explored(spec): (spec.model_dump(), found.folder)
        for j in judged
        for spec, found in j.trials
        if spec.scenario is not None and found.number is not None
    }
    there = folder / FOLDER
    make_folder(there)
    missing = {n: asked for n, asked in wanted.items() if _read(there, n) is None}

    def tell(what: str) -> None:
        if progress is not None:
            progress(what, 1 - len(missing) / max(len(wanted), 1))

    tell("pages to drag")
    if missing:
        count = min(workers or os.cpu_count() or 1, len(missing))
        asked = list(missing.items())
        with processes(count) as pool:
            for name, (page, refusal) in answers(
                pool, _explored, asked, len(asked), lambda: tell("pages to drag")
            ):
                write_text(_refused(there, name) if refusal else _page(there, name), page + refusal)
                del missing[name]
                tell("pages to drag")
    return {name: found for name in wanted if (found := _read(there, name)) is not None}


def _page(folder: Path, name: str) -> Path:
    return folder / f"{name}.html"


def _refused(folder: Path, name: str) -> Path:
    return folder / f"{name}.txt"


def _read(folder: Path, name: str) -> Explorer | None:
    if (page := _page(folder, name)).exists():
        return Explorer(page)
    if (said := _refused(folder, name)).exists():
        return Explorer(refusal=said.read_text("utf-8"))
    return None


# -- one page, in a worker process ------------------------------------------------------------


def _explored(asked: tuple[Mapping[str, Any], Path]) -> tuple[str, str]:
    """The page of a trial with the results in this folder, and why there is none."""
    spec = TrialSpec.model_validate(asked[0])
    assert spec.scenario is not None
    try:
        loaded = load_scenario(spec.scenario, spec.set, spec.runs)
        if isinstance(loaded, KernelScenario):
            own = {f.name: getattr(loaded, f.name) for f in fields(loaded)}
            loaded = _Solved(**own, stored=asked[1] / "result.nc")
        return page_of(loaded, spec.scenario, spec.set), ""
    except HoldfastError as error:
        return "", error.cause
    except Exception as error:  # a trial that has no page must not end the report
        return "", f"{type(error).__name__}: {error}"
