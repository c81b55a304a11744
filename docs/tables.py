"""In a table a name may be broken between its words, so that no column is wider than a word."""

import re
from typing import Any


def on_page_content(html: str, **_: Any) -> str:
    return re.sub(r"<td\b.*?</td>", lambda cell: _breakable(cell[0]), html, flags=re.S)


def _breakable(cell: str) -> str:
    """After an underscore, a stroke or a full stop between two words of a name."""
    return re.sub(
        r"<code>[^<]+</code>",
        lambda code: re.sub(r"(?<=\w)([_/.]|::)(?=[A-Za-z])", r"\1<wbr>", code[0]),
        cell,
    )
