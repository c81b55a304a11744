"""`holdfast reproduce`: verdicts come from numbers, work is not done twice, the page stands alone."""

import json
import os
from html.parser import HTMLParser

import pytest

from holdfast.errors import OutputError, ScenarioError
from holdfast.scenario.files import scenario_names
from holdfast.scenario.schema.claims import ChapterSpec, TrialSpec
from holdfast.studies.thesis import reproduce as module
from holdfast.studies.thesis.report import command, report_text, write_report
from holdfast.studies.thesis.reproduce import (
    CHAPTERS,
    chapter,
    digest,
    number_in,
    reproduce,
    run_trial,
)
from tests.command_line import called

RADIUS = {"distance": 1.0, "width": 1.6, "robot_radius": 0.2}


def radius(needs, recorded=0.3333, **more):
    """A trial whose number is the critical radius, 1/3 m, at once."""
    return {
        "function": "planning.corners.critical_radius", "arguments": RADIUS | more, "unit": "m",
        "needs": needs, "recorded": recorded, "within": 1e-3,
    }  # fmt: skip


def claim(name, verdict, stated, conditioned=None):
    said = {
        "name": name,
        "where": "(6.24)",
        "says": f"{name}.",
        "verdict": verdict,
        "stated": stated,
    }
    more = {"condition": "if so", "conditioned": conditioned} if conditioned else {}
    return said | more


@pytest.fixture
def small(monkeypatch):
    """A thesis of one chapter, whose trials take no time."""
    claims = [
        claim("it is so", "holds", radius([0.3, 0.4])),
        claim("it is larger", "does not hold", radius([0.5, 1.0])),
        claim("it may be", "holds with a condition", radius([0.5, 1.0]), radius([0.3, 0.4])),
        claim("it was", "holds", radius([0.3, 0.4], recorded=0.35)),
        claim("it was more", "holds", radius([0.5, 1.0])),
        claim("it is refused", "holds", radius([0.3, 0.4], width=-1.0)),
    ]
    spec = ChapterSpec.model_validate({"title": "circles", "claims": claims})
    monkeypatch.setattr(module, "chapter", lambda number: spec)
    monkeypatch.setattr("holdfast.studies.thesis.report.chapter", lambda number: spec)
    return spec


def test_verdicts_follow_from_the_numbers(small, tmp_path):
    judged = reproduce(tmp_path, [6], workers=1)
    assert [j.verdict for j in judged] == [
        "holds", "does not hold", "holds with a condition", "holds", "does not hold", "",
    ]  # fmt: skip
    assert [bool(j.problems) for j in judged] == [False, False, False, True, True, True]
    assert "recorded: 0.35" in judged[3].problems[0]
    assert judged[4].problems == ("does not hold, recorded: holds",)
    assert "width is -1.0" in judged[5].problems[0]
    text = report_text(judged)
    assert "6 claims, 3 differ" in text
    assert "differs: does not hold, recorded: holds" in text


def test_what_is_there_is_not_run_again(small, tmp_path, monkeypatch):
    first = reproduce(tmp_path, [6], workers=1)
    fractions = []
    monkeypatch.setattr(module, "processes", None)  # no process is made
    again = reproduce(tmp_path, [6], progress=lambda what, done: fractions.append(done))
    assert [j.verdict for j in again] == [j.verdict for j in first]
    assert fractions == [1.0]


def test_a_trial_that_was_interrupted_is_run_again(small, tmp_path):
    """What it left behind is no answer."""
    spec = small.claims[0].stated
    place = tmp_path / "trials" / digest(spec)
    place.mkdir(parents=True)
    (place / "result.nc").write_text("half of it")
    judged = reproduce(tmp_path, [6], workers=1)
    assert judged[0].stated.number == pytest.approx(1 / 3)


def killed(asked):
    os._exit(9)


