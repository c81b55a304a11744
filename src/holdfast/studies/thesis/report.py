"""The report on the claims of the thesis, as one self-contained page.

The trials of the claims run in pages too: one for each scenario with its changes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any
from urllib.parse import quote

from holdfast._version import __version__
from holdfast.analysis.load import load
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import HoldfastError
from holdfast.execution.resources import Progress
from holdfast.host.files import atomic_file, code_digest, make_folder, write_text
from holdfast.presentation.html.interactive import INK
from holdfast.presentation.html.page import picture, plotly_script, rendered
from holdfast.scenario.files import files_digest, read_text
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema.claims import TrialSpec
from holdfast.studies.exploration import page_of
from holdfast.studies.process_pool import answers, processes
from holdfast.studies.thesis.reproduce import CONDITION, FAILS, HOLDS, Found, Judged, chapter

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
        value = load(self.stored)
        assert isinstance(value, ValueFunction)
        return value


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
        explored(spec): (spec.model_dump(), stored.folder)
        for j in judged
        for spec, stored in j.trials
        if spec.scenario is not None and stored.number is not None
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
    return {name: stored for name in wanted if (stored := _read(there, name)) is not None}


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
            attributes = {f.name: getattr(loaded, f.name) for f in fields(loaded)}
            loaded = _Solved(**attributes, stored=asked[1] / "result.nc")
        return page_of(loaded, spec.scenario, spec.set), ""
    except HoldfastError as error:
        return "", error.cause
    except Exception as error:  # a trial that has no page must not end the report
        return "", f"{type(error).__name__}: {error}"


SHOWN = ("map", "set", "paths", "law", "constraints", "histories")
"""Figures of a trial by name, in the order of the page."""

ROLES = "as stated", "with the condition"
"""What is tried in the trials of a claim, where they do not say it."""


def write_report(
    judged: Sequence[Judged], path: Path, explorers: Mapping[str, Explorer] | None = None
) -> Path:
    """Claims by chapter, with verdicts, numbers, figures and commands to reproduce them, as HTML.

    The page opens without a network: the script of the interactive figures is embedded. explorers:
    of `write_explorers`, to which the trials link by paths from the folder of the page.
    """
    claims = [_shown(j, path.parent, explorers or {}) for j in judged]
    chapters = [
        {
            "number": number,
            "title": chapter(number).title,
            "claims": [c for c in claims if c["chapter"] == number],
        }
        for number in sorted({j.chapter for j in judged})
    ]
    counts = {v: sum(j.verdict == v for j in judged) for v in (HOLDS, CONDITION, FAILS)}
    page = rendered(
        "report",
        plotly=plotly_script(),
        ink=INK,
        version=__version__,
        chapters=chapters,
        counts=counts,
        total=len(judged),
        differing=[c for c in claims if c["problems"]],
    )
    with atomic_file(path) as partial:
        partial.write_text(page, "utf-8")
    return path


def report_text(judged: Sequence[Judged]) -> str:
    """The report as lines of text: chapter, verdict, place, claim; differences below."""
    lines = ["The thesis, reproduced", ""]
    for j in judged:
        mark = "!" if j.problems else " "
        lines.append(f"{mark} {j.chapter}  {j.verdict or 'no answer':<22} {j.claim.where}")
        lines.append(f"     {j.claim.says}")
        lines += [f"     differs: {problem}" for problem in j.problems]
    differing = sum(bool(j.problems) for j in judged)
    lines += ["", f"  {len(judged)} claims, {differing} differ from the record"]
    return "\n".join(lines)


def _shown(judged: Judged, folder: Path, explorers: Mapping[str, Explorer]) -> dict[str, Any]:
    claim = judged.claim
    return {
        "id": f"chapter-{judged.chapter}-{claim.name.replace(' ', '-')}",
        "chapter": judged.chapter,
        "claim": claim,
        "verdict": judged.verdict or "no answer",
        "kind": (judged.verdict or "no answer").replace(" ", "-"),
        "problems": judged.problems,
        "trials": [
            _trial(role, spec, outcome) | _dragged(explorers.get(explored(spec)), folder)
            for role, (spec, outcome) in zip(ROLES, judged.trials, strict=False)
        ],
    }


def _trial(role: str, spec: TrialSpec, outcome: Found) -> dict[str, Any]:
    low, high = spec.needs
    drawn = outcome.folder / "interactive.json"
    interactive = json.loads(drawn.read_text("utf-8")) if drawn.exists() else None
    about = (interactive or {}).get("layout", {}).get("meta", {})
    return {
        "says": spec.says or role,
        "number": _number(outcome),
        "refusal": outcome.refusal,
        "holds": outcome.within(spec),
        "needs": f"{low:g}" if low == high else f"{low:g} to {high:g}",
        "recorded": f"{spec.recorded:.4g}",
        "unit": "" if spec.unit == "1" else spec.unit,
        "what": spec.number or "value",
        "command": command(spec),
        "scenario": spec.scenario,
        "text": read_text(spec.scenario)[1] if spec.scenario else "",
        "figures": [picture(outcome.folder / f"{n}.png") for n in SHOWN if n in outcome.figures],
        "interactive": interactive,
        "tall": about.get("tall"),
        "drawn": about.get("says"),
    }


def _dragged(explorer: Explorer | None, folder: Path) -> dict[str, str]:
    """The link to the page in which a trial runs, or why there is none."""
    if explorer is None or explorer.page is None:
        return {"page": "", "no_page": explorer.refusal if explorer else ""}
    return {"page": quote(Path(os.path.relpath(explorer.page, folder)).as_posix()), "no_page": ""}


def command(spec: TrialSpec) -> str:
    """The command that repeats the trial."""
    if spec.scenario is None:
        said = ", ".join(f"{k}={v!r}" for k, v in spec.arguments.items())
        return f"holdfast.{spec.function}({said})"
    words = ["holdfast", "run", spec.scenario]
    for change in spec.set:
        words += ["--set", change]
    if spec.runs is not None:
        words += ["--runs", str(spec.runs)]
    return shlex.join(words)


def _number(outcome: Found) -> str:
    if outcome.number is not None:
        return f"{outcome.number:.4g}"
    return "refused" if outcome.refusal else "none"
