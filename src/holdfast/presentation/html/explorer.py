"""A page in which a scenario runs: its data, and the scripts that draw it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from typing import Any

from holdfast._version import __version__
from holdfast.execution.simulation.outcomes import OUTCOMES, Outcome
from holdfast.presentation.figures import style
from holdfast.presentation.html.page import rendered

SCRIPTS = (
    "svg",
    "plane",
    "strips",
    "controls",
    "runs",
    "slices",
    "copies",
    "axes",
    "drag",
    "sweep",
    "app",
)
"""The scripts of the page in the order in which they stand in it; `sweep` where there is one."""


def explorer_page(data: Mapping[str, Any]) -> str:
    """The page as one text of HTML, without a request to anything else."""
    folder = resources.files(__package__) / "explorer"
    named = [name for name in SCRIPTS if name != "sweep" or data["sweep"] is not None]

    def script(name: str) -> str:
        return (folder / f"{name}.js").read_text("utf-8")

    look = {
        "outcomes": {OUTCOMES[o]: style.OUTCOMES[o] for o in Outcome},
        "modes": style.MODES, "lines": style.LINES, "version": __version__,
    }  # fmt: skip
    return rendered(
        "explorer",
        title=data["title"],
        source=data["source"],
        note=data["note"],
        moved="start" if data["slices"] is None else "state",
        uncopied=data["uncopied"],
        css=(folder / "page.css").read_text("utf-8"),
        data=_embedded({**data, "look": look}),
        swept=data["sweep"] is not None,
        loop=script("loop"),  # runs in workers too
        scripts="\n".join(script(name) for name in named),
    )


def _embedded(data: Mapping[str, Any]) -> str:
    """JSON that may stand in a script element."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c")
