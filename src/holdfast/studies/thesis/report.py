"""The report on the claims of the thesis, as one self-contained page."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from holdfast._version import __version__
from holdfast.host.writing import atomic_file
from holdfast.presentation.html.interactive import INK
from holdfast.presentation.html.page import picture, plotly_script, rendered
from holdfast.scenario.files import read_text
from holdfast.scenario.schema.claims import TrialSpec
from holdfast.studies.thesis.explorers import Explorer, explored
from holdfast.studies.thesis.reproduce import CONDITION, FAILS, HOLDS, Found, Judged, chapter

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
            _trial(role, spec, found) | _dragged(explorers.get(explored(spec)), folder)
            for role, (spec, found) in zip(ROLES, judged.trials, strict=False)
        ],
    }


def _trial(role: str, spec: TrialSpec, found: Found) -> dict[str, Any]:
    low, high = spec.needs
    drawn = found.folder / "interactive.json"
    interactive = json.loads(drawn.read_text("utf-8")) if drawn.exists() else None
    about = (interactive or {}).get("layout", {}).get("meta", {})
    return {
        "says": spec.says or role,
        "number": _number(found),
        "refusal": found.refusal,
        "holds": found.within(spec),
        "needs": f"{low:g}" if low == high else f"{low:g} to {high:g}",
        "recorded": f"{spec.recorded:.4g}",
        "unit": "" if spec.unit == "1" else spec.unit,
        "what": spec.number or "value",
        "command": command(spec),
        "scenario": spec.scenario,
        "text": read_text(spec.scenario)[1] if spec.scenario else "",
        "figures": [picture(found.folder / f"{n}.png") for n in SHOWN if n in found.figures],
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


def _number(found: Found) -> str:
    if found.number is not None:
        return f"{found.number:.4g}"
    return "refused" if found.refusal else "none"
