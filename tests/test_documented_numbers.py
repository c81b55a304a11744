"""A number that README or a page of the documentation states is tied to what produces it.

Every page has a file `documented/PAGE.toml`. Each of its `[[claim]]` quotes the page (`says`) and
names what fails when the number moves: a `test`, by its name, a `claim` of the thesis
(CHAPTER/NAME), or, for what depends on the machine, a `benchmark`. A `[[table]]` is quoted by its
header row, for all of its rows. Lines with numbers that state no result of ours are in `plain`:
definitions, what others published, what is chosen rather than found.

A test has every number of what it is tied to, in its code or in what it reads
(`what_a_test_reads.py`), or takes it from the page; or `computed` is arithmetic of numbers that the
test has, which gives the number.
"""

import re
import tomllib
from functools import cache
from pathlib import Path

import pytest

from tests.what_a_test_reads import ROOT, Reading, computed, functions, reading_of, same

TIES = sorted((Path(__file__).parent / "documented").glob("*.toml"))
NUMBER = re.compile(r"(?<![\w.#-])\d[\d,]*(?:\.\d+)?(?![\w-])|(?<![\w.])\.\d+")
REFERENCE = re.compile(
    r"`[^`]*`|\([A-Z]?\d+\.\d+[a-z]?\)|(?:[Cc]hapters?|[Ss]ections?|[Ff]igs?\.|[Tt]heorem|[Pp]ython|NetCDF|ROS) "
    r"[\d.,-]+(?: (?:and|to) [\d.]+)?|\b(?:19|20)\d\d\b|(?<= )1/s\b"
)
"""Code, equations, chapters, years, a unit: numbers that state nothing."""
AROUND = 100
"""Characters around a quoted text in which a test may look it up."""
UNIT = re.compile(r"(?:,? (?:to|and|or|x|at most)?,? ?[\d.,]*\d(?![\w.]))*,? ?(%|[A-Za-z]+)")
"""What follows a number, or a list of them."""
FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$", re.M | re.S)


def page_of(ties):
    name = f"{ties.stem}.md"
    return ROOT / name if (ROOT / name).exists() else ROOT / "docs" / name


def flat(text):
    return re.sub(r"\s+", " ", text)


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
        assert ("computed" in claim) <= ("test" in claim), quoted
        if name := claim.get("benchmark"):
            assert (ROOT / name).exists(), name
        if name := claim.get("claim"):
            assert name in thesis_claims(), name
        for name in names_of(claim):
            assert len(functions().get(name, [])) == 1, f"not the name of one test: {name}"
    for line in stated.get("plain", []):
        assert flat(line) in text, f"no longer on the page: {line}"


def listed(value):
    return [value] if isinstance(value, str) else value


def names_of(tie):
    """The names of the tests of a tie: names alone, since a test may move to another file."""
    return [name.rpartition("::")[2] for name in listed(tie.get("test", []))]


def read_by(tie):
    """What the tests of a tie read."""
    return Reading.of(reading_of(*functions()[name], name) for name in names_of(tie))


def numbers_in(text):
    """(place, number, unit) of the numbers of a text that state something."""
    bare = REFERENCE.sub(lambda m: " " * len(m[0]), text)
    for m in NUMBER.finditer(bare):
        after = UNIT.match(bare, m.end())
        yield m.start(), m[0].strip(","), after[1] if after else ""


@cache
def tables():
    """Test -> the numbers of the tables that it is tied to, of all pages."""
    every = {}
    for ties in TIES:
        for table in tomllib.loads(ties.read_text()).get("table", []):
            rows = " ".join(rows_below(page_of(ties), [table["header"]]))
            numbers = {float(number.replace(",", "")) for _, number, _ in numbers_in(rows)}
            for name in names_of(table):
                every.setdefault(name, set()).update(numbers)
    return every


def not_in(tie, text, also, takes):
    """The numbers of a text that the tests of a tie have not, and that the arithmetic of the tie
    does not give; the numbers of this that they have not, and what of it is of no use."""
    reading, arithmetic = read_by(tie), listed(tie.get("computed", []))
    idle, lacks = set(arithmetic), []
    for place, number, unit in numbers_in(text):
        if reading.has(number, unit) or also.has(number) or takes(place, place + len(number)):
            continue
        of = [e for e in arithmetic if same(number, unit, computed(e)[0])]
        idle -= {*of}
        lacks += [] if of else [number]
    for n in (n for e in arithmetic for n in computed(e)[1] if n != 1):
        lacks += [] if reading.has(repr(n)) or also.has(repr(n)) else [n]
    return lacks + sorted(idle)


@pytest.mark.parametrize("ties", TIES, ids=lambda p: p.stem)
def test_every_number_of_a_tied_sentence_is_one_of_its_test(ties):
    page, lacks = page_of(ties), {}
    text = flat(page.read_text())
    for claim in tomllib.loads(ties.read_text()).get("claim", []):
        quoted, reading = flat(claim["says"]), read_by(claim)
        at, reads = text.index(quoted), any(page.name in part for part in reading.texts)
        before = min(at, AROUND)
        near = text[at - before : at + len(quoted) + AROUND]

        def takes(begin, end, before=before, near=near, reads=reads, reading=reading):
            return reads and reading.takes(near, before + begin, before + end)

        if names := names_of(claim):
            also = Reading({n for name in names for n in tables().get(name, ())})
            if of := not_in(claim, quoted, also, takes):
                lacks[quoted] = of
    assert not lacks


@pytest.mark.parametrize("ties", TIES, ids=lambda p: p.stem)
def test_every_number_of_a_tied_table_is_one_of_its_test(ties):
    """Or the test looks the table up on the page, by its heading or its header."""
    page, lacks = page_of(ties), {}
    for table in tomllib.loads(ties.read_text()).get("table", []):
        header, texts = table["header"], read_by(table).texts
        above = page.read_text().split(header)[0].splitlines()
        heading = next((line for line in reversed(above) if line.startswith("#")), "")
        looked_up = [t for t in texts if len(t) > 5 and t in f"{heading}\n{header}"]
        if looked_up and any(page.name in text for text in texts):
            continue
        rows = "\n".join(rows_below(page, [header]))
        if names_of(table) and (of := not_in(table, rows, Reading(), lambda *_: False)):
            lacks[header] = of
    assert not lacks


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


def test_number_of_a_comment_or_a_docstring_is_none_of_a_test(tmp_path):
    file = tmp_path / "test_one.py"
    file.write_text(
        "import pytest\n"
        "MOST = 0.4\n"
        '"""61"""\n'
        "@pytest.mark.parametrize('name', ['of 21', 'ch31'])\n"
        "def test_one(name):\n"
        '    """41 starts"""\n'
        "    assert len(name) < MOST * 100  # of 51\n"
    )
    reading = reading_of(file, "test_one")
    assert [n for n in ("21", "31", "41", "51", "61", "100", "40") if reading.has(n)] == [
        "21",
        "100",
    ]
    assert reading.has("40", "%")
    assert computed("0.4 * 100") == (40, [0.4, 100])
    with pytest.raises(ValueError, match="no arithmetic"):
        computed("__import__('os')")


def test_every_page_has_its_ties():
    pages = {p.stem for p in (ROOT / "docs").glob("*.md")} | {"README"}
    assert {t.stem for t in TIES} == pages
