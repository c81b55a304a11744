"""A scenario in a page: its runs are those of `simulate`, and what is dragged changes them."""

import io
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import holdfast as hf
from holdfast.errors import ScenarioError
from holdfast.scenario.files import read_text
from holdfast.scenario.kinds.kernel import KernelScenario
from tests.browser import needs_browser, opened

pytestmark = needs_browser


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page of a scenario, written once."""
    pages = {}

    def page(name, *overrides):
        key = (name, overrides)
        if key not in pages:
            pages[key] = tmp_path_factory.mktemp("page") / "explorer.html"
            pages[key].write_text(hf.explore(name, overrides), "utf-8")
        return pages[key]

    return page


SHORT = ("run.horizon=10",)
"""For pages of which all starts are drawn, but not looked at."""

RUNS = """(() => {
  const drawn = data.starts.map((_, k) => drawnOf(k)), own = drawn[0] ? drawn : undefined;
  return mainLoops[0].runs(data.starts, { ...given(), first: 0 }, own);
})()"""

PADDED = """(() => {{
  const out = new Float64Array(all.length * {1}).fill({2});
  all.forEach((run, k) => out.set(run.{0} || [], k * {1}));
  return out;
}})()"""


@pytest.mark.few("ch3-noise-overrides1")
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("inspection", ("run.horizon=20",)),  # modes, a safeguard, 200 random starts
        ("ch3-noise", ("run.horizon=10", "run.seed=9007199254740993")),  # no double has this seed
        ("ch6-corridor", ()),  # a formation among walls
        *(
            pytest.param(*case, marks=pytest.mark.heavy)
            for case in (
                ("inspection-current", ("run.horizon=10",)),  # an observer, any current
                ("ch5-any-current", ("run.delay=0.1", "run.horizon=10")),  # another vehicle
            )
        ),
    ],
)
def test_every_sample_of_200_runs_is_that_of_simulate(chromium, written, name, overrides):
    found = hf.load_scenario(name, overrides).run().arrays
    count = min(200, found.sizes["run"])
    with opened(chromium, written(name, *overrides)) as page:
        page.page.evaluate(f"window.all = {RUNS}")
        for quantity, ended in (
            ("state", "NaN"),
            ("input", "NaN"),
            ("constraint", "NaN"),
            ("mode", "-1"),
        ):
            wanted = found[quantity].values[:count].astype(float)
            got = page.numbers(PADDED.format(quantity, wanted[0].size, ended))
            np.testing.assert_array_equal(got.reshape(wanted.shape), wanted, err_msg=quantity)
        outcome = page.numbers("Float64Array.from(all, (r) => r.outcome)")
        np.testing.assert_array_equal(outcome, found["outcome"].values[:count])
        left = page.numbers("Float64Array.from(all, (r) => r.exitTime)")
        np.testing.assert_array_equal(left, found["exit_time"].values[:count])
        assert not page.errors


@pytest.mark.heavy
def test_the_page_asks_for_nothing_and_is_not_blank(chromium, written):
    with opened(chromium, written("inspection")) as page:
        page.page.wait_for_selector("#outcomes li")
        assert "200 of 200" in page.page.inner_text("#outcomes")
        for canvas in ("plane", "strips"):
            shot = Image.open(io.BytesIO(page.page.locator(f"#{canvas}").screenshot()))
            assert len(shot.convert("RGB").getcolors(10**6)) > 50
        assert page.requests == [page.page.url]
        assert not page.errors


@pytest.mark.heavy
def test_the_start_and_the_current_are_dragged_and_the_run_follows(chromium, written):
    with opened(chromium, written("inspection")) as page:
        before = page.page.inner_text("#status")
        for kind, by in (
            ("start", (60, -80)),
            ("heading", (10, 40)),
            ("current", (20, 10)),
            ("target", (15, 25)),
        ):
            old = page.page.evaluate("JSON.stringify([state, page.run.goalTime])")
            place = page.page.evaluate(
                f"""(() => {{
                  const box = canvas.getBoundingClientRect(), h = plane.handles.find((x) => x.kind === "{kind}");
                  return [box.x + h.px, box.y + h.py];
                }})()"""
            )
            page.page.mouse.move(*place)
            page.page.mouse.down()
            page.page.mouse.move(place[0] + by[0], place[1] + by[1], steps=5)
            page.page.mouse.up()
            page.page.evaluate("follow()")
            page.until("!running && !stale")
            assert page.page.evaluate("JSON.stringify([state, page.run.goalTime])") != old, kind
        assert page.page.inner_text("#status") != before
        assert not page.errors


@pytest.mark.heavy
def test_a_copied_scenario_reproduces_what_is_seen(chromium, written, tmp_path):
    with opened(chromium, written("inspection")) as page:
        page.page.evaluate(
            """(() => {
                            Object.assign(state, { delay: 0.06, seed: 7 });
              state.start[0] = -1.7; state.start[2] = 0.123456789; state.disturbance[1] = 0.05;
              state.values.k1 = 0.17; state.values.thrust_limit = 4.2;
              state.truth.mass = 4.1; state.uniform[0] = 0.002;
              changed();
            })()"""
        )
        page.until("!running && !stale")
        run = page.page.evaluate("({ count: page.run.count, outcome: page.run.outcome })")
        state = page.numbers("page.run.state")
        file = tmp_path / "seen.toml"
        file.write_text(page.page.evaluate("asScenario()"), "utf-8")
    found = hf.load_scenario(str(file)).run().arrays
    assert int(found["outcome"].values[0]) == run["outcome"]
    seen = found["state"].values[0][: run["count"]]
    np.testing.assert_array_equal(state.reshape(seen.shape), seen)


def repeated(page, file):
    """The states of the page's run, and those of a run of its copy."""
    file.write_text(page.page.evaluate("asScenario()"), "utf-8")
    state = page.numbers("page.run.state")
    seen = hf.load_scenario(str(file)).run().arrays["state"].values[0]
    seen = seen[np.isfinite(seen).all(axis=1)]
    return state.reshape(-1, seen.shape[1]), seen


