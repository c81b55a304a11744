"""Certificates of scenarios: what the command proves, writes and refuses."""

import json
import tomllib

import pytest
import xarray as xr
from click.testing import CliRunner

from holdfast.commands.certify import command
from holdfast.errors import ScenarioError
from holdfast.scenario.files import read_tables
from holdfast.studies.certification import certified, write_certificate
from holdfast_check.checker import check
from tests.command_line import called


@pytest.mark.heavy
def test_shipped_target_is_kept_in_view_for_ever_from_all_but_eight_cells(tmp_path):
    """Every cell is checked by the other program."""
    found = certified("seen-target")
    assert (found.kept.inside, len(found.kept.members)) == (5114, 5106)
    assert found.cells.counts == (101, 101)
    assert len(found.candidates) == 25
    files = write_certificate(found, tmp_path, figures=False)
    assert check(str(files[0])) == "5106 cells for ever: 5106 of 5106 entries hold"
    told = json.loads((tmp_path / "certificate.json").read_text())
    assert told["ranges"]["wa"] == [-0.1, 0.1]
    assert told["ranges"]["wb"] == pytest.approx([-0.15, 0.15], rel=1e-15)
    assert told["seconds"] is None


PLANE = (
    "disturbance.Vy=0.1", "system.disturb.v=[-0.05, 0.05]", "region.name=camera_view",
)  # fmt: skip


@pytest.mark.heavy
def test_camera_in_the_plane_closes_for_no_cell():
    found = certified("ch7-discriminating", PLANE, cells=31)
    assert found.cells.counts == (31, 31, 31)
    assert found.kept.inside > 2000
    assert len(found.kept.members) == 0


def test_camera_in_the_plane_is_certified_for_a_while(tmp_path):
    found = certified("ch7-discriminating", PLANE, cells=21, horizon=0.3, sample_time=0.15)
    assert len(found.kept.members) > 100
    files = write_certificate(found, tmp_path, figures=True)
    assert [f.name for f in files][:2] == ["certificate.holdfast", "certificate.json"]
    assert (tmp_path / "certificate.png").stat().st_size > 5000
    assert "with 99.9 % confidence" in check(str(files[0]), share=0.1)


def test_command_writes_a_certificate_and_the_other_one_checks_it(tmp_path):
    answer = called("certify", "seen-target", "--cells", "31", "--out", "c", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "for ever" in answer.stdout
    assert "holdfast-check c/certificate.holdfast" in answer.stdout
    assert (tmp_path / "c" / "certificate.png").exists()


def test_command_halves_cells_and_says_so(tmp_path):
    given = ["--cells", "25", "--halvings", "4", "--out", str(tmp_path)]
    answer = CliRunner().invoke(command, ["seen-target", *given])
    assert answer.exit_code == 0, answer.output
    told = json.loads((tmp_path / "certificate.json").read_text())
    assert told["cells"] == [400, 400]
    assert told["halved"] == 4
    assert f"400 x 400, of up to 16 times that width, {told['entries']} in all" in answer.output
    assert told["entries"] < 0.03 * told["cells_certified"]
    assert 0.9995 < told["share"] < 1
    assert "(99.9 %), for ever" in answer.output
    assert (tmp_path / "certificate.png").exists()
    assert "with 99.9 % confidence" in check(str(tmp_path / "certificate.holdfast"), share=0.2)


@pytest.mark.heavy
def test_command_says_where_nothing_is_certified(tmp_path):
    answer = called(
        "certify", "seen-target", "--cells", "15", "--no-figures",
        "--set", "system.disturbances.wb.bounds=[-2, 2]", "--out", tmp_path,
    )  # fmt: skip
    assert answer.returncode == 1
    assert "no cell is certified" in answer.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["inspection"], "is no kernel of a region"),
        (["seen-target", "--uncertain", "mass"], "expected NAME=LOW,HIGH"),
        (["seen-target", "--uncertain", "mass=1,2"], "'mass', which is no parameter"),
        (["seen-target", "--sample-time", "-1"], "--sample-time -1; expected seconds, above 0"),
        (["seen-target", "--cells", "0"], "0 cells"),
    ],
)
def test_command_names_what_is_wrong(tmp_path, arguments, message):
    answer = called("certify", *arguments, "--out", tmp_path)
    assert answer.returncode == 2
    assert message in answer.stderr


def test_reach_is_no_kernel():
    with pytest.raises(ScenarioError, match="is no kernel of a region"):
        certified("ch7-forward-reach")
    assert tomllib.loads(read_tables("seen-target")[1])["scenario"]["kind"].endswith("kernel")


@pytest.mark.heavy
def test_cart_in_four_states_is_certified_for_ever(tmp_path):
    found = certified("pushed-cart", cells=15, sample_time=0.6, inputs=3)
    assert found.cells.counts == (15, 15, 15, 15)
    assert 0.2 < found.kept.share < 0.41, "of the region 41 % can be kept"
    assert check(str(found.write(tmp_path / "c.holdfast")), share=200 / len(found.kept.members))


@pytest.mark.heavy
def test_errors_and_a_delay_cost_cells_of_the_view(tmp_path):
    given = ["--error", "left=0.01", "--delay", "0.02", "--out", str(tmp_path), "--no-figures"]
    answer = called("certify", "seen-target", *given)
    assert "certified      3624 of 5036 cells in the region (72.0 %), for ever" in answer.stdout
    assert "measured       left to 0.01 m" in answer.stdout
    assert "late           inputs, by up to 0.02 s" in answer.stdout


