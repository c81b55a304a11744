"""What is written can be read by others, says what it is, and appears whole or not at all."""

import gzip
import json
import os
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import netCDF4
import numpy as np
import pytest
import xarray as xr

import holdfast as hf
from holdfast.analysis.simulation.files import atomic_file, write_arrays, write_netcdf
from holdfast.errors import OutputError
from holdfast.presentation.text.runs import summary_text
from tests.command_line import called


@pytest.fixture(scope="module")
def result():
    scenario = hf.load_scenario("ch5-viable-goal-set", ["run.horizon=20"], runs=8)
    return scenario.run()


@pytest.fixture(scope="module")
def saved(result, tmp_path_factory):
    return result.save(tmp_path_factory.mktemp("out") / "result.nc")


def test_file_holds_the_promised_variables_with_these_axes(saved):
    with xr.open_dataset(saved) as data:
        assert data["state"].dims == ("run", "time", "state_name")
        assert data["input"].dims == ("run", "time", "input_name")
        assert data["mode"].dims == ("run", "time")
        assert data["constraint"].dims == ("run", "time", "constraint_name")
        for name in ("outcome", "exit_time", "exit_constraint"):
            assert data[name].dims == ("run",)
        assert data["time"].attrs["units"] == "s"
        assert [str(s) for s in data["state_name"].values] == ["x", "y", "psi", "u", "v", "r"]
        assert [str(s) for s in data["state_unit"].values][2] == "rad"
        assert data["outcome"].attrs["flag_meanings"].split()[1] == "reached_goal"
        assert data.attrs["seed"] == 1
        assert data["state"].attrs["names"] == "x, y, psi, u, v, r"
        assert data["state"].attrs["units"] == "m, m, rad, m/s, m/s, rad/s"
        assert data["constraint"].attrs["units"] == "rad, rad, m, m"
        assert '"k1": 0.16' in data.attrs["parameters"]
        assert data.attrs["holdfast_version"] == hf.__version__
        assert 'name = "steer_marine"' in data.attrs["scenario_text"]


def stored(path):
    """Everything in a file: axes, attributes with their types, filters, bytes."""

    def said(of):
        return [(n, np.asarray(of.getncattr(n)).dtype, of.getncattr(n)) for n in of.ncattrs()]

    with netCDF4.Dataset(path) as file:
        file.set_auto_maskandscale(False)
        file.set_auto_chartostring(False)
        variables = [
            (n, v.dimensions, v.dtype, v.filters(), v.chunking(), said(v), v[...].tobytes())
            for n, v in file.variables.items()
        ]
        axes = [(n, len(d), d.isunlimited()) for n, d in file.dimensions.items()]
        return repr((axes, said(file), variables))


@pytest.mark.few("ch5-viable-goal-set")
@pytest.mark.parametrize("name", ["ch5-viable-goal-set", "inspection", "ch2-integrator"])
def test_file_is_the_one_that_xarray_writes(name, tmp_path):
    """With a safeguard and without, and with axes without entries."""
    result = hf.load_scenario(name, ["run.horizon=2"], runs=4).run()
    ours = write_arrays(result.arrays, tmp_path / "ours.nc")
    theirs = write_netcdf(result.dataset, tmp_path / "theirs.nc")
    assert stored(ours) == stored(theirs)


def test_dataset_and_arrays_of_a_result_are_the_same_numbers(tmp_path):
    result = hf.load_scenario("ch2-unicycle", ["run.horizon=1"], runs=2).run()
    before = result.arrays
    assert result.dataset["state"].values is before["state"].values
    result.dataset.attrs["remark"] = "mine"
    result.dataset["mine"] = ("run", [1.0, 2.0])
    assert result.arrays.attrs["remark"] == "mine"
    with xr.open_dataset(result.save(tmp_path / "result.nc")) as data:
        assert data.attrs["remark"] == "mine"
        assert list(data["mine"].values) == [1.0, 2.0]


def test_xarray_alone_selects_by_name_in_every_file(saved, tmp_path):
    """`state` along an axis `state` would be taken for a coordinate, and its names for a label."""
    with xr.open_dataset(saved) as data:
        assert not set(data.dims) & set(data.data_vars)
        assert data.attrs["format_version"] == 2
        heading = data["state"].sel(state_name="psi")
        assert np.array_equal(heading.values, data["state"].values[:, :, 2])
        for name, variable in data.data_vars.items():
            for axis in (a for a in variable.dims if data.sizes[a]):
                label = data[axis].values[-1]
                last = variable.isel({axis: -1}).values
                assert np.array_equal(variable.sel({axis: label}).values, last, equal_nan=True), (
                    name
                )
    again = hf.load(hf.load(saved).save(tmp_path / "again.nc")).dataset
    xr.testing.assert_identical(again, hf.load(saved).dataset)


OLD = Path(__file__).parent / "format_1"
"""Files that version 0.1.0 wrote before files had a format, and what it said of them."""


