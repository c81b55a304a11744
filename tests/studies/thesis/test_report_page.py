"""The report in a real browser: on a wide screen, on a phone, in the dark, and on paper."""

import numpy as np
import pytest

from holdfast.execution.simulation.settings import OUTCOMES
from holdfast.presentation.figures import style
from holdfast.presentation.html.interactive import FINENESS, INK, MOST_RUNS, paths_data
from holdfast.scenario.load import load_scenario
from holdfast.studies.thesis.report import Explorer, explored, write_report
from tests.browser import needs_browser, opened
from tests.judged_claims import judged_in

DRAWN = "[...document.querySelectorAll('[data-plot]')].every((p) => p.drawn)"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    one = judged_in(folder)
    page = folder / "explorers" / "page.html"
    page.parent.mkdir()
    page.write_text("<title>dragged</title>")
    pages = {
        explored(one.claim.stated): Explorer(page),
        explored(one.claim.conditioned): Explorer(refusal="it has one state"),
    }
    return write_report([one], folder / "report.html", pages)


@needs_browser
def test_nothing_is_wider_than_a_phone_and_every_plot_is_drawn_there(chromium, report):
    with opened(chromium, report, width=390, height=844) as page:
        page.page.evaluate("plots[1].style.setProperty('--tall', 0.2)")  # a long corridor
        page.page.evaluate("plots.forEach((p) => { if (!p.drawn) draw(p); })")
        page.until(DRAWN)
        assert page.page.evaluate("document.documentElement.scrollWidth") <= 390
        for plot in page.page.locator("[data-plot]").all():
            assert 300 < plot.bounding_box()["width"] <= 390
            assert plot.locator(".scatterlayer path.js-line").count() > 5
        assert not page.errors


@needs_browser
def test_paper_has_every_picture_and_no_dark_or_empty_place(chromium, report):
    with opened(chromium, report, color_scheme="dark") as page:
        page.page.emulate_media(media="print", color_scheme="dark")
        shown = (
            """(what) => [...document.querySelectorAll(what)].filter((e) => e.checkVisibility())"""
        )
        count = "(what) => (" + shown + ")(what).length"
        assert page.page.evaluate(count, "[data-plot], button, .drag") == 0
        assert (
            page.page.evaluate(count, "figure img") == 2 == page.page.locator("[data-plot]").count()
        )
        loaded = "[...document.images].every((i) => i.complete && i.naturalWidth > 0)"
        page.until(loaded)
        assert page.page.locator("img[loading]").count() == 0
        assert (
            page.page.evaluate("getComputedStyle(document.body).backgroundColor")
            == "rgb(255, 255, 255)"
        )
        assert page.page.evaluate("getComputedStyle(document.images[0]).filter") == "none"


@needs_browser
def test_lines_of_ink_are_light_in_the_dark_and_the_link_opens_from_the_disk(chromium, report):
    with opened(chromium, report, color_scheme="dark") as page:
        page.page.evaluate(
            f"plots[0].nextElementSibling.textContent = plots[0].nextElementSibling.textContent.replaceAll('{style.OUTCOMES[1]}', '{INK}')"
        )
        page.page.evaluate("draw(plots[0])")
        page.until("plots[0].drawn")
        text = page.page.evaluate("getComputedStyle(root).getPropertyValue('--text')")
        colours = page.page.evaluate("plots[0].data.map((t) => t.line.color)")
        assert text in colours
        assert INK not in colours
        page.page.click(".drag")
        assert page.page.title() == "dragged"
        assert page.requests == [report.as_uri(), (report.parent / "explorers/page.html").as_uri()]
        assert not page.errors


def test_the_trial_under_the_condition_says_so(report):
    told = report.read_text()
    assert "as stated" in told
    assert "with the condition" in told
    assert "No page to drag: it has one state." in told


@pytest.fixture(scope="module")
def result():
    return load_scenario("ch4-unicycle", ["run.horizon=10"], 60).run()


@pytest.mark.heavy
def test_every_point_of_a_path_is_on_the_line_that_is_drawn(result):
    drawn = paths_data(result, ("x", "y"))
    limits = [drawn["layout"][a]["range"] for a in ("xaxis", "yaxis")]
    size = max(b - a for a, b in limits)
    for trace, states in zip(drawn["data"], result.arrays["state"].values, strict=False):
        time = result.arrays["time"].values
        ended = np.isfinite(states).all(axis=1)
        at, whole = np.array(trace["customdata"]), states[ended][:, :2]
        assert at[0] == 0
        assert at[-1] == pytest.approx(time[ended][-1])
        # against the drawn line at the same time, which cannot be nearer than the line
        k = np.searchsorted(at, time[ended] - 1e-9).clip(1, len(at) - 1)
        line = np.column_stack([trace["x"], trace["y"]])
        a, along = line[k - 1], line[k] - line[k - 1]
        length = np.maximum((along**2).sum(axis=1), 1e-300)
        part = (((whole - a) * along).sum(axis=1) / length).clip(0, 1)
        away = np.hypot(*(whole - a - part[:, None] * along).T)
        assert away.max() <= size * (FINENESS + 1e-5)
        assert len(at) < len(whole) / 2


@pytest.mark.heavy
def test_the_first_of_every_outcome_is_drawn_though_it_comes_late(result):
    outcome = result.dataset["outcome"].values.copy()
    outcome[:] = 1
    outcome[[50, 52, 54, 56]] = 2
    data = result.dataset.assign(outcome=("run", outcome, result.dataset["outcome"].attrs))
    drawn = paths_data(type(result)(data, result.scene, result.parameters), ("x", "y"))
    lines = [t for t in drawn["data"] if t["name"] in OUTCOMES]
    assert sum(t["name"] == "left region" for t in lines) == 3
    assert sum(t["name"] == "reached goal" for t in lines) == MOST_RUNS
    assert len({t["line"]["color"] for t in lines}) == 2
    assert drawn["layout"]["meta"]["says"] == "43 of 60 paths"
