"""Campaigns: every cell is what `run` gives, whoever computes it and however often it is killed."""

import contextlib
import json
import os
import shlex
import signal
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import xarray as xr
from scipy.stats import qmc

import holdfast as hf
from holdfast.errors import HoldfastError, OutputError, ScenarioError
from holdfast.interop.march_cluster import cluster_executor
from holdfast.presentation.figures import style
from holdfast.scenario.files import read_tables
from holdfast.scenario.load import scenario_of
from holdfast.studies import sweep as module
from holdfast.studies.scenario_parameter import find_knob
from holdfast.studies.sweep import grid_cells, latin_cells, read_over, store
from tests.command_line import holdfast
from tests.scenario_files import DRIFTING, LINE


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    path = tmp_path_factory.mktemp("cart") / "cart.toml"
    path.write_text(DRIFTING, "utf-8")
    return str(path)


@pytest.fixture(scope="module")
def here():
    """In threads of this process, one part at a time: what processes do, without their beginning."""
    with ThreadPoolExecutor(2) as pool:
        yield pool


OVER = ("k=0.5:1.5:3", "push=0:0.1:2")


@pytest.fixture(scope="module")
def found(cart, here):
    return hf.sweep(cart, OVER, executor=here)


# -- what a cell is


@pytest.mark.parametrize(("i", "j"), [(0, 0), (2, 1)])
def test_a_cell_is_what_run_gives_with_its_settings(cart, found, i, j):
    cell = found.dataset.isel(k=i, push=j)
    changes = [w for w in shlex.split(str(cell["settings"].values)) if w != "--set"]
    result = hf.load_scenario(cart, changes).run()
    said = result.summary()
    for label, count in result.outcomes.items():
        assert int(cell[label.replace(" ", "_")]) == count
    assert float(cell["success"]) == said["success_fraction"]
    assert float(cell["worst_right"]) == said["worst_constraint"]["right"]
    latest = said["in_goal_since"]["worst"]
    assert float(cell["goal_time_worst"]) == pytest.approx(
        np.nan if latest is None else latest, rel=0, nan_ok=True
    )
    assert float(cell["error_x_worst"]) == said["final_error"]["x"]["worst"]
    assert float(cell["peak_a"]) == said["peak_input"]["a"]
    errors = np.abs(result.dataset["state"].sel(state_name="x").values[:, -1])
    assert float(cell["error_x_mean"]) == pytest.approx(errors.mean(), rel=1e-12)
    assert float(cell["success_low"]) < float(cell["success"]) <= float(cell["success_high"])


def test_runs_in_parts_are_the_runs_of_the_whole(cart, here, found, monkeypatch):
    """Starts, noise and draws belong to the run, not to the part: fixed starts, then random ones."""
    monkeypatch.setattr(module, "PART", 9)
    parts = hf.sweep(cart, OVER, executor=here).dataset
    for name, whole in found.dataset.data_vars.items():
        if name.endswith("_mean"):
            np.testing.assert_allclose(parts[name].values, whole.values, rtol=1e-12)
        else:
            np.testing.assert_array_equal(parts[name].values, whole.values)


def test_part_of_the_starts_on_edges_is_that_of_the_whole():
    changes = ["run.horizon=1", 'starts.active=[["bearing"], ["bearing", "range"]]']
    scenario = hf.load_scenario("ch6-line-of-sight", changes, runs=23)
    whole = scenario.run().dataset["state"].values
    parts = [
        scenario.run(part=range(a, min(a + 7, 23))).dataset["state"].values for a in (0, 7, 14, 21)
    ]
    assert np.array_equal(np.concatenate(parts), whole)


def test_another_number_of_a_disturbance_is_no_other_program():
    from holdfast.execution.codegen.closed_loop_program import closed_loop_program
    from holdfast.execution.codegen.llvm_text import leaves_text
    from holdfast.execution.simulation.settings import BY_NAME

    def source(speed):
        s = hf.load_scenario("ch3-known-current", [f"disturbance.Vx={speed}"])
        rest = {"region": s.region, "goal": s.goal, "stepper": BY_NAME["rk4"]}
        program = closed_loop_program(s.system, s.law, disturbance=s.disturbance, **rest)
        return leaves_text(program.leaves)

    assert source(-0.1) == source(0.07) == source(0.0)