def old(name, folder):
    """A file of format 1, unpacked, and the answers of the version that wrote it."""
    path = folder / f"{name}.nc"
    path.write_bytes(gzip.decompress((OLD / f"{name}.nc.gz").read_bytes()))
    return path, json.loads((OLD / f"{name}.json").read_text())


def test_a_result_of_format_1_answers_as_it_did(tmp_path):
    path, said = old("result", tmp_path)
    found = hf.load(path)
    data = found.dataset
    for group, answers in said["summary"].items():
        now = found.summary()[group]
        if group == "outcomes":  # a run of that format could not be told to have left a grid
            assert now.pop("left grid") == 0
        assert now == answers, group
    assert data["state"].sel(state_name="psi").values.tolist() == said["psi"]
    assert data["actuator"].sel(actuator_name="starboard").values.tolist() == said["starboard"]
    assert data["infeasible"].values.tolist() == said["infeasible"]
    with xr.open_dataset(found.save(tmp_path / "new.nc")) as data:
        assert data["state"].sel(state_name="psi").values.tolist() == said["psi"]
    assert "no admissible input at 64 samples of 1 run" in summary_text(found)
    plt.close(hf.histories_figure(found, 1))


def test_a_kernel_and_a_sweep_of_format_1_answer_as_they_did(tmp_path):
    path, said = old("kernel", tmp_path)
    kernel = hf.load(path)
    assert kernel.at([[-0.5, 0.0, 0.0]]).tolist() == said["at"]
    summary = kernel.summary()
    for name in ("converged", "empty", "reached_s", "region", "value_unit"):
        assert summary[name] == said["summary"][name], name
    path, said = old("sweep", tmp_path)
    sweep = hf.load(path)
    assert sweep.summary() == said["summary"]
    assert sweep.variable("viable").values.tolist() == said["viable"]
    assert sweep.command(1) == said["command"]


@pytest.mark.parametrize("version", [3, 0, "two", 1.5])
def test_a_file_of_an_unknown_format_is_refused_in_one_line(saved, tmp_path, version):
    path = tmp_path / "newer.nc"
    path.write_bytes(saved.read_bytes())
    with netCDF4.Dataset(path, "a") as file:
        file.format_version, file.holdfast_version = version, "9.1.0"
    with pytest.raises(
        OutputError, match=rf"newer\.nc has the format {version}, .*9\.1\.0"
    ) as caught:
        hf.load(path)
    assert "\n" not in str(caught.value)


def test_names_are_characters_that_every_netcdf_reader_knows(saved):
    """MATLAB's ncread takes NC_CHAR everywhere, NC_STRING only in recent releases."""
    with netCDF4.Dataset(saved) as file:
        assert file.data_model == "NETCDF4"
        assert file.variables["state_name"].dtype == "S1"
        assert {v.dtype for v in file.variables.values() if v.dtype is str} == set()


def test_loading_gives_back_the_numbers_and_the_named_axes(result, saved):
    again = hf.load(saved)
    assert np.array_equal(again.dataset["state"].values, result.dataset["state"].values)
    heading = again.dataset["state"].sel(state_name="psi")
    assert np.array_equal(heading.values, result.dataset["state"].values[:, :, 2])
    assert again.outcomes == result.outcomes


def test_summary_says_what_the_arrays_say(result):
    summary = json.loads(json.dumps(result.summary(), allow_nan=False))
    data = result.dataset
    assert summary["runs"] == 8
    assert sum(summary["outcomes"].values()) == 8
    assert summary["kind"] == "closed-loop"
    assert summary["scenario"] == "ch5-viable-goal-set"
    worst = data["constraint"].values.max(axis=(0, 1))
    for value, recorded in zip(summary["worst_constraint"].values(), worst, strict=True):
        assert value >= recorded - 1e-12  # the recorded samples may miss the peak, never exceed it
    error = np.abs(data["state"].values[:, -1, 0] + 0.5)
    assert summary["final_error"]["x"]["median"] == pytest.approx(np.median(error))
    assert summary["final_error"]["x"]["worst"] == pytest.approx(error.max())
    assert summary["peak_input"]["tau_u"] >= np.abs(data["input"].values[..., 0]).max()
    assert set(summary) >= {"version", "seed", "wall_time_s", "peak_input"}


def test_angle_errors_are_wrapped(result):
    turned = hf.Result(result.dataset.copy(deep=True), reference={"psi": 0.0})
    plain = turned.summary()["final_error"]["psi"]["worst"]
    turned.dataset["state"][:, -1, 2] += 2 * np.pi
    assert turned.summary()["final_error"]["psi"]["worst"] == pytest.approx(plain)


def test_failure_while_writing_leaves_no_file_and_keeps_the_old_one(tmp_path):
    path = tmp_path / "result.nc"
    path.write_text("old")

    def fail():
        with atomic_file(path) as partial:
            partial.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_link_leads_to_is_written_and_what_is_no_file_stays(tmp_path):
    link, file, pipe = (tmp_path / n for n in ("link", "file", "pipe"))
    link.symlink_to(file)
    with atomic_file(link) as partial:
        partial.write_text("new")
    assert link.is_symlink()
    assert file.read_text() == "new"
    os.mkfifo(pipe)
    with pytest.raises(
        OutputError, match=r"pipe cannot be written \(it exists and is not a regular file\)"
    ):
        atomic_file(pipe).__enter__()
    assert pipe.is_fifo()


