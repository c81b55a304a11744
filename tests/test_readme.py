"""What the README shows is what happens."""

import contextlib
import io
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.simulation.law_comparison import Rate

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text("utf-8")


@pytest.mark.heavy
def test_thirteen_lines_of_python_do_what_the_main_command_does():
    code, _ = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len(code.strip().splitlines()) == 13
    code = code.replace("1.047", repr(np.pi / 3))  # 60 degrees, rounded in the README
    scope, printed = {}, io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, scope)
    expected = hf.load_scenario("inspection").run()
    ours, theirs = scope["result"].dataset, expected.dataset.isel(run=slice(3, None))
    starts, ends = ([d["state"].values[:, k] for d in (ours, theirs)] for k in (0, -1))
    assert np.abs(starts[0] - starts[1]).max() < 1e-12
    assert np.abs(ends[0] - ends[1]).max() < 1e-6
    assert np.array_equal(ours["outcome"].values, theirs["outcome"].values)
    assert printed.getvalue().startswith(f"{scope['result'].viable} ")


def test_controller_of_ten_lines_loses_the_view_and_the_filter_keeps_it():
    _, code = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len(code.strip().splitlines()) == 10
    least = {}
    for name, text in {
        "kept": code,
        "alone": code.replace("(decision.input)", "(command)"),
    }.items():
        scope, values = {}, []
        told = text.replace("boat.step(", "seen.append(decision.value); boat.step(")
        with contextlib.redirect_stdout(io.StringIO()):
            exec("seen = []\n" + told, scope)
        values = scope["seen"]
        least[name] = min(values)
        assert len(values) == 1000
        assert np.hypot(scope["boat"].state[0] + 0.5, scope["boat"].state[1]) < 0.12
    assert least["kept"] > 0
    assert least["alone"] < -0.2, "rad outside the view"


def test_fraction_in_the_readme_is_the_measured_one():
    result = hf.load_scenario("inspection").run()
    assert (result.viable, result.dataset.sizes["run"]) == (203, 203)
    assert "203 of 203" in README


def test_readme_counts_the_claims_of_the_thesis():
    chapters = (ROOT / "src/holdfast/studies/thesis").glob("*.toml")
    count = sum(len(tomllib.loads(p.read_text("utf-8"))["claims"]) for p in chapters)
    assert f"[{count} claims](docs/reproduce.md)" in README


def test_certainty_of_a_thousand_runs_that_stay_is_the_one_that_limits_names():
    low = Rate(1000, 1000).interval[0]  # Wilson's: n / (n + z^2)
    z = math.sqrt(1000 * (1 / low - 1))
    assert math.erf(z / math.sqrt(2)) == pytest.approx(0.95)
    page = (ROOT / "docs/limits.md").read_text("utf-8")
    assert f"at most {100 * (1 - low):.1f} % are lost" in page


def test_commands_of_the_readme_name_things_that_exist():
    from holdfast.studies.catalogue import describe

    for name in re.findall(r"^holdfast (?:show|run|explain) ([\w-]+)", README, re.M):
        assert describe(name)
    for link in re.findall(r"\]\(([^)#]+)\)", README):
        assert (ROOT / link).exists(), link


def test_map_of_the_readme_is_true():
    """Every room is on the map, and every name on the map is a room or a module at the top."""
    shown = README[README.index("## Where things are") :]
    source = ROOT / "src" / "holdfast"
    rooms = {f"{p.parent.name}/" for p in source.glob("*/__init__.py")}
    modules = {p.name for p in source.glob("*.py") if not p.name.startswith("_")}
    rows = "\n".join(line for line in shown.splitlines() if line.startswith("|"))
    told = set(re.findall(r"`([a-z_]+(?:/|\.py))`", rows))
    assert rooms | modules <= told
    assert told - rooms - modules == {"catalogue/"}


def test_readme_fits_on_two_screens():
    assert len(README.splitlines()) <= 100


def test_project_declares_the_python_it_needs():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["requires-python"] == ">=3.11"


def test_site_has_every_page_and_the_reference_every_name():
    docs = ROOT / "docs"
    pages = {str(p.relative_to(docs)) for p in docs.rglob("*.md")}
    named = re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert set(named) == pages
    reference = "".join(p.read_text() for p in (docs / "reference").glob("*.md"))
    known = set(re.findall(r"^::: holdfast\.(\S+)$", reference, re.M))
    catalogue = {"fields", "laws", "regions", "systems"}
    assert set(hf.__all__) - catalogue - {"__version__"} <= known


EQUATIONS = {2: 21, 3: 11, 4: 40, 5: 41, 6: 25, 7: 7}
"""The last number of every chapter."""


def test_every_equation_of_the_thesis_has_its_place():
    text = (ROOT / "docs" / "theory.md").read_text("utf-8")
    rows = [line for line in text.splitlines() if line.startswith("|")]
    found = set(re.findall(r"\((\d\.\d{1,2})[a-z]?\)", "\n".join(rows)))
    for first, last in re.findall(r"\((\d\.\d{1,2})\)-\((\d\.\d{1,2})\)", "\n".join(rows)):
        chapter, low, high = first[0], int(first[2:]), int(last[2:])
        found |= {f"{chapter}.{k}" for k in range(low, high + 1)}
    assert [
        f"{c}.{k}" for c, n in EQUATIONS.items() for k in range(1, n + 1) if f"{c}.{k}" not in found
    ] == []
    source = ROOT / "src" / "holdfast"
    for row in rows:
        cells = [c.strip() for c in row.strip("|").split("|")]
        files = re.findall(r"`([\w/]+\.py)`", cells[2]) if len(cells) == 4 else []
        told = "".join((source / f).read_text("utf-8") for f in files)
        for name in re.findall(r"`([\w.]+)`", cells[3]) if files else ():
            assert name.split(".")[-1] in told, (name, files)
