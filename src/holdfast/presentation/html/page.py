"""Self-contained pages: scripts and pictures are embedded, and no network is used."""

from __future__ import annotations

import base64
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any

import jinja2
from PIL import Image
from plotly.offline import get_plotlyjs  # type: ignore[import-untyped]

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
        kept = BytesIO()
        image.convert("RGB").save(kept, "WEBP", quality=QUALITY)
    return "data:image/webp;base64," + base64.b64encode(kept.getvalue()).decode("ascii")