@pytest.mark.heavy
def test_a_copied_formation_has_the_start_of_its_file(chromium, written, tmp_path):
    with opened(chromium, written("ch6-corridor")) as page:
        np.testing.assert_array_equal(*repeated(page, tmp_path / "formation.toml"))
        page.page.evaluate("state.start[3] += 0.1; changed()")
        page.page.click("#toml")
        assert "planned from its start" in page.page.inner_text("#notice")


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("seen-target", ("grid.nodes=31",)),  # optimal inputs
        *(
            pytest.param(name, ("grid.nodes=31", "march.times=5"), marks=pytest.mark.heavy)
            for name in ("ch7-safety-law", "ch7-capture-basin")  # a filter; until the goal
        ),
    ],
)
def test_a_copied_kernel_is_that_of_closed_loops(chromium, written, tmp_path, name, overrides):
    with opened(chromium, written(name, *overrides)) as page:
        page.page.evaluate("if (state.disturbance.length) state.disturbance[0] = 0.01; changed()")
        page.until("!running && !stale")
        np.testing.assert_array_equal(*repeated(page, tmp_path / "kept.toml"))


def test_every_robot_of_a_formation_is_dragged(chromium, written):
    with opened(chromium, written("ch6-corridor")) as page:
        place = page.page.evaluate(
            """(() => {
              const box = canvas.getBoundingClientRect(), h = plane.handles.find((x) => x.kind === "start" && x.pose === 1);
              return [box.x + h.px, box.y + h.py];
            })()"""
        )
        before = page.page.evaluate("state.start")
        page.page.mouse.move(*place)
        page.page.mouse.down()
        page.page.mouse.move(place[0] + 20, place[1] - 10, steps=3)
        page.page.mouse.up()
        after = page.page.evaluate("state.start")
        changed = [a != b for a, b in zip(after, before, strict=True)]
        assert changed == [False, False, False, True, True, False]
        page.page.focus("#plane")
        page.page.keyboard.press("[")  # keys move what was dragged
        assert page.page.evaluate("state.start[5]") > before[5]


@pytest.mark.heavy
def test_the_first_picture_has_all_starts_in_view(chromium, written):
    with opened(chromium, written("inspection", *SHORT)) as page:
        box = page.page.evaluate("JSON.stringify(plane.box)")
        page.page.wait_for_selector("#outcomes li")
        page.page.wait_for_timeout(200)
        assert page.page.evaluate("JSON.stringify(plane.box)") == box


def test_angles_are_read_in_degrees_and_kept_in_radians(chromium, written):
    with opened(chromium, written("ch3-noise", 'figures.plane=["x", "psi"]')) as page:
        assert page.page.evaluate("[page.axisLabel(0), page.axisLabel(1)]") == [
            "x [m]",
            "psi [deg]",
        ]
        field = page.page.get_by_label("psi [deg], number", exact=True)
        field.fill("90")
        field.press("Enter")
        assert page.page.evaluate("state.start[2]") == np.pi / 2
        text = page.page.get_by_label("psi [deg]", exact=True).get_attribute("aria-valuetext")
        assert text == "90 deg"


