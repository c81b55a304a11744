"""Self-contained pages: scripts and pictures are embedded, and no network is used.

In one of them a scenario runs: it has its data, and the scripts that draw it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any

import jinja2
from PIL import Image
from plotly.offline import get_plotlyjs  # type: ignore[import-untyped]

from holdfast._version import __version__
from holdfast.execution.simulation.settings import OUTCOMES, Outcome
from holdfast.maths.definitions.region import WALLS
from holdfast.presentation.figures import style

WIDTH, QUALITY = 1100, 82
"""Width in pixels of a picture on a page, and its quality."""


def rendered(template: str, **values: Any) -> str:
    """The page from a template of this folder with these values."""
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    text = (resources.files(__package__) / f"{template}.html.jinja").read_text("utf-8")
    return environment.from_string(text).render(**values)


def plotly_script() -> str:
    """The script that draws interactive figures."""
    return str(get_plotlyjs())


def picture(path: Path) -> str:
    """The picture as a data URL, small enough for a page of many."""
    with Image.open(path) as image:
        image.thumbnail((WIDTH, 4 * WIDTH))
        buffer = BytesIO()
        image.convert("RGB").save(buffer, "WEBP", quality=QUALITY)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


SCRIPTS = (
    "svg",
    "levels",
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
        "lines": style.LINES, "version": __version__, "dashes": style.DASHES, "walls": WALLS,
        "outcome_dashes": [style.OUTCOME_DASHES[o] for o in Outcome],
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
