"""The command line as a user meets it: right words, wrong words, an interruption."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import xarray as xr

import holdfast as hf
from tests.c_code import needs_gcc
from tests.command_line import FAST, ONE_STATE, called, holdfast


def test_version_is_printed():
    answer = holdfast("--version")
    assert answer.returncode == 0
    assert answer.stdout.strip().endswith(hf.__version__)


def test_version_and_help_import_nothing_heavy():
    code = (
        "import sys; sys.argv = ['holdfast', '--version']\n"
        "from holdfast.commands.main import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'sympy', 'numba', 'xarray', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def test_list_names_every_entry_on_one_line():
    lines = holdfast("list").stdout.splitlines()
    names = [line.split()[1] for line in lines]
    for name in (
        "marine_vehicle",
        "unicycle",
        "steer_marine",
        "camera_view",
        "bluerov2",
        "inspection",
        "wheeled_camera",
    ):
        assert names.count(name) == 1
    assert all(len(line) < 120 for line in lines)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("marine_vehicle", "Pfaffian"),
        ("steer_marine", "(5.18a)"),
        ("camera_view", "half_angle"),
        ("videoray_pro_iii", "assumed"),
        ("inspection", "[scenario]"),
    ],
)
def test_show_explains_an_entry(name, said):
    answer = called("show", name)
    assert answer.returncode == 0
    assert said in answer.stdout
    assert not answer.stderr


def test_run_writes_the_promised_files_and_a_readable_summary(tmp_path):
    answer = holdfast("run", "inspection", *FAST, "--seed", "7", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    folder = tmp_path / "runs" / "inspection"
    assert sorted(p.name for p in folder.iterdir()) == [
        "histories.png",
        "histories.svg",
        "paths.png",
        "paths.svg",
        "result.nc",
        "summary.json",
    ]
    assert "viable         4 of 4 runs (100.0 %)" in answer.stdout
    assert "reached goal" in answer.stdout
    assert "runs/inspection" in answer.stdout
    assert not answer.stderr
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["runs"], summary["seed"], summary["scenario"]) == (4, 7, "inspection")
    with xr.open_dataset(folder / "result.nc") as data:
        assert data.sizes["run"] == 4
        assert "run.horizon=4" in data.attrs["scenario_text"]


@pytest.mark.heavy
def test_same_seed_gives_the_same_numbers(tmp_path):
    for out in ("a", "b"):
        called("run", "inspection", *FAST, "--no-figures", "--out", str(tmp_path / out))
    a, b = (hf.load(tmp_path / out / "result.nc").dataset for out in ("a", "b"))
    assert a["state"].equals(b["state"])


def test_a_file_of_ones_own_runs_from_anywhere(tmp_path):
    text = called("show", "wheeled_camera").stdout
    (tmp_path / "mine.toml").write_text(text)
    answer = called("run", "mine.toml", *FAST, cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "runs" / "mine" / "result.nc").exists()


def edited(old, new):
    def edit(text):
        assert old in text, old
        return text.replace(old, new, 1)

    return edit


BAD_FILES = [
    (
        edited("[tracking]", "[trackin]"),
        r"mine\.toml: trackin: unknown key; did you mean 'tracking'",
    ),
    (edited("horizon = 150.0", ""), r"run\.horizon: missing key"),
    (edited("horizon = 150.0", "horizon = -3"), r"horizon is -3"),
    (edited("horizon = 150.0", 'horizon = "3 m"'), r"run\.horizon: the unit 'm' does not fit"),
    (edited("substeps = 2", "substeps = 0"), r"substeps is 0; expected a whole number >= 1"),
    (
        edited("substeps = 2", "substeps = 2.5"),
        r"run\.substeps: got 2\.5; expected a valid integer",
    ),
    (edited("sample_time = 0.02", "sample_time = -0.02"), r"sample_time is -0\.02"),
    (edited("substeps = 2", "substep = 2"), r"run\.substep: unknown key; did you mean 'substeps'"),
    (edited('half_angle = "30 deg"', 'half_angle = "30 kg"'), r"region\.half_angle: .*'kg'"),
    (edited("k1 = 0.16", "k11 = 0.16"), r"law\.k11: .*did you mean 'k1'"),
    (edited("k1 = 0.16", 'k1 = "fast"'), r"law\.k1: got 'fast'"),
    (edited("k1 = 0.16", "k1 = [1]"), r"law\.k1: got \[1\]"),
    (edited("lam = 3.0", "lam = nan"), r"law\.lam: .*finite"),
    (edited('name = "steer_marine"', 'name = "steer_marin"'), r"did you mean 'steer_marine'"),
    (edited('name = "camera_view"', 'name = "camera"'), r"region\.name: unknown name 'camera'"),
    (edited('"videoray_pro_iii"', '"videoray"'), r"did you mean 'videoray_pro_iii'"),
    (
        edited("x = -1.5\n", "x = 1.5\n"),
        r"mine\.toml: starts: start 1 .* lies outside the region: ",
    ),
    (edited("x = -1.5\n", "z = -1.5\n"), r"starts\.states\.1\.z: unknown name"),
    (
        edited("random = 200", "random = -2"),
        r"starts\.random: got -2; expected greater than or equal to 0",
    ),
    (
        edited("[redesign.layers]", "[redesign.layers]\nedge_lo = [-0.2, -0.1]"),
        r"did you mean 'edge_low'",
    ),
    (edited("too_near = [-0.10, -0.03]", "too_near = [-0.03, -0.10]"), r"cmax < cmin < 0"),
    (edited('"abs(hypot(x, y) - distance) <= 0.03"', '"x.real < 1"'), r"attribute access"),
    (edited('"abs(hypot(x, y) - distance) <= 0.03"', '"10**10000000 < x"'), r"exponent 1e\+07"),
    (edited('"abs(hypot(x, y) - distance) <= 0.03"', '"exec(1) < x"'), r"function 'exec'"),
    (edited('"abs(hypot(x, y) - distance) <= 0.03"', '"distanc < x"'), r"did you mean 'distance'"),
    (
        edited("u = 5.0", "w = 5.0"),
        r"tracking: .*gain for 'u' is missing|gain for 'w' is not needed",
    ),
    (edited("[tracking]\nu = 5.0\nr = 10.0", ""), r"let the inputs track them"),
    (edited('kind = "closed-loop"', 'kind = "kernel"'), r"scenario\.kind: got 'kernel'"),
    (edited("[run]", "[run"), r"not a TOML file: .*line \d+"),
    (edited("psi = 0\n", "chi = 0\n"), r"reference\.chi: unknown name"),
    (lambda text: "", r"scenario: missing key"),
    (lambda text: "\x00\x01", r"not a TOML file"),
]


@pytest.mark.parametrize(("edit", "complaint"), BAD_FILES, ids=range(len(BAD_FILES)))
def test_bad_file_gets_one_clear_message_and_writes_nothing(
    edit, complaint, tmp_path, capsys, monkeypatch
):
    from holdfast.commands import main as cli
    from holdfast.scenario.files import read_text

    (tmp_path / "mine.toml").write_text(edit(read_text("ch5-viable-goal-set")[1]))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["holdfast", "run", "mine.toml", "--runs", "3"])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    answer = capsys.readouterr()
    assert stop.value.code == 2
    assert answer.out == ""
    errors = [line for line in answer.err.replace("\r", "\n").splitlines() if "holdfast:" in line]
    assert len(errors) == 1
    assert re.search(complaint, errors[0]), errors[0]
    assert "Traceback" not in answer.err
    assert not list(tmp_path.glob("runs/**/*.*"))


@pytest.mark.slow(
    "arguments8-expected a whole number below 2^63",
    "arguments9-seed is -1",
    "arguments14-cannot be written (/dev/null is not a folder",
)
@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["run", "inspektion"], "did you mean 'inspection'"),
        (["run", "nowhere.toml"], "cannot be read (No such file"),
        (["run", "inspection", "--runs", "0"], "--runs is 0; expected at least 1"),
        (
            ["run", "inspection", "--runs", "many"],
            "'many' is not a whole number in digits, such as 200",
        ),
        (["run", "inspection", "--runs", "1e22"], "'1e22' is not a whole number in digits"),
        (["run", "inspection", "--runs", "1" + 22 * "0"], "is too large, expected less than 2^64"),
        (["run", "inspection", "--seed", "9" * 5000], "is too large, expected less than 2^64"),
        (["run", "inspection", "--runs", "2.0"], "'2.0' is not a whole number in digits"),
        (
            ["run", "inspection", "--runs", str(2**63)],
            "expected a whole number below 2^63",
        ),
        (["run", "inspection", "--seed", "-1"], "seed is -1"),
        (["run", "inspection", "--set", "law.k1"], "expected key=value"),
        (["run", "inspection", "--set", "law.k11=1"], "did you mean 'k1'"),
        (["run", "inspection", "--set", "lw.k1=1"], "lw: unknown key"),
        (["run", "inspection", "--set", "scenario.title.x=1"], "'title' is not a table"),
        (
            ["run", "inspection", "--out", "/dev/null/x"],
            "cannot be written (/dev/null is not a folder",
        ),
        (["run", "inspection", "--colour"], "No such option"),
        (["run"], "Missing argument"),
        (["show", "marine_vehicel"], "did you mean 'marine_vehicle'"),
        (["shwo"], "No such command"),
    ],
)
def test_wrong_arguments_exit_2_with_one_message(arguments, complaint, tmp_path):
    answer = called(*arguments, cwd=tmp_path)
    assert answer.returncode == 2
    assert complaint in answer.stderr
    assert "Traceback" not in answer.stderr
    assert not list(tmp_path.glob("**/*.nc"))


@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="root writes anywhere")
def test_unwritable_output_folder_is_found_before_the_work(tmp_path):
    tmp_path.chmod(0o500)
    answer = holdfast("run", "inspection", *FAST, "--out", str(tmp_path))
    assert answer.returncode == 2
    assert "cannot be written" in answer.stderr


def test_debug_shows_the_traceback():
    answer = holdfast("--debug", "run", "inspektion")
    assert answer.returncode != 0
    assert "Traceback" in answer.stderr
    assert "did you mean 'inspection'" in answer.stderr


def test_a_scenario_fetches_nothing_unless_it_may():
    web = ("run", "berth-filter", "--set", "safety.kernel=http://127.0.0.1:9/x#berth")
    answer = holdfast(*web)
    assert answer.returncode == 2
    assert "fetches nothing unless it may; holdfast --fetch" in answer.stderr
    answer = holdfast(*web, "--fetch")
    assert answer.returncode == 2
    assert "cannot be fetched" in answer.stderr


@pytest.mark.heavy
def test_gains_beyond_their_limit_warn_and_name_the_limit(tmp_path):
    answer = called("run", "ch5-viable-goal-set", *FAST, "--set", "law.k1=0.4", cwd=tmp_path)
    assert answer.returncode == 0
    assert re.search(r"warning: k1\*mu = 0\.6 is not below its limit 0\.3508", answer.stderr)


def test_a_diverging_run_exits_1_and_says_so(tmp_path):
    answer = holdfast(
        "run",
        "wheeled_camera",
        "--runs",
        "2",
        "--set",
        "run.horizon=4",
        "--set",
        "system.rates.x=v*cos(psi) + 1000*x**3",
        cwd=tmp_path,
    )
    # the Pfaffian row no longer holds: refused before anything runs
    assert answer.returncode == 2
    assert "leave Pfaffian row 1" in answer.stderr
    answer = holdfast(
        "run",
        "wheeled_camera",
        "--runs",
        "2",
        "--set",
        "run.horizon=4",
        "--set",
        "system.rates.psi=w + 1000*psi**3",
        cwd=tmp_path,
    )
    assert answer.returncode == 1
    assert "diverged, with results" in answer.stderr
    summary = json.loads((tmp_path / "runs/wheeled_camera/summary.json").read_text())
    assert summary["outcomes"]["diverged"] >= 1


def on_a_terminal(*command, cwd=None):
    """A process, and what it writes to the terminal that is its standard error."""
    import pty
    import termios

    shown, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    process = subprocess.Popen(
        [sys.executable, *command], cwd=cwd, stderr=theirs, stdout=subprocess.DEVNULL
    )
    os.close(theirs)
    return process, os.fdopen(shown, "rb", buffering=0)


def rest(terminal):
    """All that is still written to it."""
    found = b""
    with contextlib.suppress(OSError):  # which ends so on Linux
        while part := terminal.read(4096):
            found += part
    return found.decode()


@pytest.mark.heavy
@pytest.mark.skipif(os.name == "nt", reason="terminals")
def test_bar_is_drawn_on_a_terminal_alone(tmp_path):
    process, terminal = on_a_terminal("-m", "holdfast", "run", "inspection", *FAST, cwd=tmp_path)
    with terminal:
        assert "inspection: 100%|" in rest(terminal)
    assert process.wait(timeout=30) == 0


def test_log_gets_a_line_a_minute(capsys, monkeypatch):
    from holdfast.studies import progress as patience

    now = iter([0.0, 30.0, 61.0, 61.0, 100.0, 121.0, 121.0])
    monkeypatch.setattr(patience, "time", SimpleNamespace(monotonic=lambda: next(now)))
    with patience.bar("preparing") as tell:
        for fraction in (0.1, 0.2, 0.3, 0.4):
            tell("march", fraction)
    assert re.fullmatch(
        r"march: 20 %, \d\d:\d\d left\nmarch: 40 %, \d\d:\d\d left\n", capsys.readouterr().err
    )


@pytest.mark.heavy
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_interruption_exits_130_and_leaves_no_partial_file(tmp_path):
    holdfast("run", "inspection", *FAST, cwd=tmp_path)  # compiled, so that work starts at once
    out = tmp_path / "out"
    process, terminal = on_a_terminal(
        "-c",
        "from holdfast.commands.main import main; main()",
        "run",
        "inspection",
        "--runs",
        "200",
        "--out",
        str(out),
        "--set",
        "run.horizon=20000",
        "--set",
        "run.record_every=100",
    )
    with terminal:
        while terminal.read(1) != b"%":  # of the bar: the work has begun
            pass
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        errors = rest(terminal)
    process.wait(timeout=30)
    assert process.returncode == 130
    assert "interrupted" in errors
    assert "Traceback" not in errors
    assert not out.exists()


def test_an_interruption_that_a_library_swallows_is_remembered():
    code = (
        "import os, signal\n"
        "from holdfast.host.interruption import heed, listening\n"
        "ears = listening(); ears.__enter__()\n"
        "heed()\n"
        "try: os.kill(os.getpid(), signal.SIGINT)\n"
        "except KeyboardInterrupt: pass\n"
        "try: heed()\n"
        "except KeyboardInterrupt: print('heard')\n"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.stdout == "heard\n"


@pytest.mark.few("1")
@pytest.mark.parametrize("states", [1, 2])
def test_systems_without_a_position_in_the_plane_run_and_are_drawn(tmp_path, states):
    if states == 1:
        text = ONE_STATE
    else:
        page = (Path(__file__).parent.parent / "docs" / "scenarios.md").read_text("utf-8")
        text = re.findall(r"```toml\n(.*?)```", page, re.S)[0]
    (tmp_path / "mine.toml").write_text(text)
    answer = called("run", "mine.toml", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    written = {p.name for p in (tmp_path / "runs" / "mine").iterdir()}
    assert {"result.nc", "summary.json", "histories.png"} <= written
    assert ("paths.png" in written) == (states == 2)


def test_results_where_a_file_cannot_be_replaced_are_refused_in_one_line(tmp_path):
    (tmp_path / "result.nc").mkdir()
    answer = holdfast("run", "inspection", *FAST, "--out", str(tmp_path))
    assert answer.returncode == 2
    assert "result.nc cannot be written" in answer.stderr
    assert "Traceback" not in answer.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["result.nc"]


# -- export-c


@needs_gcc
def test_exported_law_is_timed_by_the_compiler_that_is_here(tmp_path):
    answer = holdfast("export-c", "wheeled_camera", "--set", "run.horizon=4", cwd=tmp_path)
    assert answer.returncode == 0
    assert re.search(
        r"  \d+ ns per call on this machine \(\w+ -O2\), along 4 of its runs", answer.stdout
    )
    assert "wheeled_camera_step" in (tmp_path / "wheeled_camera.c").read_text()
    assert "int wheeled_camera_step(" in (tmp_path / "wheeled_camera.h").read_text()
    alone = called("export-c", "wheeled_camera", "--no-timing", "--out", "a.c", cwd=tmp_path)
    assert "  header: a.h" in alone.stdout
    assert (tmp_path / "a.h").read_text() == (tmp_path / "wheeled_camera.h").read_text()
    assert "ns per call" not in alone.stdout
    assert (tmp_path / "a.c").read_text() == (tmp_path / "wheeled_camera.c").read_text()


@pytest.mark.few("echo 'no licence' >&2; exit 3-not timed: 'cc' failed: no licence")
@pytest.mark.parametrize(
    ("compiler", "said"),
    [
        (None, "not timed: no C compiler was found (cc, gcc, clang)"),
        ("echo 'no licence' >&2; exit 3", "not timed: 'cc' failed: no licence"),
        ("exit 3", "not timed: 'cc' failed: exit status 3"),
        (
            "echo 'law.c: In main:\nlaw.c:7: error: no\nrest' >&2; exit 1",
            "not timed: 'cc' failed: law.c:7: error: no",
        ),
    ],
)
def test_law_is_written_where_it_cannot_be_timed(compiler, said, tmp_path):
    if compiler:
        (tmp_path / "cc").write_text(f"#!/bin/sh\n{compiler}\n")
        (tmp_path / "cc").chmod(0o755)
    answer = holdfast(
        "export-c", "wheeled_camera", "--set", "run.horizon=4", cwd=tmp_path, PATH=str(tmp_path)
    )
    assert answer.returncode == 0
    assert said in answer.stdout
    assert (tmp_path / "wheeled_camera.c").exists()


def test_law_and_header_are_never_one_file(tmp_path):
    answer = called("export-c", "wheeled_camera", "--no-timing", "--out", "a.h", cwd=tmp_path)
    assert answer.returncode == 2
    assert "a law in C is a file that ends in .c; write --out a.c" in answer.stderr
    assert not list(tmp_path.iterdir())


def test_kernel_has_no_law_to_export(tmp_path):
    answer = called("export-c", "ch7-discriminating", cwd=tmp_path)
    assert answer.returncode == 2
    assert "a discriminating-kernel has no law to export" in answer.stderr
    assert not list(tmp_path.iterdir())
