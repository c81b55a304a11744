"""Docstrings on pages: as they are written, with a table of the arguments and the examples.

Of Markdown they use paragraphs, lists, code and nothing else. In a docstring `pwm[16 or 32] [us]`
is no link, `<a, F>` no tag and `u*cos(psi) + v*sin(psi)` has no emphasis; on a page all three
are.
"""

import re
import sys
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import griffe
from markdown import Markdown
from markdown.extensions import Extension
from markdown.treeprocessors import Treeprocessor

sys.path.insert(0, str(Path(__file__).parent))
from arguments import EVERYWHERE, explained, of_the_catalogue, thing_at

INLINE = (
    *("reference", "link", "image_link", "image_reference", "short_reference", "short_image_ref"),
    *("mkdocs-autorefs", "autolink", "automail", "html", "em_strong", "em_strong2"),
)
"""What Markdown reads in a line that no docstring means."""
BLOCKS = ("reference", "quote", "hashheader", "setextheader", "hr")
"""What it reads at the beginning of a line that no docstring means, as in "> 0"."""


class AsWritten(Extension):
    """Markdown without links, references, tags and emphasis; names of the reference are links."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802 (Markdown's own name)
        for name in INLINE:
            md.inlinePatterns.deregister(name, strict=False)
        md.preprocessors.deregister("html_block")
        for name in BLOCKS:
            md.parser.blockprocessors.deregister(name)
        md.treeprocessors.register(Linked(md), "linked", 5)


PLACES = {
    path.rpartition(".")[2]: path
    for page in sorted((Path(__file__).parent / "reference").glob("*.md"))
    for path in re.findall(r"^::: (\S+)$", page.read_text("utf-8"), re.M)
    if not re.search(r"\.interop\..*\.[a-z]\w*$", path)  # words such as `plant` and `serve`
}
"""Names of the reference, and where each stands."""


class Linked(Treeprocessor):
    """`System` and `hf.System` in a sentence lead to what the reference says of it."""

    def run(self, root: Element) -> None:
        for parent in list(root.iter()):
            for position, code in enumerate(parent):
                path = PLACES.get((code.text or "").removeprefix("hf."))
                if code.tag == "code" and parent.tag != "pre" and path:
                    link = Element("autoref", {"identifier": path, "optional": ""})
                    link.tail, code.tail = code.tail, None
                    link.append(code)
                    parent[position] = link


def on_pre_build(config: Any) -> None:
    """Of docstrings alone, when all extensions of the pages have been named."""
    handler = config.plugins["mkdocstrings"].get_handler("python")
    handler.mdx = [*handler.mdx, AsWritten()]


VARIADIC = (griffe.ParameterKind.var_positional, griffe.ParameterKind.var_keyword)
"""Of arguments that have no default."""


class Arguments(griffe.Extension):
    """The table of the arguments, from the sentences that begin with their names."""

    def on_function(self, *, func: griffe.Function, **_: Any) -> None:
        _tabulate(func)

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        _tabulate(cls)


def _tabulate(of: griffe.Function | griffe.Class) -> None:
    if of.docstring is None:
        return
    parameters = {p.name: p for p in of.parameters if p.name not in ("self", "cls")}
    paragraphs, about = explained(of.docstring.value, parameters)
    if of.path.startswith("holdfast.maths.catalogue."):
        about = {**of_the_catalogue(thing_at(of.path)), **about}
    rows = [
        griffe.DocstringParameter(
            name,
            annotation=parameter.annotation,
            value=parameter.default if parameter.kind not in VARIADIC else None,
            description=about.get(name) or EVERYWHERE[name],
        )
        for name, parameter in parameters.items()
        if name in about or name in EVERYWHERE
    ]
    text = [p for p in paragraphs if not p.startswith(">>>")]
    examples = [p for p in paragraphs if p.startswith(">>>")]
    errors = [p for p in text if p.startswith(("Raises `", "Warns with `"))]
    sections: list[griffe.DocstringSection] = [
        griffe.DocstringSectionText("\n\n".join(p for p in text if p not in errors))
    ]
    if rows:
        sections.append(griffe.DocstringSectionParameters(rows, title="argument"))
    if errors:
        sections.append(griffe.DocstringSectionText("\n\n".join(errors)))
    if examples:
        shown = (griffe.DocstringSectionKind.examples, "\n\n".join(examples))
        sections.append(griffe.DocstringSectionExamples([shown], title="Example"))
    of.docstring.parsed = sections