def test_unwritable_folder_and_foreign_files_are_refused(result, tmp_path):
    with pytest.raises(OutputError, match="cannot be written"):
        result.save(tmp_path / "nowhere" / "result.nc")
    other = tmp_path / "other.nc"
    xr.Dataset({"a": 1}).to_netcdf(other)
    with pytest.raises(OutputError, match="was not written by holdfast"):
        hf.load(other)
    other.write_text("no")
    with pytest.raises(OutputError, match="cannot be read"):
        hf.load(other)


@pytest.mark.parametrize("keep", [0.0, 0.001, 0.1, 0.5, 0.99, 0.9999])
def test_a_file_that_was_cut_off_is_told(saved, tmp_path, keep):
    whole = saved.read_bytes()
    path = tmp_path / "cut.nc"
    path.write_bytes(whole[: int(keep * len(whole))])
    with pytest.raises(OutputError, match=r"cut\.nc cannot be read as NetCDF"):
        hf.load(path)


@pytest.mark.heavy
def test_damage_is_told_or_touches_no_number(result, saved, tmp_path):
    """Bits are turned at random: what is read is what was written, or nothing is."""
    whole, path = saved.read_bytes(), tmp_path / "damaged.nc"
    generator = np.random.default_rng(1)
    told = 0
    for _ in range(150):
        damaged = bytearray(whole)
        for place in generator.integers(len(whole), size=16):
            damaged[place] ^= 1 << int(generator.integers(8))
        path.write_bytes(damaged)
        try:
            read = hf.load(path).dataset
        except OutputError:
            told += 1
            continue
        for name in ("state", "input", "constraint", "outcome", "goal_time", "worst_constraint"):
            np.testing.assert_array_equal(read[name].values, result.dataset[name].values)
    assert told > 10


def test_a_result_of_an_older_version_is_told_and_what_is_optional_may_lack(saved, tmp_path):
    with xr.open_dataset(saved) as data:
        older = data.load().drop_vars("goal_time")
        first = data.load().drop_vars(["shortest_dwell", "varied_name", "varied"])
    first.encoding = {}
    older.attrs["holdfast_version"] = "0.0.1"
    older.to_netcdf(tmp_path / "older.nc")
    with pytest.raises(OutputError, match=r"written by holdfast 0\.0\.1, lacks.*goal_time.*xarray"):
        hf.load(tmp_path / "older.nc")
    first.to_netcdf(tmp_path / "first.nc")
    again = hf.load(tmp_path / "first.nc")
    assert again.summary()["switching"] == {}
    assert again.summary()["runs"] == 8


@pytest.mark.heavy
@pytest.mark.parametrize(
    "command",
    ["run", "kernel", *(pytest.param(c, marks=pytest.mark.heavy) for c in ("compare", "sweep"))],
)
def test_a_full_disk_is_told_and_nothing_is_lost(tmp_path, command):
    """Files may grow to 3 KB: as on a full disk, the writing of more fails."""
    words = {
        "run": ["run", "ch2-unicycle", "--runs", "3", "--set", "run.horizon=1"],
        "kernel": ["run", "ch7-any-current", "--set", "grid.nodes=9", "--set", "march.horizon=0.1", "--set", "promise="],
        "compare": ["compare", "ch5-rescue", "--laws", "inspection", "--cases", "5 N", "--runs", "1", "--set", "run.horizon=1"],
        "sweep": ["sweep", "ch2-unicycle", "--over", "k=1,2", "--runs", "1", "--set", "run.horizon=1"],
    }[command]  # fmt: skip
    old = tmp_path / "out" / "result.nc"
    old.parent.mkdir()
    old.write_text("old")
    code = (
        "import resource, sys\n"
        "import holdfast.execution.leaf\n"
        "from holdfast.commands.main import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (3000, resource.RLIM_INFINITY))\n"
        "main()"
    )
    warm = called(*words, "--no-figures", "--out", tmp_path / "warm")
    assert warm.returncode == 0, warm.stderr
    answer = subprocess.run(
        [sys.executable, "-c", code, *words, "--out", str(old.parent)],
        capture_output=True, text=True, env=os.environ | {"TMPDIR": str(tmp_path)},
    )  # fmt: skip
    assert answer.returncode == 2, answer.stderr
    assert "cannot be" in answer.stderr
    assert "Traceback" not in answer.stderr
    assert old.read_text() == "old"
    assert not list(old.parent.glob("*.partial"))


def test_what_was_computed_is_kept_elsewhere_where_its_folder_is_full(
    result, tmp_path, monkeypatch
):
    from holdfast.host.files import saved as _saved

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(OutputError, match="the results are in") as caught:
        _saved(result, tmp_path / "nowhere" / "result.nc")
    kept = str(caught.value).rpartition(" ")[2]
    assert hf.load(kept).outcomes == result.outcomes