@pytest.mark.heavy
def test_a_page_prints_the_picture_the_status_and_the_numbers_on_white(chromium, written):
    with opened(chromium, written("inspection", *SHORT), color_scheme="dark") as page:
        assert page.page.evaluate("page.colours().page") != "#ffffff"
        page.page.emulate_media(media="print")
        page.until("page.colours().page === '#ffffff'")
        for shown in ("#plane", "#strips", "#status", "#numbers"):
            assert page.page.locator(shown).is_visible(), shown
        for control in ("button", "input", "select", "summary"):
            assert not any(e.is_visible() for e in page.page.locator(control).all()), control
        assert "psi = " in page.page.inner_text("#numbers")
        shot = Image.open(io.BytesIO(page.page.screenshot(full_page=True))).convert("RGB")
        colours = {c: k for k, c in shot.getcolors(10**6)}
        assert colours[255, 255, 255] > 0.7 * shot.width * shot.height


NAMED = {
    "button", "checkbox", "combobox", "slider", "spinbutton", "textbox", "application", "image",
}  # fmt: skip


def test_every_control_has_a_name_for_a_screen_reader(chromium, written):
    with opened(chromium, written("inspection", *SHORT)) as page:
        page.page.evaluate(
            "document.querySelectorAll('details').forEach((d) => { d.open = true; })"
        )
        session = page.page.context.new_cdp_session(page.page)
        nodes = session.send("Accessibility.getFullAXTree")["nodes"]
        roles = [n.get("role", {}).get("value", "").lower() for n in nodes]
        found = [(r, n.get("name", {}).get("value", "")) for r, n in zip(roles, nodes, strict=True)]
        named = [(role, name) for role, name in found if role in NAMED]
        assert {"button", "slider", "spinbutton", "application", "image"} <= {r for r, _ in named}
        assert [role for role, name in named if not name] == []
        status = page.page.locator("#status")
        assert (status.get_attribute("role"), status.get_attribute("aria-live")) == (
            "status", "polite",
        )  # fmt: skip


def test_a_phone_shows_the_whole_page_without_scrolling_sideways(chromium, written):
    with opened(chromium, written("inspection", *SHORT), width=390, height=844) as page:
        assert page.page.evaluate("document.documentElement.scrollWidth") <= 390
        assert page.page.locator("#plane").bounding_box()["width"] > 340


def test_keys_move_the_start_and_play(chromium, written):
    with opened(chromium, written("inspection", *SHORT)) as page:
        before = page.page.evaluate("state.start[0]")
        page.page.focus("#plane")
        page.page.keyboard.press("ArrowRight")
        assert page.page.evaluate("state.start[0]") > before
        page.page.keyboard.press("Space")
        assert page.page.inner_text("#play") == "Pause"
        page.until("page.time > 0")


@pytest.mark.parametrize(
    ("name", "overrides", "says"),
    [
        ("ch7-six-states", ("grid.nodes=31",), "take fewer: --set grid.nodes"),
        ("nowhere", (), "nowhere"),
    ],
)
def test_what_is_no_page_is_said_before_anything_is_written(name, overrides, says):
    with pytest.raises(ScenarioError, match=says):
        hf.explore(name, overrides)


def test_the_law_alone_is_that_of_the_file_without_its_filter(chromium, written, tmp_path):
    with opened(chromium, written("inspection", *SHORT)) as page:
        page.page.select_option("#variant", label="the law alone")
        page.until("!running && !stale")
        assert page.page.evaluate("page.run.nominal === undefined")
        state, file = page.numbers("page.run.state"), tmp_path / "alone.toml"
        file.write_text(page.page.evaluate("asScenario()"), "utf-8")
        assert "[safeguard]" not in file.read_text("utf-8")
    seen = hf.load_scenario(str(file)).run().arrays["state"].values[0]
    seen = seen[np.isfinite(seen).all(axis=1)]
    np.testing.assert_array_equal(state.reshape(seen.shape), seen)


def test_a_kernel_has_its_law_and_its_slice(chromium, written):
    with opened(chromium, written("seen-target", "grid.nodes=31")) as page:
        page.page.wait_for_selector("#outcomes li")
        assert page.page.inner_text("#outcomes") == "stayed: 200 of 200"
        inside = page.page.evaluate("[page.slice.at(1.2, 0) > 0, page.slice.at(0.4, 1) > 0]")
        assert inside == [True, False]
        assert not page.errors