@pytest.mark.heavy
def test_capture_basin_is_certified_to_its_goal(tmp_path):
    given = ["--cells", "31", "--sample-time", "0.3", "--out", str(tmp_path), "--no-figures"]
    answer = called("certify", "ch7-capture-basin", *given)
    assert "to the target within" in answer.stdout
    assert json.loads((tmp_path / "certificate.json").read_text("utf-8"))["kind"] == "reach"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--error", "left"), "--error left; expected NAME=SIZE"),
        (("--error", "up=1"), "'up', which is no state"),
        (("--delay", "0.1"), "below the sample time"),
    ],
)
def test_errors_and_delays_that_are_none_are_refused(given, said, tmp_path):
    answer = called("certify", "seen-target", *given, "--out", tmp_path)
    assert answer.returncode == 2
    assert said in answer.stderr


@pytest.mark.heavy
def test_command_tries_the_cells_of_a_kernel(tmp_path):
    """The view is certified from the file of its kernel, as from the whole region."""
    solved = called(
        "run", "seen-target", "--set", "grid.nodes=15", "--set", "promise.runs=10", "--out", "k",
        "--no-figures", cwd=tmp_path,
    )  # fmt: skip
    assert solved.returncode in (0, 1), solved.stderr
    of = ("certify", "seen-target", "--cells", "15", "--no-figures")
    shares = []
    for name, more in (("a", ()), ("b", ("--kernel", "k/result.nc"))):
        answer = called(*of, *more, "--out", name, cwd=tmp_path)
        assert answer.returncode == 0, answer.stderr
        shares.append(json.loads((tmp_path / name / "certificate.json").read_text())["share"])
    assert shares[1] == pytest.approx(shares[0], abs=0.01)
    answer = called(*of, "--margin", "0.1", "--out", "c", cwd=tmp_path)
    assert answer.returncode == 2
    assert "--margin without --kernel" in answer.stderr


LAG = """
[scenario]
title = "What a lag reaches"
kind = "forward-reachable-set"
source = "made up"

[system]
states = { x = { unit = "m" }, y = { unit = "m" } }
inputs = { a = { unit = "m/s", bounds = [-1, 1] } }
empirical = "numbers"
rates = { x = "a - x", y = "-y" }

[origin.constraints]
near = { expression = "x**2 + y**2 - 0.01", unit = "m^2" }

[grid]
nodes = 41
box = { x = [-1.5, 1.5], y = [-0.5, 0.5] }
ends = { x = "extrapolated", y = "extrapolated" }

[march]
horizon = 3
"""


def test_command_says_outside_of_which_cells_nothing_is_reached(tmp_path):
    """x' = -x + a comes to 0.955 in 3 s: the outer set goes on beyond it, the set of a grid not."""
    (tmp_path / "lag.toml").write_text(LAG, "utf-8")
    solved = called("run", "lag.toml", "--out", "k", "--no-figures", cwd=tmp_path)
    assert solved.returncode == 0, solved.stderr
    answer = called("certify", "lag.toml", "--outer", "k/result.nc", "--out", "o", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "outer set of a forward reachable set" in answer.stdout
    assert "files in o: outer.nc, outer.json, outer.png" in answer.stdout
    reaches = json.loads((tmp_path / "k/summary.json").read_text())["extent"]["x"][1]
    said = json.loads((tmp_path / "o/outer.json").read_text())
    assert reaches < 0.955 < said["extent"]["x"][1] < 1.2
    with xr.open_dataset(tmp_path / "o/outer.nc") as cells:
        assert int(cells["member"].sum()) == said["members"] < cells["member"].size
        assert cells["x"].attrs["units"] == "m"
        assert not cells["member"].sel(x=1.3, y=0, method="nearest")


@pytest.mark.heavy
def test_command_says_which_states_of_a_kernel_are_lost_and_the_checker_agrees(tmp_path):
    of = ("ferry-banks", "--set", "grid.nodes=21")
    solved = called(
        "run", *of, "--set", "promise.runs=10", "--out", "k", "--no-figures", cwd=tmp_path
    )
    assert solved.returncode in (0, 1), solved.stderr
    answer = called(
        "certify", *of, "--outer", "k/result.nc", "--sample-time", "0.9", "--out", "o",
        "--no-figures", cwd=tmp_path,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    assert "drives it out of that" in answer.stdout
    assert "check it: holdfast-check o/lost.holdfast" in answer.stdout
    assert "reach the target" in check(str(tmp_path / "o/lost.holdfast"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("seen-target", "--outer", "f.nc", "--delay", "0.1"), "--delay with --outer"),
        (("seen-target", "--outer", "f.nc", "--box", "x=0,1"), "--box with --outer"),
        (
            ("ferry-tacks", "--box", "y=0,1", "--halvings", "0"),
            "--box with --largest, --halvings or --enclosure",
        ),
        (("seen-target", "--outer", "f.nc", "--kernel", "f.nc"), "--kernel with --outer"),
        (("seen-target", "--outer", "no.nc"), "no.nc"),
        (("inspection", "--outer", "f.nc"), "'inspection' is no set on a grid"),
    ],
)
def test_outer_sets_that_are_none_are_refused_in_a_line(given, said, tmp_path):
    answer = called("certify", *given, "--out", "o", cwd=tmp_path)
    assert answer.returncode == 2
    assert said in answer.stderr
    assert answer.stderr.strip().count("\n") == 0
    assert not (tmp_path / "o").exists()
