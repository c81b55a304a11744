"""A number that README or a page of the documentation states is tied to what produces it.

Every page has a file `documented/PAGE.toml`. Each of its `[[claim]]` quotes the page (`says`) and
names what fails when the number moves: a `test`, a `claim` of the thesis (CHAPTER/NAME), or, for
what depends on the machine, a `benchmark`. A `[[table]]` is quoted by its header row, for all of its
rows. Lines with numbers that state no result of ours are in `plain`: definitions, what others
published, what is chosen rather than found.
"""

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TIES = sorted((Path(__file__).parent / "documented").glob("*.toml"))
NUMBER = re.compile(r"(?<![\w.#-])\d[\d,]*(?:\.\d+)?(?![\w-])|(?<![\w.])\.\d+")
REFERENCE = re.compile(
    r"`[^`]*`|\([A-Z]?\d+\.\d+[a-z]?\)|(?:[Cc]hapters?|[Ss]ections?|[Ff]igs?\.|[Tt]heorem|[Pp]ython|NetCDF|ROS) "
    r"[\d.,-]+(?: (?:and|to) [\d.]+)?|\b(?:19|20)\d\d\b"
)
"""Code, equations, chapters, years: numbers that state nothing."""
FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$", re.M | re.S)


def page_of(ties):
    name = f"{ties.stem}.md"
    return ROOT / name if (ROOT / name).exists() else ROOT / "docs" / name


def flat(text):
    return re.sub(r"\s+", " ", text)


@cache
def functions(path):
    """Name -> source of every test function of a file."""
    text = (ROOT / path).read_text()
    return {
        node.name: ast.get_source_segment(text, node) or ""
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
    }


@cache
def thesis_claims():
    """CHAPTER/NAME of every claim of the thesis that is judged."""
    chapters = (ROOT / "src/holdfast/studies/thesis").glob("*.toml")
    return {
        f"{p.stem}/{c['name']}" for p in chapters for c in tomllib.loads(p.read_text())["claims"]
    }


def sentences(page):
    """Sentences, table rows and list items of a page, without code blocks, comments and links."""
    text = FENCE.sub("\n\n", page.read_text())
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*|]|\d+\.) ?)", text):
        if block.lstrip().startswith("#") or set(block.strip()) <= set("|-: "):
            continue
        rows = (
            [block] if block.lstrip().startswith("|") else re.split(r"(?<=[.!?:;]) ", flat(block))
        )
        for row in rows:
            yield flat(REFERENCE.sub("", row)).strip(), flat(row).strip()


def rows_below(page, headers):
    """The rows of the tables that have these header rows."""
    lines = [flat(line).strip() for line in page.read_text().splitlines()]
    for header in headers:
        for line in lines[lines.index(flat(header).strip()) + 1 :]:
            if not line.startswith("|"):
                break
            yield line


@pytest.mark.parametrize("ties", TIES, ids=lambda p: p.stem)
def test_what_a_page_states_stands_on_it_and_is_produced_by_what_it_names(ties):
    text, stated = flat(page_of(ties).read_text()), tomllib.loads(ties.read_text())
    for claim in (*stated.get("claim", []), *stated.get("table", [])):
        quoted = claim.get("says") or claim["header"]
        assert flat(quoted) in text, f"no longer on the page: {quoted}"
        assert len({"test", "claim", "benchmark"} & set(claim)) == 1, quoted
        if name := claim.get("benchmark"):
            assert (ROOT / name).exists(), name
        if name := claim.get("claim"):
            assert name in thesis_claims(), name
        if name := claim.get("test"):
            path, function = name.split("::")
            assert function in functions(path), name
    for line in stated.get("plain", []):
        assert flat(line) in text, f"no longer on the page: {line}"


@pytest.mark.parametrize("ties", TIES, ids=lambda p: p.stem)
def test_every_number_of_a_page_is_tied_to_what_produces_it(ties):
    stated = tomllib.loads(ties.read_text())
    known = [flat(c["says"]) for c in stated.get("claim", [])] + [
        flat(line) for line in stated.get("plain", [])
    ]
    known += rows_below(page_of(ties), [t["header"] for t in stated.get("table", [])])
    loose = [
        whole
        for bare, whole in sentences(page_of(ties))
        if NUMBER.search(bare) and not any(k in whole or whole in k for k in known)
    ]
    assert not loose, "\n".join(loose)


def test_every_page_has_its_ties():
    pages = {p.stem for p in (ROOT / "docs").glob("*.md")} | {"README"}
    assert {t.stem for t in TIES} == pages
