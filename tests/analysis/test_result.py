"""What is written can be read by others, says what it is, and appears whole or not at all."""

import json

import netCDF4
import numpy as np
import pytest
import xarray as xr

import holdfast as hf
from holdfast.analysis.files import atomic_file
from holdfast.errors import OutputError


@pytest.fixture(scope="module")
def result():
    scenario = hf.load_scenario("ch5-viable-goal-set", ["run.horizon=20"], runs=8)
    return scenario.run()


@pytest.fixture(scope="module")
def saved(result, tmp_path_factory):
    return result.save(tmp_path_factory.mktemp("out") / "result.nc")


def test_file_holds_the_promised_variables_with_these_axes(saved):
    with xr.open_dataset(saved) as data:
        assert data["state"].dims == ("run", "time", "state")
        assert data["input"].dims == ("run", "time", "input")
        assert data["mode"].dims == ("run", "time")
        assert data["constraint"].dims == ("run", "time", "constraint")
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
