"""Pages to drag: each is of a trial with its overrides and starts, written once, whole or not at all."""

import base64
import json
import re
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.schema.claims import TrialSpec
from holdfast.studies.thesis import report as module
from holdfast.studies.thesis.report import Explorer, explored, write_explorers, write_report
from holdfast.studies.thesis.reproduce import CHAPTERS, Found, Judged, chapter
from tests.judged_claims import SHORT, claim, unicycle

KERNEL = {
    "scenario": "seen-target", "set": ["grid.nodes=21", "promise="], "number": "fraction_of_box",
    "needs": [0, 1],
}  # fmt: skip


def data_of(page):
    return json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', page, re.DOTALL)[1])


def judged(*claims):
    found = Found(1.0, Path("nowhere"))
    return [Judged(4, c, found, found if c.conditioned else None) for c in claims]


@pytest.fixture
def asked(monkeypatch):
    """The trials whose pages are made, in this process; "chained" has none."""
    names = []

    def one(asked):
        names.append(asked[0]["scenario"])
        return ("", "it has one state") if "chained" in names[-1] else (f"page of {names[-1]}", "")

    monkeypatch.setattr(module, "processes", ThreadPoolExecutor)
    monkeypatch.setattr(module, "_explored", one)
    return names


def test_page_has_the_overrides_and_the_starts_of_its_trial():
    spec = unicycle(["system.turn_limit=1", "run.horizon=10"], runs=3)
    page, refusal = module._explored((spec, None))
    assert not refusal
    data = data_of(page)
    assert len(data["starts"]) == 3
    assert data["tables"]["system"]["turn_limit"] == 1
    assert data["settings"]["horizon"] == 10


def test_a_kernel_is_not_computed_again(tmp_path, monkeypatch):
    loaded = hf.load_scenario(KERNEL["scenario"], KERNEL["set"])
    value = loaded.solve()
    value.save(tmp_path / "result.nc")
    monkeypatch.delattr(KernelScenario, "solve")
    page, refusal = module._explored((KERNEL, tmp_path))
    assert not refusal
    packed = data_of(page)["variants"][0]["loop"]["table"]
    table = np.frombuffer(zlib.decompress(base64.b64decode(packed)))
    assert np.isin(value.values(), table).all()


def test_a_trial_without_a_page_says_why():
    spec = {"scenario": "ch7-six-states", "set": ["grid.nodes=31"], "number": "fraction_of_box"}
    page, refusal = module._explored((spec | {"needs": [0, 1]}, Path()))
    assert not page
    assert refusal == "the grid of 'ch7-six-states' has 888 million nodes"


def test_equal_trials_share_a_page_which_is_kept(asked, tmp_path):
    other = claim(unicycle(), unicycle(["run.horizon=9"]), "other")
    claims = judged(claim(unicycle()), other)
    pages = write_explorers(claims, tmp_path)
    assert asked == ["ch4-unicycle"] * 2
    assert set(pages) == {explored(other.stated), explored(other.conditioned)}
    assert all(p.page.read_text() == "page of ch4-unicycle" for p in pages.values())
    fractions = []
    again = write_explorers(claims, tmp_path, progress=lambda what, done: fractions.append(done))
    assert again == pages
    assert len(asked) == 2
    assert fractions == [1.0]


def test_a_page_is_named_by_what_it_shows():
    spec = TrialSpec.model_validate(unicycle())
    same = TrialSpec.model_validate(unicycle() | {"number": "runs", "recorded": 7.0})
    assert explored(spec) == explored(same)
    assert explored(spec) != explored(TrialSpec.model_validate(unicycle(runs=5)))


def test_equal_trials_of_the_thesis_are_counted_once():
    trials = [t for n in CHAPTERS for c in chapter(n).claims for t in (c.stated, c.conditioned)]
    run = [t for t in trials if t is not None and t.scenario is not None and not t.refused]
    assert len({explored(t) for t in run}) == 62 < len(run)


def test_the_report_links_beside_itself_or_says_why_not(asked, tmp_path):
    chained = unicycle(SHORT) | {"scenario": "ch4-chained-3"}
    claims = judged(claim(unicycle()), claim(chained, None, "chained"))
    pages = write_explorers(claims, tmp_path)
    (tmp_path / "elsewhere").mkdir()
    for place in (tmp_path, tmp_path / "elsewhere"):
        report = write_report(claims, place / "report.html", pages).read_text()
        (link,) = re.findall(r'class="drag" href="([^"]*)"', report)
        assert not link.startswith("/")
        assert (place / link).read_text() == "page of ch4-unicycle"
        assert "No page to drag: it has one state." in report
    bare = write_report(claims, tmp_path / "report.html").read_text()
    assert 'class="drag"' not in bare
    assert "No page to drag" not in bare


def test_an_interruption_leaves_whole_pages_alone(asked, tmp_path):
    def stop(what, done):
        if done > 0:
            raise KeyboardInterrupt

    claims = judged(claim(unicycle(), unicycle(["run.horizon=9"])))
    with pytest.raises(KeyboardInterrupt):
        write_explorers(claims, tmp_path, progress=stop)
    (page,) = (tmp_path / "explorers").iterdir()
    assert page.read_text() == "page of ch4-unicycle"
    assert len(write_explorers(claims, tmp_path)) == 2


def test_a_trial_that_failed_and_a_function_have_no_page(asked, tmp_path):
    circle = {
        "function": "planning.corners.critical_radius", "needs": [0, 1],
        "arguments": {"distance": 1.0, "width": 1.6, "robot_radius": 0.2},
    }  # fmt: skip
    failed = Judged(4, claim(unicycle()), Found(None, tmp_path, trouble="no"), None)
    assert write_explorers([failed, *judged(claim(circle))], tmp_path) == {}
    assert Explorer() == Explorer(None, "")
