"""Docstrings are shown as they are written: units in brackets, products and comparisons.

Of Markdown they use paragraphs, lists, code and nothing else. In a docstring `pwm[16 or 32] [us]`
is no link, `<a, F>` no tag and `u*cos(psi) + v*sin(psi)` has no emphasis; on a page all three
are.
"""

from typing import Any

from markdown import Markdown
from markdown.extensions import Extension

INLINE = (
    *("reference", "link", "image_link", "image_reference", "short_reference", "short_image_ref"),
    *("mkdocs-autorefs", "autolink", "automail", "html", "em_strong", "em_strong2"),
)
"""What Markdown reads in a line that no docstring means."""


class AsWritten(Extension):
    """Markdown without links, references, tags and emphasis."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802 (Markdown's own name)
        for name in INLINE:
            md.inlinePatterns.deregister(name, strict=False)
        md.preprocessors.deregister("html_block")
        md.parser.blockprocessors.deregister("reference")


def on_pre_build(config: Any) -> None:
    """Of docstrings alone, when all extensions of the pages have been named."""
    handler = config.plugins["mkdocstrings"].get_handler("python")
    handler.mdx = [*handler.mdx, AsWritten()]