REACH = ("grid.nodes=15", "march.horizon=3", 'march.times=["1 s", "2 s", "3 s"]')


@pytest.mark.heavy
def test_a_set_without_a_law_is_cut_by_any_two_states_at_any_of_its_times(chromium, written):
    value = hf.load_scenario("ch7-forward-reach", REACH).solve()
    places = np.random.default_rng(0).uniform((-0.7, -2.5), (0.7, 2.5), (500, 2))
    wanted = value.at(np.column_stack([np.full(500, 0.31), places]), time=2)
    with opened(chromium, written("ch7-forward-reach", *REACH)) as page:
        assert "The set alone: no law decides" in page.page.inner_text("header")
        assert page.page.inner_text("#status") == "The state is in the set."
        page.page.select_option("[aria-label='state across']", "v")
        assert page.page.evaluate("state.axes") == [1, 0]  # they change places
        page.page.select_option("[aria-label='state up']", "r")
        page.page.evaluate(
            f"""(() => {{ state.start = [0.31, 0.7, 0]; page.time = 2; changed();
            window.places = {places.tolist()}; }})()"""
        )
        page.until("page.drawn")
        assert page.page.inner_text("#status") == "The state is outside the set."
        levels = page.numbers("Float64Array.from(places, ([x, y]) => page.slice.at(x, y))")
        link = page.page.evaluate("asLink()")
        assert not page.errors
    near = np.abs(wanted) < 0.01 * np.abs(value.values()).max()
    assert 0.05 < (wanted > 0).mean() < 0.95
    assert near.mean() < 0.1
    np.testing.assert_array_equal((levels > 0)[~near], (wanted > 0)[~near])
    with opened(chromium, written("ch7-forward-reach", *REACH), link=link) as page:
        assert page.page.evaluate("[planeX, planeY]") == [1, 2]
        assert page.page.inner_text("#now") == "3 s"
        page.page.select_option("#speed", "0.5")
        page.page.click("#play")  # from the first time on
        page.until("page.playing && page.time > 1.1")
        time = page.page.evaluate("(play(false), draw(), page.time)")
        assert page.page.inner_text("#now") == f"{round(time)} s"  # the nearest that is stored
        assert not page.errors


def test_a_kernel_too_large_for_its_law_is_shown_alone(chromium, written, monkeypatch):
    monkeypatch.setattr("holdfast.studies.exploration.MOST_BYTES", 1000)
    with opened(chromium, written("seen-target", "grid.nodes=21")) as page:
        assert "its law needs 0 MiB" in page.page.inner_text("header")
        assert page.page.inner_text("#status") == "The state is in the set."
        assert page.page.locator("#strips").is_hidden()
        assert page.page.locator("#play").is_hidden()


BOX = "JSON.stringify(plane.box)"


def test_plus_and_minus_zoom(chromium, written):
    with opened(chromium, written("inspection", *SHORT)) as page:
        page.page.focus("#plane")
        width = "plane.box.x1 - plane.box.x0"
        before = page.page.evaluate(width)
        page.page.keyboard.press("+")
        assert page.page.evaluate(width) == pytest.approx(0.8 * before)
        page.page.keyboard.press("-")
        assert page.page.evaluate(width) == pytest.approx(before)


def test_reset_and_a_link_show_the_whole_of_other_axes(chromium, written):
    """From the axes of other states back, and to others by the address alone."""
    with opened(chromium, written("inspection", *SHORT)) as page:
        page.until("page.fanIsNow")
        page.page.click("#fit")
        first = page.page.evaluate(BOX)
        page.page.select_option("[aria-label='state across']", "psi")
        page.page.evaluate("state.start[0] = -1.9; changed()")
        page.page.click("#reset")
        page.page.wait_for_timeout(700)
        page.until("page.fanIsNow && !running && page.drawn")
        page.page.click("#fit")
        assert page.page.evaluate(BOX) == first
        page.page.evaluate("""location.hash = encodeURIComponent('{"axes":[3,4]}')""")
        page.until("planeX === 3 && page.fanIsNow")
        page.page.wait_for_timeout(700)
        assert page.page.evaluate("plane.box.x0 > -1 && plane.box.x1 > 0")
        page.page.focus("#plane")
        before = page.page.evaluate("state.start[2]")
        page.page.keyboard.press("[")  # it turns, though the heading is on no axis
        assert page.page.evaluate("state.start[2]") > before
        assert not page.errors


