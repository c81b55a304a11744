"""What a user defines is seen in the page: constraints, obstacles, the goal, trailers; and keys."""

import numpy as np
import pytest
from matplotlib.path import Path as Outline

import holdfast as hf
from holdfast.maths.expressions.numeric import evaluated
from holdfast.maths.nonholonomic.bodies import bodies
from holdfast.presentation.figures import style
from tests.browser import needs_browser, opened

pytestmark = [needs_browser, pytest.mark.heavy]  # each opens a browser

RIG = """
[scenario]
title = "My rig among obstacles"
kind = "closed-loop"

[system]
states = { x = { unit = "m" }, y = { unit = "m" }, psi = { unit = "rad", angle = true }, phi = { unit = "rad", angle = true } }
inputs = { w = { unit = "rad/s", bounds = [-1, 1] } }
empirical = "a speed of 1"
rates = { x = "cos(psi)", y = "sin(psi)", psi = "w", phi = "sin(psi - phi)/length" }
parameters = { length = { value = 1.25, unit = "m" } }

[law]
outputs = { w = "sin(atan2(-y, 8 - x) - psi)" }

[region]
parameters = { size = { value = 1.0, unit = "m" } }

[region.constraints]
rock = { expression = "size - sqrt((x - 3)**2 + (y - 0.5)**2)", unit = "m" }
fence = { expression = "y - 3", unit = "m" }
slanted = { expression = "y - 2 - sin(psi)*x", unit = "m" }
hitch = { expression = "cos(1) - cos(psi - phi)", unit = "1" }

[goal]
constraints = { near = { expression = "sqrt((x - 6)**2 + y**2) - 0.002", unit = "m" } }

[starts]
states = [{ x = 0, psi = 0.5, phi = 0.2 }, { x = -1, y = 1 }]

[run]
horizon = 8
"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """The file of a vehicle with a trailer, and its page."""
    folder = tmp_path_factory.mktemp("rig")
    (folder / "rig.toml").write_text(RIG, "utf-8")
    (folder / "rig.html").write_text(hf.explore(str(folder / "rig.toml")), "utf-8")
    return folder


SHOWN = """(() => {
  const back = ([px, py]) => plane.place(px, py);
  return levels.of(plane, mainLoops[0]).map((s) => ({ role: s.role, number: s.number ?? null, mark: s.mark ? back(s.mark) : null,
    points: (s.lines || []).flat().map(back), area: (s.area || []).map((polygon) => polygon.map(back)) }));
})()"""


def levels_of(page):
    """What is drawn of the constraints, in their order, of the forbidden area and of the goal."""
    page.until("!running && !stale && page.drawn")
    shown = page.page.evaluate(SHOWN)
    parts = {s["role"]: s for s in shown if s["role"] != "constraint"}
    return [s for s in shown if s["role"] == "constraint"], parts


def test_lines_lie_where_the_inequalities_are_zero_and_follow_their_parameters(chromium, rig):
    with opened(chromium, rig / "rig.html") as page:
        for size in (1.0, 0.6):
            page.page.evaluate(f"state.values.size = {size}; changed()")
            (rock, fence, slanted), parts = levels_of(page)
            away = np.hypot(*(np.array(rock["points"]) - [3, 0.5]).T)
            np.testing.assert_allclose(away, size, rtol=0.01)
            np.testing.assert_allclose(np.array(fence["points"])[:, 1], 3, atol=1e-6)
            inside = [
                Outline(polygon).contains_point((3, 0.51)) for polygon in parts["forbidden"]["area"]
            ]
            assert any(inside)
        x, y = np.array(slanted["points"]).T  # at the heading of now
        np.testing.assert_allclose(y, 2 + np.sin(0.5) * x, atol=1e-3)
        assert not page.errors


def test_a_goal_that_is_smaller_than_a_point_is_marked(chromium, rig):
    with opened(chromium, rig / "rig.html") as page:
        _, parts = levels_of(page)
        np.testing.assert_allclose(parts["goal"]["mark"], [6, 0], atol=0.01)


def test_lines_are_named_and_hidden_by_a_click(chromium, rig):
    with opened(chromium, rig / "rig.html") as page:
        names = page.page.locator("#lines li").all_inner_texts()
        assert names == ["rock", "fence", "slanted, at psi of now", "goal"]
        page.page.uncheck("#levels")
        assert page.page.locator("#lines li").count() == 0
        assert page.page.evaluate("levels.of(plane, mainLoops[0]).length") == 0


def test_other_axes_have_the_lines_of_their_states(chromium, rig):
    with opened(chromium, rig / "rig.html") as page:
        page.page.select_option("[aria-label='state across']", "psi")
        page.page.select_option("[aria-label='state up']", "phi")
        assert page.page.locator("#lines li").all_inner_texts() == [
            "slanted, at x, y of now", "hitch",
        ]  # fmt: skip
        page.until("page.fanIsNow && !running && !stale")
        page.page.wait_for_timeout(700)  # until it has fitted its view
        page.page.evaluate("plane.box = { x0: -2, x1: 2, y0: -2, y1: 2 }; page.drawn = false")
        (_, hitch), _ = levels_of(page)
        psi, phi = np.array(hitch["points"]).T
        np.testing.assert_allclose(np.cos(psi - phi), np.cos(1), atol=0.01)


def test_trailer_is_where_the_figure_has_it(chromium, rig):
    system = hf.load_scenario(str(rig / "rig.toml")).system
    values = {q.symbol: v for q, v in zip(system.states, (0, 0, 0.5, 0.2), strict=True)}
    values |= {p.symbol: p.value for p in system.parameters}
    with opened(chromium, rig / "rig.html") as page:
        page.until("page.drawn")
        numbers = page.numbers("page.sceneNow")
        scene = page.page.evaluate("data.scene.filter(isBody)")
        assert [s["role"] for s in scene] == ["vehicle", "trailer"]
        for entry, body in zip(scene, bodies(system), strict=True):
            corners = [e for corner in body.corners for e in corner]
            wanted = evaluated((*body.apex, body.heading, *corners), values)
            at = entry["at"]
            np.testing.assert_allclose(numbers[at : at + len(wanted)], wanted, atol=1e-12)
        assert page.page.evaluate("page.posesNow().length") == 0  # no arrow over the vehicle


def test_arrow_keys_work_after_a_click(chromium, rig):
    with opened(chromium, rig / "rig.html") as page:
        for place in ((300, 300), (500, 200)):  # on the plane, and once more where it has the focus
            page.page.evaluate("document.activeElement.blur()")
            page.page.mouse.click(*place)
            before = page.page.evaluate("state.start")
            page.page.keyboard.press("ArrowRight")
            after = page.page.evaluate("state.start")
            assert after[0] > before[0]
            assert after[1:] == before[1:]
        assert page.page.evaluate("document.activeElement.id") == "plane"


def test_lines_of_the_page_have_the_dashes_of_the_figures(chromium, rig):
    with opened(chromium, rig / "rig.html") as page:
        page.page.wait_for_selector("#outcomes li")
        dashes = page.page.evaluate("data.look.outcome_dashes")
        assert [tuple(d) for d in dashes] == [style.OUTCOME_DASHES[o] for o in hf.Outcome]
        marks = page.page.evaluate(
            "[...document.querySelectorAll('#lines line')].map((e) => e.getAttribute('stroke-dasharray'))"
        )
        assert marks[0] == "none"
        assert len(set(marks)) == len(marks)
