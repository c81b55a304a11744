"""Names that lead to no file, files without end, numbers without end, output that nobody takes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

import holdfast as hf
from holdfast.commands.main import main
from holdfast.errors import HoldfastError, OutputError
from holdfast.maths.definitions.vehicle_file import vehicle_for
from holdfast.planning.environment import geojson_cells
from holdfast.scenario.load import load_scenario
from tests.command_line import FAST, ONE_STATE, holdfast, started

posix = pytest.mark.skipif(os.name == "nt", reason="devices and pipes")

READERS = {
    ".toml": lambda path: load_scenario(path),
    "vehicle.toml": lambda path: vehicle_for(path, {}),
    ".nc": lambda path: hf.load(path),
    ".json": lambda path: geojson_cells(path),
}


@posix
@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "loop", "nothing"])
def test_name_that_leads_to_no_file_is_refused_unread(ending, kind, tmp_path):
    """A pipe that nobody writes to would keep its reader waiting for ever."""
    there, path = tmp_path / "there", tmp_path / f"a{ending}"
    if kind == "pipe":
        os.mkfifo(there)
    elif kind == "folder":
        there.mkdir()
    path.symlink_to({"device": "/dev/zero", "loop": path}.get(kind, there))
    said = {
        "device": "it is a device",
        "pipe": "it is a pipe",
        "folder": "it is a folder",
        "loop": "symbolic link",
        "nothing": "No such file",
    }[kind]
    with pytest.raises(HoldfastError, match=said):
        READERS[ending](str(path))


@pytest.mark.parametrize("ending", READERS)
def test_file_of_a_gigabyte_is_refused_unread(ending, tmp_path):
    path = tmp_path / f"a{ending}"
    with path.open("wb") as file:
        file.truncate(2**30)
    expected = "cannot be read" if ending == ".nc" else r"too large \(1,024 MiB\)"
    with pytest.raises(HoldfastError, match=expected):
        READERS[ending](str(path))


def test_small_file_of_numbers_without_end_is_refused_unread(tmp_path):
    """It says that it holds 8 TB, of which none is written."""
    import netCDF4

    path = tmp_path / "a.nc"
    with netCDF4.Dataset(path, "w") as data:
        data.holdfast_version = hf.__version__
        data.createDimension("run", 2**40)
        data.createVariable("input", "f8", ("run",), chunksizes=(2**20,))
    with pytest.raises(OutputError, match=r"GiB, this machine has .*a machine with more memory"):
        hf.load(path)


def test_foreign_netcdf_file_is_not_loaded(tmp_path):
    path = tmp_path / "a.nc"
    xr.Dataset({"a": ("x", np.zeros(3))}).to_netcdf(path)
    with pytest.raises(OutputError, match="was not written by holdfast"):
        hf.load(path)


def test_memory_that_is_not_there_is_one_line(monkeypatch, capsys):
    def takes_too_much(*_, **__):
        raise MemoryError("Unable to allocate 5.96 GiB\nfor an array")

    monkeypatch.setattr("holdfast.commands.main.cli.main", takes_too_much)
    monkeypatch.setattr("sys.argv", ["holdfast", "run", "huge.toml"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert said.count("\n") == 1
    assert "not enough memory: Unable to allocate 5.96 GiB for an array; take a longer" in said


@pytest.mark.slow("inspection")
@pytest.mark.parametrize("name", ["inspection", "ch7-discriminating"])
def test_a_billion_starts_are_refused_with_the_memory_they_take(name):
    scenario = load_scenario(name, runs=10**9)
    with pytest.raises(HoldfastError, match=r"1,000,000,000 runs.* GiB, this machine has"):
        scenario.run()


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_scenario_may_come_from_any_editor(ending, mark, tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes((mark + ONE_STATE.replace("\n", ending)).encode())
    assert load_scenario(str(path)).system.state_names == ("T",)


# -- standard output


@pytest.mark.few("command2")
@posix
@pytest.mark.parametrize(
    "command", [["list"], ["show", "unicycle"], ["--help"], ["explain", "unicycle"]]
)
def test_output_on_a_full_disk_is_told_with_status_1(command):
    with open("/dev/full", "w") as full:
        answer = subprocess.run(
            [sys.executable, "-m", "holdfast", *command],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert answer.returncode == 1
    assert (
        answer.stderr == "holdfast: standard output cannot be written (No space left on device)\n"
    )


@pytest.mark.heavy
@posix
def test_results_are_written_though_the_summary_cannot_be(tmp_path):
    with open("/dev/full", "w") as full:
        answer = subprocess.run(
            [sys.executable, "-m", "holdfast", "run", "inspection", *FAST, "--no-figures", "--out", tmp_path],
            stdout=full, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    assert answer.returncode == 1
    assert "Traceback" not in answer.stderr
    assert json.loads((tmp_path / "summary.json").read_text())["runs"] == 4


@pytest.mark.few("0")
@posix
@pytest.mark.parametrize("status", [0, 1])
def test_reader_that_has_read_enough_does_not_change_the_status(status, tmp_path):
    """As `head`: the pipe is closed before anything is written."""
    path = tmp_path / "grows.toml"
    path.write_text(ONE_STATE.replace("h - T", "h + 1000*T**3" if status else "h - T"))
    process = started(
        "from holdfast.__main__ import main; main()", "run", path, "--no-figures", "--out", tmp_path
    )
    process.stdout.close()
    with process.stderr:
        errors = process.stderr.read()
    assert process.wait(timeout=60) == status
    assert "Traceback" not in errors
    assert "Broken" not in errors


@pytest.mark.few("<&- >&- 2>&-")
@posix
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_may_be_closed(closed, tmp_path):
    path = tmp_path / "one.toml"
    path.write_text(ONE_STATE)
    command = f"'{sys.executable}' -m holdfast run one.toml --no-figures --out out {closed}"
    answer = subprocess.run(["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    assert "Traceback" not in answer.stderr
    assert hf.load(tmp_path / "out" / "result.nc").outcomes["stayed"] == 1


def test_wrong_name_is_status_2_though_nothing_can_be_said(tmp_path):
    assert holdfast("run", "nowhere", cwd=tmp_path).returncode == 2
    with open(os.devnull if os.name == "nt" else "/dev/full", "w") as full:
        answer = subprocess.run(
            [sys.executable, "-m", "holdfast", "run", "nowhere"], stdout=full, stderr=full
        )
    assert answer.returncode == 2
