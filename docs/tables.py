"""In a table a name may be broken between its words, and a number nowhere, so that columns fit."""

import re
from typing import Any

NEGATIVE = r"(?<![\w)\]-])(?:-?[\d.]+e)?-[\w.]*\w"
"""A minus that belongs to what follows it, as in -pi and 1.4e-4."""


def on_page_content(html: str, **_: Any) -> str:
    return re.sub(r"<td\b.*?</td>", lambda cell: _fitted(cell[0]), html, flags=re.S)


def _fitted(cell: str) -> str:
    """With a place to break after an underscore, a stroke or a full stop between two words."""
    parts = re.split(r"(<code>[^<]+</code>|<[^>]+>)", cell)
    for k, part in enumerate(parts):
        if part.startswith("<code>"):
            parts[k] = re.sub(r"(?<=\w)([_/.]|::)(?=[A-Za-z])", r"\1<wbr>", part)
        elif not part.startswith("<"):
            parts[k] = re.sub(NEGATIVE, r'<span class="whole">\g<0></span>', part)
    return "".join(parts)