def test_the_plane_shows_any_two_states_of_a_run(chromium, written):
    with opened(chromium, written("inspection", *SHORT)) as page:
        page.page.select_option("[aria-label='state across']", "u")
        page.page.select_option("[aria-label='state up']", "r")
        page.until("!running && !stale && page.drawn && page.fanIsNow")
        assert page.page.evaluate("page.sceneNow") is None
        ends = page.page.evaluate("page.fan.map(({ xy }) => Array.from(xy.slice(0, 2)))")
        assert ends == [[0, 0]] * 200
        before = page.page.evaluate("state.start[3]")
        page.page.focus("#plane")
        page.page.keyboard.press("ArrowRight")
        assert page.page.evaluate("state.start[3]") > before
        assert not page.errors


def test_a_law_of_another_controller_is_refused(tmp_path):
    text = re.sub(
        r"\[law\].*?\[safeguard\]",
        "[law]\nexternal = true\n\n[safeguard]",
        read_text("inspection")[1],
        flags=re.S,
    )
    (tmp_path / "mine.toml").write_text(text, "utf-8")
    with pytest.raises(ScenarioError, match="commanded by another controller"):
        hf.explore(str(tmp_path / "mine.toml"))


@pytest.mark.heavy
def test_a_link_holds_what_is_seen(chromium, written):
    with opened(chromium, written("inspection", *SHORT)) as page:
        page.page.evaluate(
            "state.start[1] = 0.7; state.values.k1 = 0.15; state.variant = 1; changed()"
        )
        page.until("!running && !stale")
        state, link = page.numbers("page.run.state"), page.page.evaluate("asLink()")
    with opened(chromium, written("inspection", *SHORT), link=link) as page:
        assert page.page.input_value("#variant") == "1"
        np.testing.assert_array_equal(page.numbers("page.run.state"), state)
    with opened(
        chromium, written("inspection", *SHORT), link="#%7B%22start%22%3A%5B1%5D%7D"
    ) as page:
        assert "not understood" in page.page.inner_text("#notice")


@pytest.mark.heavy
def test_a_number_outside_its_limits_is_refused_and_the_page_goes_on(chromium, written):
    with opened(chromium, written("inspection")) as page:
        for what, value in (("delay [s]", "-0.5"), ("delay [s]", "4.5"), ("noise of x [m]", "-1")):
            field = page.page.get_by_label(f"{what}, number")
            field.fill(value)
            field.press("Enter")
            assert page.page.evaluate("[state.delay, state.uniform[0]]") == [0, 0]
            assert not field.evaluate("(x) => x.validity.valid")
        page.page.evaluate("state.delay = 99; changed()")  # as no control does
        page.until("!running")
        assert "The loop failed" in page.page.inner_text("#status")
        page.page.evaluate("state.delay = 0; changed()")
        page.until("!running && !stale")
        assert "reached the goal" in page.page.inner_text("#status")


@pytest.mark.heavy
def test_a_capture_basin_ends_at_its_goal_as_its_promise_does(chromium, written):
    with opened(chromium, written("ch7-capture-basin", "grid.nodes=31", "march.times=5")) as page:
        page.until("page.fanSeconds !== null")
        assert page.page.inner_text("#outcomes") == "reached goal: 200 of 200"


SHIPPED = [p.stem for p in sorted(Path(str(resources.files("holdfast.scenarios"))).glob("*.toml"))]


@pytest.mark.heavy
@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scenario_has_a_page_whose_copy_runs_or_is_refused(chromium, name, tmp_path):
    try:
        (tmp_path / "page.html").write_text(hf.explore(name), "utf-8")
    except ScenarioError:
        return
    with opened(chromium, tmp_path / "page.html") as page:
        page.page.evaluate("if (!data.fixed) state.start[0] += 0.01; changed()")
        page.until("!running && !stale")
        assert not page.errors
        if page.page.evaluate("data.tables === null"):
            return
        state, file = page.numbers("page.run.state"), tmp_path / "copy.toml"
        file.write_text(page.page.evaluate("asScenario()"), "utf-8")
    loaded = hf.load_scenario(str(file))
    if not hasattr(loaded, "starts"):
        return
    seen = loaded.run().arrays["state"].values[0]
    seen = seen[np.isfinite(seen).all(axis=1)]
    shown = state.reshape(-1, seen.shape[1])[: len(seen)]
    if isinstance(
        hf.load_scenario(name), KernelScenario
    ):  # its copy is another file, whose rates may be written in another order
        np.testing.assert_allclose(shown, seen, rtol=1e-12, atol=1e-15)
    else:
        np.testing.assert_array_equal(shown, seen)
