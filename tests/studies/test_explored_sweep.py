"""The table of a sweep in a page: the cell under the pointer runs, with the numbers of the table."""

import json
import shlex
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr

import holdfast as hf
from holdfast.errors import OutputError, ScenarioError
from tests.browser import needs_browser, opened
from tests.scenario_files import CART, DRIFTING

pytestmark = needs_browser

IN_A_CURRENT = (
    DRIFTING.replace("w = {", 'Vx = { role = "current",').replace("v + w", "v + Vx").replace('w = "push"', "Vx = -0.1")
    .replace('[varied.draws]\npush = { range = [0.0, 0.3], unit = "m/s" }\n', "")
)  # fmt: skip

COUNTS = """(() => {
  const labels = Object.keys(data.look.outcomes), found = {};
  for (const { outcome } of page.fan) found[labels[outcome]] = (found[labels[outcome]] || 0) + 1;
  return found;
})()"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("swept")
    (found / "cart.toml").write_text(DRIFTING, "utf-8")
    (found / "boat.toml").write_text(IN_A_CURRENT, "utf-8")
    return found


@pytest.fixture(scope="module")
def swept(folder):
    """The table of a sweep and its page, made once."""
    made = {}

    def of(scenario, over, **options):
        key = (scenario, over, *options.items())
        if key not in made:
            place = folder / f"sweep{len(made)}"
            place.mkdir()
            with ThreadPoolExecutor(2) as pool:
                found = hf.sweep(scenario, over, executor=pool, **options)
            found.save(place / "sweep.nc")
            (place / "page.html").write_text(hf.explore(place), "utf-8")
            made[key] = found, place / "page.html"
        return made[key]

    return of


@pytest.fixture
def cart(folder):
    return str(folder / "cart.toml")


@pytest.fixture
def boat(folder):
    return str(folder / "boat.toml")


OVER = ("k=0.5,1.5", "push=0,0.1", "wall=1.5,2", "noise.normal.x=0,0.02", "run.delay=0,1.5")
"""A gain, a number that is drawn, one that decides which states are starts, noise, a delay."""

CURRENT = ("current.speed=0.1,0.3", "k=4,5")


def compared(page, found, cell, scenario, **options):
    """The fan of a cell has the outcomes of the table, and its run is that of `simulate`."""
    data, outcomes = found.dataset, page.page.evaluate("Object.keys(data.look.outcomes)")
    page.page.evaluate(f"sweep.choose({cell})")
    page.until("!running && !stale && page.fanIsNow && page.fan.length")
    columns = {label: label.replace(" ", "_") for label in outcomes}
    wanted = {n: int(data[c].values.ravel()[cell]) for n, c in columns.items() if c in data}
    assert page.page.evaluate(COUNTS) == {n: count for n, count in wanted.items() if count}
    assert "All of them end here as in the table." in page.page.inner_text("#cell")
    settings = [w for w in shlex.split(str(data["settings"].values.ravel()[cell])) if w != "--set"]
    changes = [*options.get("overrides", ()), *settings]
    run = hf.load_scenario(scenario, changes, options.get("runs")).run(part=range(1)).arrays
    seen = run["state"].values[0]
    seen = seen[np.isfinite(seen).all(axis=1)]
    np.testing.assert_array_equal(page.numbers("page.run.state").reshape(-1, seen.shape[1]), seen)


@pytest.mark.heavy
def test_a_cell_runs_with_the_numbers_of_the_table(chromium, swept, cart):
    found, path = swept(cart, OVER)
    with opened(chromium, path) as page:
        for cell in (0, 22, 31):
            compared(page, found, cell, cart)
        assert not page.errors


def test_the_speed_of_a_current_keeps_its_direction(chromium, swept, boat):
    found, path = swept(boat, CURRENT, seed=3, runs=20, overrides=("run.horizon=8",))
    with opened(chromium, path) as page:
        compared(page, found, 2, boat, runs=20, overrides=("run.horizon=8", "run.seed=3"))
        assert page.page.evaluate("state.disturbance[0]") == -0.3


def test_the_cell_under_the_pointer_runs_and_a_click_keeps_it(chromium, swept, boat):
    _, path = swept(boat, CURRENT, seed=3, runs=20, overrides=("run.horizon=8",))
    with opened(chromium, path) as page:
        own = page.page.evaluate("state.values.k")
        box = page.page.locator("#map").bounding_box()
        place = (box["x"] + 90, box["y"] + 40)  # the slower current, the larger gain
        page.page.mouse.move(*place)
        assert page.page.evaluate("[sweep.cell, state.values.k]") == [1, 5]
        assert "current = 0.1 m/s, k = 5" in page.page.inner_text("#cell")
        page.page.mouse.move(box["x"] + 90, box["y"] + 200)
        assert page.page.evaluate("[sweep.cell, state.values.k]") == [0, 4]
        page.page.mouse.move(5, 5)
        assert page.page.evaluate("[sweep.cell, state.values.k]") == [-1, own]
        page.page.mouse.click(*place)
        page.page.mouse.move(5, 5)
        assert page.page.evaluate("sweep.cell") == 1
        page.page.evaluate(
            "document.querySelectorAll('details').forEach((d) => { d.open = true; })"
        )
        page.page.get_by_label("c [1/s], number", exact=True).fill("2.5")
        page.page.keyboard.press("Enter")
        assert "what runs is not this cell" in page.page.inner_text("#cell")
        page.page.focus("#map")
        page.page.keyboard.press("ArrowRight")
        assert page.page.evaluate("[sweep.cell, state.cell]") == [3, 3]
        link = page.page.evaluate("asLink()")
        page.page.keyboard.press("Escape")
        assert page.page.evaluate("sweep.cell") == -1
        assert not page.errors
    with opened(chromium, path, link=link) as page:
        assert page.page.evaluate("[sweep.cell, state.values.k]") == [3, 5]


def test_a_tap_chooses_a_cell(chromium, swept, boat):
    _, path = swept(boat, CURRENT, seed=3, runs=20, overrides=("run.horizon=8",))
    with opened(chromium, path, width=390, height=844, has_touch=True) as page:
        page.page.locator("#map").tap(position={"x": 90, "y": 40})
        assert page.page.evaluate("sweep.cell") == 1
        assert page.page.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_refused_cell_says_why_and_the_scenario_runs(chromium, swept, cart):
    found, path = swept(cart, ("wall=-3,2", "k=1,2"))
    assert found.dataset["refused"].values.ravel().tolist() == [1, 1, 0, 0]
    with opened(chromium, path) as page:
        page.page.evaluate("sweep.choose(0)")
        said = page.page.inner_text("#cell")
        assert "refused: " in said
        assert "no state of" in said
        assert page.page.evaluate("state.values.wall") == 2


def test_a_copied_cell_is_a_scenario_with_its_numbers(chromium, swept, cart, folder):
    _, path = swept(cart, OVER)
    with opened(chromium, path) as page:
        page.page.evaluate("sweep.choose(29)")
        page.until("!running && !stale")
        state = page.numbers("page.run.state")
        (folder / "copy.toml").write_text(page.page.evaluate("asScenario()"), "utf-8")
    seen = hf.load_scenario(str(folder / "copy.toml")).run().arrays["state"].values[0]
    seen = seen[np.isfinite(seen).all(axis=1)]
    np.testing.assert_array_equal(state.reshape(seen.shape), seen)


@pytest.mark.slow("over1-9-8")
@pytest.mark.parametrize(
    ("over", "latin", "other"), [(("k=0.5:1.5:4",), None, 3), (("k=0.5:1.5", "c=1:3:log"), 9, 8)]
)
def test_curves_and_samples_choose_cells_too(chromium, swept, cart, over, latin, other):
    found, path = swept(cart, over, latin=latin)
    with opened(chromium, path) as page:
        spot = page.page.evaluate(f"sweep.spots.find((s) => s.cell === {other})")
        page.page.locator("#map").click(position={"x": spot["x"] + 4, "y": spot["y"] + 4})
        assert page.page.evaluate("state.cell") == other
        compared(page, found, other, cart)
        assert not page.errors


def test_of_more_names_two_are_chosen_and_the_others_have_sliders(chromium, swept, cart):
    _, path = swept(cart, OVER)
    with opened(chromium, path) as page:
        page.page.select_option("#across", label="push")
        assert page.page.locator("#others input").count() == 3
        page.page.get_by_label("wall", exact=True).fill("1")
        page.page.evaluate("sweep.choose(sweep.spots.at(-1).cell)")
        assert page.page.evaluate("[state.values.push, state.values.wall]") == [0.1, 2]
        page.page.get_by_label("wall", exact=True).fill("0")
        assert page.page.evaluate("[state.values.push, state.values.wall]") == [0.1, 1.5]
        assert not page.errors


# -- what is refused


def test_a_number_that_decides_more_is_refused(cart, folder):
    with ThreadPoolExecutor(1) as pool:
        hf.sweep(cart, ["run.horizon=5,10"], executor=pool).save(folder / "horizon.nc")
        (folder / "walls.toml").write_text(CART.replace("61", "21"), "utf-8")
        kernel = hf.sweep(str(folder / "walls.toml"), ["march.horizon=1,2"], executor=pool, runs=5)
    with pytest.raises(ScenarioError, match=r"run\.horizon decides more .* --set run\.horizon=5"):
        hf.explore(str(folder / "horizon.nc"))
    with ThreadPoolExecutor(1) as pool:  # a law with the current in its equations
        current = hf.sweep("ch3-known-current", ["current.speed=0.1,0.2"], executor=pool, runs=2)
    current.save(folder / "current.nc")
    with pytest.raises(ScenarioError, match=r"law\.current_x decides more"):
        hf.explore(str(folder / "current.nc"))
    kernel.save(folder / "kernel.nc")
    with pytest.raises(ScenarioError, match="every cell has a discriminating-kernel of its own"):
        hf.explore(str(folder / "kernel.nc"))


@pytest.mark.heavy
def test_a_file_that_does_not_say_its_sweep_is_refused(swept, cart, folder):
    _, path = swept(cart, OVER)
    table, damaged = path.parent / "sweep.nc", folder / "damaged.nc"
    damaged.write_bytes(table.read_bytes()[:5000])
    with pytest.raises(OutputError, match="cannot be read"):
        hf.explore(str(damaged))
    with pytest.raises(OutputError, match="no such file"):
        hf.explore(str(folder / "absent.nc"))
    hf.load_scenario(cart, ["run.horizon=1"]).run().save(folder / "result.nc")
    with pytest.raises(ScenarioError, match="not the table of a sweep"):
        hf.explore(str(folder / "result.nc"))
    with pytest.raises(ScenarioError, match="repeat the sweep with --set"):
        hf.explore(str(table), ["law.k=2"])
    former = xr.load_dataset(table)
    for name, text in (("asked", "{}"), ("asked", "none"), ("asked", json.dumps([1]))):
        former.assign_attrs({name: text}).to_netcdf(folder / "odd.nc")
        with pytest.raises(OutputError, match="lacks what a page needs, or is damaged"):
            hf.explore(str(folder / "odd.nc"))
    former.assign(settings=former["settings"] + " --set law.c=1e").to_netcdf(folder / "odd.nc")
    with pytest.raises(OutputError, match="lacks what a page needs, or is damaged"):
        hf.explore(str(folder / "odd.nc"))
    del former.attrs["asked"]
    former.to_netcdf(folder / "former.nc")
    with pytest.raises(ScenarioError, match="does not say which scenario"):
        hf.explore(str(folder / "former.nc"))


@pytest.mark.heavy
def test_a_scenario_that_is_gone_or_has_changed_is_refused(folder):
    own = folder / "own.toml"
    own.write_text(DRIFTING, "utf-8")
    with ThreadPoolExecutor(1) as pool:
        found = hf.sweep(str(own), ["k=1,2"], executor=pool, runs=5)
    assert json.loads(found.dataset.attrs["asked"])["runs"] == 5
    found.save(folder / "own.nc")
    own.write_text(DRIFTING.replace("1.0", "1.1"), "utf-8")
    with pytest.raises(ScenarioError, match="has changed since the sweep"):
        hf.explore(str(folder / "own.nc"))
    own.unlink()
    with pytest.raises(ScenarioError, match="from the folder in which the sweep was called"):
        hf.explore(str(folder / "own.nc"))