@pytest.mark.heavy
def test_a_process_that_is_killed_is_told(small, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_run", killed)
    with pytest.raises(OutputError, match="was killed, perhaps for lack of memory"):
        reproduce(tmp_path, [6], workers=1)


def test_trial_is_named_by_what_decides_it():
    spec = TrialSpec.model_validate(radius([0.3, 0.4]))
    other = TrialSpec.model_validate(radius([0.1, 0.2], recorded=7.0))
    assert digest(spec) == digest(other), "what it is compared with is no part of it"
    assert digest(spec) != digest(TrialSpec.model_validate(radius([0.3, 0.4], width=1.5)))


def test_scenario_is_run_drawn_and_read(tmp_path):
    spec = {
        "scenario": "ch4-unicycle", "runs": 20, "set": ["run.horizon=10"],
        "number": "outcomes.reached goal / runs", "needs": [0.9, 1], "recorded": 1,
    }  # fmt: skip
    run_trial(spec, tmp_path)
    said = json.loads((tmp_path / "trial.json").read_text())
    assert said["trouble"] == ""
    counts = json.loads((tmp_path / "summary.json").read_text())["outcomes"]
    assert said["number"] == counts["reached goal"] / 20 >= 0.8
    assert said["figures"] == ["histories", "paths"]
    drawn = json.loads((tmp_path / "interactive.json").read_text())
    assert sum(line.get("hoverinfo") != "skip" for line in drawn["data"]) == 20, "beside the goal"
    assert drawn["layout"]["xaxis"]["title"]["text"] == "x [m]"
    trial = TrialSpec.model_validate(spec)
    assert command(trial) == "holdfast run ch4-unicycle --set run.horizon=10 --runs 20"


@pytest.mark.parametrize(
    ("where", "value"), [("a.b", 2.0), ("a.list.1", 5.0), ("a.b / runs", 0.5), ("flag", 1.0)]
)
def test_number_is_found_by_its_names(where, value):
    said = {"a": {"b": 2, "list": [4, 5]}, "runs": 4, "flag": True}
    assert number_in(said, where) == value


@pytest.mark.parametrize("where", ["a", "a.c", "a.none", "a.list.7", "a.b / nothing", "a.b.c", "x"])
def test_number_that_is_none_is_said(where):
    said = {"a": {"b": 2, "none": None, "list": [4, 5]}, "nothing": 0}
    with pytest.raises(ScenarioError, match="claim"):
        number_in(said, where)


class Links(HTMLParser):
    """What a page would load."""

    def __init__(self):
        super().__init__()
        self.loaded, self.tags = [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.loaded += [v for k, v in attributes if k in ("src", "href") and v]


def test_page_loads_nothing_and_says_everything(small, tmp_path):
    judged = reproduce(tmp_path, [6], workers=1)
    page = write_report(judged, tmp_path / "report.html").read_text("utf-8")
    links = Links()
    links.feed(page)
    assert all(v.startswith(("#", "data:")) for v in links.loaded)
    assert links.tags.count("article") == 6
    for said in (
        "prefers-color-scheme: dark",
        "it may be.",
        "if so",
        "critical_radius(",
        "0.3333 m",
    ):
        assert said in page
    assert "3 differ" in page


def test_shipped_claims_are_whole():
    names = set()
    for number in CHAPTERS:
        spec = chapter(number)
        assert any(c.quick for c in spec.claims), f"chapter {number} has nothing quick"
        for c in spec.claims:
            assert (number, c.name) not in names
            names.add((number, c.name))
            for trial in filter(None, (c.stated, c.conditioned)):
                assert trial.scenario is None or trial.scenario in scenario_names()
    with pytest.raises(ScenarioError, match="chapter 1 has no claims"):
        chapter(1)


def test_every_scenario_of_the_thesis_is_in_a_claim():
    used = {
        t.scenario
        for n in CHAPTERS
        for c in chapter(n).claims
        for t in filter(None, (c.stated, c.conditioned))
    }
    assert {n for n in scenario_names() if n.startswith("ch")} <= used


def test_command_refuses_a_chapter_without_claims(tmp_path):
    done = called("reproduce", "--chapter", "9", "--out", tmp_path)
    assert done.returncode == 2
    assert "chapter 9 has no claims" in done.stderr
    assert list(tmp_path.iterdir()) == []
