"""What `.ci/run` and the site do: a check fails where something is wrong, and only there."""

import importlib.util
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from whole import RECORD

from tests.conftest import LEFT_OUT, NO_CASE

ROOT = Path(__file__).parent.parent
CHECKS = (ROOT / ".ci" / "run").read_text("utf-8")


def built(folder, text):
    """The exit status of a site with that page, built with the options that the checks give."""
    (options,) = re.findall(r"mkdocs build (.*?) --site-dir", CHECKS)
    (folder / "docs").mkdir(parents=True)
    (folder / "docs" / "index.md").write_text(text)
    (folder / "mkdocs.yml").write_text("site_name: a\ntheme: { name: mkdocs }\n")
    words = [sys.executable, "-m", "mkdocs", "build", *shlex.split(options)]
    return subprocess.run(words, cwd=folder, capture_output=True, timeout=120).returncode


def test_a_page_with_a_broken_link_fails_the_checks(tmp_path):
    pytest.importorskip("mkdocs", reason="needs holdfast[docs]")
    assert built(tmp_path / "whole", "# A\n[itself](index.md)\n") == 0
    assert built(tmp_path / "broken", "# A\n[nowhere](nowhere.md)\n") != 0


@pytest.mark.parametrize(
    "written",
    [
        "uint32 frame_count, uint16 pwm[16 or 32] [us].",
        "edges[i][0] and edges[i][-1]: of axis i.",
        "edges[i](t) [m].",
        "[us]: a unit at the beginning.",
        "hdot = -k h for h = <a, F> (2.15).",
        "<b> is a vector of two numbers.",
        "u + Vx*cos(psi) + Vy*sin(psi) [m/s].",
        "psi_ij' + sum_(k > i) (length_k)_.",
    ],
)
def test_docstrings_are_shown_as_they_are_written(written):
    markdown = pytest.importorskip("markdown", reason="needs holdfast[docs]")
    autorefs = pytest.importorskip("mkdocs_autorefs", reason="needs holdfast[docs]")
    spec = importlib.util.spec_from_file_location("docstrings", ROOT / "docs" / "docstrings.py")
    docstrings = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(docstrings)
    references = autorefs.AutorefsExtension(autorefs.AutorefsPlugin())
    shown = markdown.markdown(written, extensions=[references, docstrings.AsWritten()])
    for character, entity in (("<", "&lt;"), (">", "&gt;")):
        written = written.replace(character, entity)
    assert shown == f"<p>{written}</p>"


def test_versions_of_all_that_the_checks_install_are_held():
    packaging = pytest.importorskip("packaging.requirements")
    lines = (ROOT / ".ci" / "constraints.txt").read_text("utf-8").splitlines()
    held = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wanted = [*project["build-system"]["requires"], *project["project"]["dependencies"], "uv"]
    for extra in ("test", "lint", "docs", "check", "interop", "cluster"):
        wanted += project["project"]["optional-dependencies"][extra]
    for text in wanted:
        requirement = packaging.Requirement(text)
        version = held[re.sub(r"[-_.]+", "-", requirement.name).lower()]
        assert requirement.specifier.contains(version), text
    for tool in ("PIP", "UV"):
        assert f'export {tool}_CONSTRAINT="$work/constraints.txt"' in CHECKS


def test_cases_that_the_fast_run_has_are_cases_of_their_tests(pytestconfig):
    if any("::" in name for name in pytestconfig.args):
        pytest.skip("not all cases were collected")
    assert not pytestconfig.stash[NO_CASE]


def test_every_test_that_the_fast_run_leaves_out_has_passed_in_the_record(pytestconfig):
    """Else: `python benchmarks/whole.py --missing`, or all of it, and commit the record."""
    verdicts, left_out = (
        json.loads(RECORD.read_text("utf-8"))["tests"],
        pytestconfig.stash[LEFT_OUT],
    )
    assert not left_out - set(verdicts), "not in the record"
    assert all((ROOT / name.split("::")[0]).exists() for name in verdicts), "a file that is gone"
    if not any("::" in name for name in pytestconfig.args):
        files = {name.split("::")[0] for name in left_out}
        recorded = {name for name in verdicts if name.split("::")[0] in files}
        assert recorded == left_out, "no longer a test that is left out"
    assert not {n: v for n, v in verdicts.items() if not v.startswith(("passed", "skipped: "))}