def test_table_says_what_it_is(found, tmp_path):
    path = found.save(tmp_path / "sweep.nc")
    with xr.open_dataset(path) as data:
        assert data["success"].dims == ("k", "push")
        assert data["k"].attrs["units"] == "1/s^2"
        assert data["push"].attrs["key"] == "varied.draws.push"
        assert data["runs"].dtype == np.int64
        assert (data["runs"].values == 32).all()
        assert all("long_name" in v.attrs for v in data.data_vars.values())
        assert data["worst_right"].attrs["units"] == "m"
        frame = data[["success", "worst_right"]].to_dataframe()
        assert len(frame) == 6
    said = json.loads(json.dumps(found.summary(), allow_nan=False))
    assert said["over"]["law.parameters.k.value"] == [0.5, 1.0, 1.5]
    assert said["most"]["value"] == float(found.dataset["success"].max())


def test_command_of_a_cell_runs_it(cart, found, tmp_path):
    best = found.summary()["most"]["cell"]
    words = shlex.split(found.command(best))[1:]
    answer = holdfast(*words, "--no-figures", "--out", str(tmp_path))
    assert answer.returncode == 0, answer.stderr
    said = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert said["success_fraction"] == found.summary()["most"]["value"]


# -- what is gone over


@pytest.mark.parametrize(
    ("text", "values", "unit"),
    [
        ("k1=0.05:0.5:4", (0.05, 0.2, 0.35, 0.5), ""),
        ("law.k=0.01:1:3:log", (0.01, 0.1, 1.0), ""),
        ("angle = 20 : 40 deg : 3", (20.0, 30.0, 40.0), "deg"),
        ("k=3,1,2 m", (1.0, 2.0, 3.0), "m"),
        ("k=-1e-3", (-1e-3,), ""),
    ],
)
def test_values_are_read(text, values, unit):
    read = read_over(text)
    assert read.values == pytest.approx(values, rel=1e-15)
    assert read.unit == unit


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("k1", "expected KEY=LOW:HIGH:COUNT"),
        ("=1:2:3", "expected KEY=LOW"),
        ("k=1:2", "expected KEY=LOW:HIGH:COUNT"),
        ("k=1:2:3:lin", "expected KEY=LOW"),
        ("k=2:1:3", "expected LOW < HIGH"),
        ("k=1:2:1", "at least 2.*--set"),
        ("k=1:2:2.5", "whole number"),
        ("k=0:2:3:log", "no logarithm"),
        ("k=a:2:3", "'a' is not a number"),
        ("k=1:inf:3", "'inf' is not a number"),
        ("k=1:nan:3", "'nan' is not a number"),
        ("k=1e999:2:3", "'1e999' is not a number"),
        ("k=1 m:2 deg:3", "expected one unit"),
        ("k=1,1", "twice"),
        ("k=1,,2", "'' is not a number"),
    ],
)
def test_values_that_are_none_are_refused(text, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        read_over(text)


def test_latin_hypercube_has_one_cell_in_every_slice():
    axes = [read_over("k=1:2", latin=True), read_over("c=0.01:1:log", latin=True)]
    cells = latin_cells(axes, 200, 3)
    slices = np.column_stack([cells[:, 0] - 1, np.log10(cells[:, 1]) / 2 + 1]) * 200
    assert (np.sort(np.floor(slices), axis=0) == np.arange(200)[:, None]).all()
    assert np.array_equal(cells, latin_cells(axes, 200, 3))
    own = qmc.LatinHypercube(2, rng=np.random.default_rng(3)).random(200)
    np.testing.assert_allclose(cells[:, 0], 1 + own[:, 0], rtol=1e-15)


def test_grid_is_every_combination():
    cells = grid_cells([read_over("a=1,2"), read_over("b=3,4,5")])
    assert cells.tolist() == [[1, 3], [1, 4], [1, 5], [2, 3], [2, 4], [2, 5]]
    with pytest.raises(ScenarioError, match="at most 10,000,000"):
        grid_cells([read_over(f"{n}=0:1:999") for n in "abc"])


def knob(scenario, name, overrides=()):
    shown, text, data = read_tables(scenario, overrides)
    return find_knob(scenario_of(shown, text, data), data, name)


@pytest.mark.slow(
    "inspection-swing-0.2-settings6",
    "inspection-half_angle-20.0 deg-settings7",
    "inspection-safeguard.gains.1-4-settings8",
)
@pytest.mark.parametrize(
    ("scenario", "name", "value", "settings"),
    [
        ("ch5-current", "k1", 0.2, ("law.k1=0.2",)),
        ("ch5-current", "distance", 0.6, ("redesign.parameters.distance=0.6",)),
        ("ch5-current", "current.speed", 0.1, ("system.current_limit=0.1",)),
        ("ch3-dynamic", "current.speed", 0.1, ("varied.draws.speed.range=[0.1, 0.1]",)),
        ("ch3-dynamic", "direction", "90.0 deg", ('varied.draws.direction.range=["90.0 deg", "90.0 deg"]',)),
        ("ch7-any-current", "current.speed", 0.1, ("system.current_limit=0.1",)),
        ("inspection", "swing", 0.2, ("law.swing=0.2",)),
        ("inspection", "half_angle", "20.0 deg", ('region.half_angle="20.0 deg"',)),
        ("inspection", "safeguard.gains.1", 4, ("safeguard.gains.1=4",)),
        ("ch3-noise", "noise.uniform.x", 0.1, ("noise.uniform.x=0.1",)),
    ],
)  # fmt: skip
def test_short_names_stand_for_keys(scenario, name, value, settings):
    assert knob(scenario, name).settings(value) == settings


def test_speed_of_a_known_current_is_known_to_the_law():
    """Its direction stays, and the law that is told the current is told the new one."""
    settings = dict(s.split("=") for s in knob("ch3-known-current", "current.speed").settings(0.5))
    assert set(settings) == {"disturbance.Vx", "disturbance.Vy", "law.current_x", "law.current_y"}
    x, y = (float(settings[f"disturbance.V{n}"]) for n in "xy")
    assert np.hypot(x, y) == pytest.approx(0.5)
    assert x / y == pytest.approx(-0.5)
    assert (float(settings["law.current_x"]), float(settings["law.current_y"])) == (x, y)


@pytest.mark.few("ch4-car-current.speed-has no current.*name the key")
@pytest.mark.parametrize(
    ("scenario", "name", "complaint"),
    [
        ("inspection", "swin", "no key 'swin'; did you mean 'swing'"),
        ("inspection", "current.speed", "has no current.*--set disturbance.Vy"),
        ("inspection", "x", "the end of several keys"),
        ("ch4-car", "current.speed", "has no current.*name the key"),
    ],
)
def test_names_that_turn_nothing_are_refused(scenario, name, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        knob(scenario, name)


@pytest.mark.parametrize(
    ("over", "more", "complaint"),
    [
        ([], {}, "needs at least one axis"),
        (["k=1:2:2", "law.parameters.k.value=1:2:2"], {}, "twice"),
        (["starts.random=1:5:5"], {}, "use --runs"),
        (["k=1:2:2"], {"latin": 5}, "with --latin"),
        (["k=1:2"], {"latin": 1}, "2 to 10,000,000 cells"),
        (["law.nonsense=1:2:2"], {}, "law.parameters|unknown key"),
        (["k=1:2:2"], {"runs": 0}, "at least 1"),
    ],
)
def test_sweeps_that_make_no_sense_are_refused(cart, here, over, more, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        hf.sweep(cart, over, executor=here, **more)


def test_cells_that_are_refused_are_in_the_table_with_the_reason(cart, here, tmp_path):
    found = hf.sweep(cart, ["run.delay=0,0.05,0.07"], executor=here)
    assert found.dataset["refused"].values.tolist() == [0, 0, 1]
    assert "delay" in str(found.dataset["note"].values[2])
    assert np.isnan(found.dataset["success"].values).tolist() == [False, False, True]
    assert found.dataset["runs"].values.tolist() == [32, 32, 0]
    answer = holdfast("sweep", cart, "--over", "run.delay=0,0.05,0.07", "--out", str(tmp_path))
    assert answer.returncode == 1
    assert "1 cell refused" in answer.stdout
    assert (tmp_path / "sweep.png").exists()


def test_keys_of_whole_numbers_are_swept_too(cart, here):
    found = hf.sweep(cart, ["run.substeps=1:3:3", "seed=1,2"], executor=here, runs=4)
    assert found.refused == 0
    assert found.names == ("substeps", "seed")
    unused = hf.sweep(cart, ["varied.draws.nonsense=1:2:2"], executor=here)
    assert unused.refused == 2
    assert "nothing depends on it" in unused.notes[0]


def test_a_cell_that_fails_does_not_end_the_others(cart, here, monkeypatch, tmp_path):
    def failing(scenario, part=None):
        if scenario.settings["substeps"] == 2:
            raise ZeroDivisionError("of ours")
        return run(scenario, part=part)

    run = hf.Scenario.run
    monkeypatch.setattr(hf.Scenario, "run", failing)
    asked = {"over": ["run.substeps=1:3:3"], "executor": here, "runs": 4, "folder": tmp_path}
    found = hf.sweep(cart, **asked)
    assert found.dataset["refused"].values.tolist() == [0, 1, 0]
    assert found.notes == ("ZeroDivisionError: of ours",)
    monkeypatch.setattr(hf.Scenario, "run", run)
    assert hf.sweep(cart, **asked).refused == 0, "what failed is tried again"
    assert [r[1] for r in rows(tmp_path)] == [0, 2, 1]
    again = hf.sweep(cart, **asked)
    assert again.refused == 0


def test_a_refusal_is_not_tried_again(cart, here, tmp_path):
    for _ in range(2):
        found = hf.sweep(cart, ["sample_time=0.05,-1"], executor=here, runs=4, folder=tmp_path)
        assert found.refused == 1
        assert [r[1] for r in rows(tmp_path)] == [0, 1]


def test_an_unknown_variable_is_refused_after_the_first_part(cart, here, tmp_path):
    for wrong in ("sucess", "cell"):
        with pytest.raises(OutputError, match=f"no '{wrong}'"):
            hf.sweep(cart, ["k=1:2:9"], executor=here, runs=4, folder=tmp_path, show=wrong)
    assert 1 <= len(rows(tmp_path)) < 9
    assert hf.sweep(cart, ["k=1:2:3"], executor=here, runs=4, show="refused").refused == 0


def test_kernels_are_swept_too(here, tmp_path):
    """Of the unstable line: x' = x + u + d keeps |x| <= 0.6 - push, of the box that is 1.2 wide."""
    path = tmp_path / "line.toml"
    path.write_text(LINE, "utf-8")
    found = hf.sweep(str(path), ["push=0.1,0.3,0.7"], executor=here)
    share = found.variable()
    assert share.name == "fraction"
    assert share.values[:2] == pytest.approx([0.5 / 1.2, 0.3 / 1.2], abs=0.03)
    assert share.values[2] == 0
    assert found.dataset["answered"].values.tolist() == [1, 1, 1]


@pytest.mark.heavy
def test_what_an_empty_kernel_has_not_can_be_shown_of_the_others(here, tmp_path):
    path = tmp_path / "line.toml"
    more = 'most = { value = 0.6, unit = "m/s" }, push = {'
    text = LINE.replace("[-0.6, 0.6]", '["-most", "most"]').replace("push = {", more)
    path.write_text(text + "\n[promise]\nruns = 10\n", "utf-8")
    found = hf.sweep(str(path), ["most=0.1,0.6"], executor=here, show="kept_0", folder=tmp_path)
    assert found.variable().values[0] == 0
    assert np.isnan(found.variable("kept_0").values[0])
    assert found.variable("kept_0").values[1] == 1


# -- killed, interrupted, resumed


MANY = 40


def begun(cart, folder, *more):
    code = "from holdfast.commands.main import main; main()"
    words = [
        "sweep",
        cart,
        "--over",
        f"k=0.5:1.5:{MANY}",
        "--runs",
        "40",
        "--out",
        str(folder),
        *more,
    ]
    return subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip


def rows(folder):
    place = folder / module.CELLS_FILE
    if not place.exists():
        return []
    with contextlib.closing(sqlite3.connect(place)) as kept, contextlib.suppress(sqlite3.Error):
        return kept.execute("SELECT rowid, cell, answer FROM part ORDER BY rowid").fetchall()
    return []


@pytest.mark.parametrize(
    "how", [pytest.param(how, marks=pytest.mark.heavy) for how in (signal.SIGKILL, signal.SIGINT)]
)
def test_killed_it_goes_on_where_it_was(cart, tmp_path, how):
    process = begun(cart, tmp_path, "--workers", "1")
    ends = time.monotonic() + 90
    while len(rows(tmp_path)) < 3 and time.monotonic() < ends:
        time.sleep(0.02)
    if how == signal.SIGKILL:
        os.killpg(process.pid, how)  # the workers too, as a machine that is switched off
    else:
        process.send_signal(how)
    process.communicate(timeout=60)
    assert process.returncode == (-signal.SIGKILL if how == signal.SIGKILL else 130)
    before = rows(tmp_path)
    assert 3 <= len(before) < MANY
    assert not (tmp_path / "sweep.nc").exists()
    # what is finished is marked: it would be lost if it were done again
    with contextlib.closing(sqlite3.connect(tmp_path / module.CELLS_FILE)) as kept, kept:
        answer = json.loads(before[0][2])
        answer["note"] = "marked"
        kept.execute(
            "UPDATE part SET answer = ? WHERE rowid = ?", (json.dumps(answer), before[0][0])
        )
    again = begun(cart, tmp_path, "--no-figures")
    _, err = again.communicate(timeout=120)
    assert again.returncode == 0, err
    after = rows(tmp_path)
    assert [r[:2] for r in after[: len(before)]] == [r[:2] for r in before]
    assert sorted(r[1] for r in after) == list(range(MANY))
    with xr.open_dataset(tmp_path / "sweep.nc") as data:
        assert data.sizes["k"] == MANY
        assert [str(v) for v in data["note"].values].count("marked") == 1
        assert (data["runs"].values == 40).all()


def test_other_campaigns_in_the_same_folder_are_let_be(cart, here, tmp_path):
    first = hf.sweep(cart, ["k=1,2"], executor=here, folder=tmp_path, runs=5)
    hf.sweep(cart, ["k=1,2"], executor=here, folder=tmp_path, runs=6)
    assert len(rows(tmp_path)) == 4
    again = hf.sweep(cart, ["k=1,2"], executor=None, workers=1, folder=tmp_path, runs=5)
    assert len(rows(tmp_path)) == 4
    xr.testing.assert_identical(first.dataset, again.dataset)


def test_a_file_that_is_no_store_is_told(cart, here, tmp_path):
    (tmp_path / module.CELLS_FILE).write_text(
        "not a database, but long enough to be looked at " * 40
    )
    with pytest.raises(OutputError, match=r"sweep-cells\.db cannot be used"):
        hf.sweep(cart, ["k=1,2"], executor=here, folder=tmp_path, runs=5)


def test_a_full_disk_is_told_and_what_is_there_stays(tmp_path):
    place = tmp_path / "cells.db"
    with store(place, "one") as kept:
        kept.put((0, 0), {"note": "kept"})

    def fill():
        with store(place, "one") as kept:
            kept.connection.execute("PRAGMA max_page_count = 3")
            for cell in range(1, 1000):
                kept.put((cell, 0), {"note": "x" * 1000})

    with pytest.raises(OutputError, match=r"full.*make room"):
        fill()
    with store(place, "one") as kept:
        assert kept.answers(0) == [{"note": "kept"}]


# -- on a cluster


@pytest.mark.heavy
def test_on_a_cluster_the_same_bit_for_bit_though_a_worker_is_killed(cart, here, tmp_path):
    """Three worker processes; one is killed in the midst, with what it was doing."""
    distributed = pytest.importorskip("distributed")
    over = ["k=0.5:1.5:8", "push=0:0.2:3"]
    expected = hf.sweep(cart, over, executor=here, runs=50)
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        killed = []

        def progress(what, fraction):
            done = int(what.split()[0])
            if done >= 2 and not killed:
                victim = next(iter(cluster.workers.values()))
                killed.append(victim.pid)
                os.kill(victim.pid, signal.SIGKILL)

        with cluster_executor(cluster.scheduler_address) as (executor, cores):
            assert cores == 3
            found = hf.sweep(
                cart,
                over,
                executor=executor,
                workers=cores,
                runs=50,
                folder=tmp_path,
                progress=progress,
            )
        assert killed
    xr.testing.assert_identical(found.dataset, expected.dataset)
    assert sorted(r[1] for r in rows(tmp_path)) == list(range(24))


def test_a_cluster_that_is_not_there_is_told(monkeypatch):
    distributed = pytest.importorskip("distributed")
    from holdfast.interop import march_cluster

    monkeypatch.setattr(march_cluster, "CONNECTION_TIMEOUT", "1s")
    with (
        pytest.raises(ScenarioError, match=r"--cluster tcp://127\.0\.0\.1:9"),
        cluster_executor("tcp://127.0.0.1:9"),
    ):
        pass
    with pytest.raises(ScenarioError, match="expected the address"), cluster_executor("nowhere"):
        pass
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=None, protocol="tcp://"
        ) as idle,
        pytest.raises(ScenarioError, match="it has no workers"),
        cluster_executor(idle.scheduler_address),
    ):
        pass


def test_another_version_on_the_cluster_is_refused(cart, here, monkeypatch):
    part = module.Part
    monkeypatch.setattr(module, "Part", lambda *asked: part(*asked[:-1], "another"))
    with pytest.raises(ScenarioError, match="another version of holdfast"):
        hf.sweep(cart, ["k=1,2"], executor=here, runs=5)


# -- figures


@pytest.mark.few("over0-None-1")
@pytest.mark.parametrize(
    ("over", "latin", "panels"),
    [
        (["k=0.5:1.5:3"], None, 1),
        (list(OVER), None, 1),
        (["k=1,2", "c=1,2", "push=0,0.1"], None, 3),
        (["k=0.1:1:log", "c=1:2"], 6, 1),
    ],
)
def test_figure_shows_what_was_gone_over(cart, here, over, latin, panels, tmp_path):
    found = hf.sweep(cart, over, latin=latin, runs=6, executor=here)
    figure = hf.campaign_figure(found)
    shown = [a for a in figure.axes if a.get_visible() and a.get_xlabel()]
    assert len(shown) == panels
    assert shown[0].get_xlabel().startswith("$k$")
    assert style.write(figure, tmp_path, "sweep")[0].stat().st_size > 5000
    with pytest.raises(HoldfastError, match="a campaign has no 'nonsense'"):
        hf.campaign_figure(found, "nonsense")


# -- a million runs

MILLION = """
import sys
from holdfast.studies.sweep import Part, run_part
from holdfast.host.files import version_digest
from holdfast.scenario.files import read_tables

file, _, tables = read_tables(sys.argv[1], ["run.horizon=1", "noise=", "varied=", "disturbance="])
size, total, done, held = 5_000, 1_000_000, 0, []
for first in range(0, total, size):
    part = Part(file, tables, (), total, None, first, first + size, 0, version_digest())
    done += run_part(part)["numbers"]["runs"][1]
    with open("/proc/self/statm") as said:
        held.append(int(said.read().split()[1]) * 4096 / 2**20)
print(done, max(held[:20]), max(held[20:]))
"""


@pytest.mark.heavy
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="asks Linux for its memory")
def test_a_million_runs_in_one_process_take_no_more_memory(cart):
    answer = subprocess.run(
        [sys.executable, "-c", MILLION, cart], capture_output=True, text=True, timeout=500
    )
    assert answer.returncode == 0, answer.stderr
    done, early, late = map(float, answer.stdout.split())
    assert done == 1_000_000
    assert late < early + 8, "MiB"
