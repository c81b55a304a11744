"""`holdfast filter` between a controller and its vehicle, and `holdfast monitor` that watches it."""

import contextlib
import io
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import holdfast as hf
from holdfast.analysis.online.decision import Interventions
from holdfast.host.streams import Foot
from holdfast.presentation.text.interventions import Live
from tests.command_line import called, started
from tests.decisions import START, camera_filter, drive, messages, pd, record, sample, stream
from tests.scenario_files import EXTERNAL

MAIN = "from holdfast.__main__ import main; main()"


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(EXTERNAL)
    return tmp_path


def process(*arguments):
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    environment = os.environ | {"PYTHONWARNINGS": "default"}
    words = [sys.executable, "-c", MAIN, *map(str, arguments)]
    return subprocess.Popen(words, env=environment, **pipes)


def test_controller_plant_filter_and_monitor_are_a_pipe(mine):
    """The PD controller keeps its target in view, and the monitor sees what the records say."""
    vehicle = hf.systems.marine_vehicle()
    boat, records = hf.Plant(vehicle, START), []
    keep = process("filter", "mine.toml", "--log", "log.jsonl")
    watch = process("monitor", "--mcap", "seen.mcap", "--summary", "seen.json")
    _, alone = camera_filter()
    for _ in range(300):
        keep.stdin.write(sample(boat.state).encode())
        keep.stdin.flush()
        answer = keep.stdout.readline()
        watch.stdin.write(answer)
        watch.stdin.flush()
        records.append(hf.DecisionRecord.read(answer))
        wanted = alone.step(boat.state, pd(boat.state))
        assert list(records[-1].actuators.values()) == wanted.actuators.tolist()
        boat.step(list(records[-1].input.values()))
    view = hf.Boundary(vehicle, hf.regions.camera_view())
    assert view.worst([list(r.state.values()) for r in records]).max() <= 0
    rest, err = keep.communicate(timeout=30)
    assert (keep.returncode, rest) == (0, b"")
    changed = sum(r.status == "changed" for r in records)
    assert f"holdfast: 300 samples: {changed} changed, 0 infeasible, 0 lost" in err.decode()
    assert err.decode().startswith("holdfast: between samples, ")
    assert err.decode().count("constraints may be crossed: ") == 1
    assert (mine / "log.jsonl").read_text().splitlines() == [r.line() for r in records]
    out, err = watch.communicate(timeout=30)
    assert (watch.returncode, err) == (0, b"")
    assert b"\x1b" not in out
    page = (Path(__file__).parents[1] / "docs/own_controller.md").read_text("utf-8")
    for line in out.decode().partition("\n\n")[0].splitlines():
        assert line in page
    wanted = Interventions()
    ended = [e.intervention for r in records for e in wanted.add(r) if e.what == "ended"]
    ended += [e.intervention for e in wanted.end()]
    said = json.loads((mine / "seen.json").read_text())
    assert said["list"] == json.loads(json.dumps([i.plain() for i in ended]))
    assert (said["samples"], said["interventions"]) == (300, len(ended))
    assert said["share"]["changed"] == changed / 300
    pytest.importorskip("mcap")
    assert len(messages("seen.mcap", "/holdfast/decision")) == 300
    assert len(messages("seen.mcap", "/holdfast/intervention")) == len(ended)


@pytest.mark.heavy
def test_filter_answers_a_bad_line_with_the_fallback_and_says_so_at_the_end(mine):
    lines = [sample(START), "nonsense\n", '{"state": {}}\n', sample(START)]
    (mine / "in.jsonl").write_text("".join(lines))
    answer = called("filter", "mine.toml", stdin="in.jsonl")
    assert answer.returncode == 1
    found = [hf.DecisionRecord.read(line) for line in answer.stdout.splitlines()]
    assert [r.status for r in found] == ["changed", "not a number", "not a number", "changed"]
    assert found[1].input == {"tau_u": 0.0, "tau_r": 0.0}
    assert "line 2 is no sample: 'nonsense' is no table of JSON" in answer.stderr
    assert "4 samples: 2 changed, 0 infeasible, 0 lost, 2 not a number" in answer.stderr


@pytest.mark.heavy
def test_filter_refuses_what_it_cannot_begin_with(mine):
    (mine / "in.jsonl").write_text('{"x": 1}\n')
    for words, said in (
        (["mine.toml"], "line 1 is no sample: unknown key 'x'"),
        (["inspection"], "it has no filter around another controller"),
        (["mine.toml", "--patience", "0"], "patience is 0"),
        (["mine.toml", "--log", "nowhere/log"], "nowhere/log cannot be written"),
        (["mine.toml", "--set", "safeguard.gain=1"], "safeguard.gain: unknown key"),
    ):
        answer = called("filter", *words, stdin="in.jsonl")
        assert (answer.returncode, answer.stdout) == (2, "")
        assert said in answer.stderr
        assert "Traceback" not in answer.stderr
        assert "between samples" not in answer.stderr


@pytest.mark.heavy
def test_filter_of_an_empty_stream_has_no_samples(mine):
    answer = called("filter", "mine.toml")
    assert (answer.returncode, answer.stdout) == (0, "")
    assert "holdfast: 0 samples: 0 changed, 0 infeasible, 0 lost" in answer.stderr


def test_filter_whose_log_is_full_goes_on_and_says_so(mine):
    if not os.path.exists("/dev/full"):
        pytest.skip("there is no /dev/full")
    (mine / "in.jsonl").write_text(sample(START) * 2)
    answer = called("filter", "mine.toml", "--log", "/dev/full", stdin="in.jsonl")
    assert (answer.returncode, len(answer.stdout.splitlines())) == (1, 2)
    assert answer.stderr.count("/dev/full has no more decisions") == 1


def begun(watch, count):
    """Feed decisions, the last of which begins an intervention, until the monitor has said so."""
    records = [record(0.02 * k) for k in range(count)]
    records.append(record(0.02 * count, "changed", change=0.5, why="changed u"))
    watch.stdin.write("".join(r.line() + "\n" for r in records).encode())
    watch.stdin.flush()
    assert b"changed u" in watch.stdout.readline()


@pytest.mark.slow("2-130")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_monitor_that_is_stopped_closes_its_files(number, status, tmp_path):
    pytest.importorskip("mcap")
    path, summary = tmp_path / "seen.mcap", tmp_path / "seen.json"
    watch = process("monitor", "--mcap", path, "--summary", summary)
    begun(watch, 50)
    watch.send_signal(number)
    watch.wait(timeout=30)  # its input is still open
    out, err = watch.communicate()
    assert (watch.returncode, err) == (status, b"")
    assert b"ended: changed" in out
    assert b"samples          51" in out
    assert len(messages(path, "/holdfast/decision")) == 51
    assert len(messages(path, "/holdfast/intervention")) == 1
    assert json.loads(summary.read_text())["samples"] == 51


def test_monitor_that_is_killed_leaves_all_but_its_last_messages(tmp_path):
    pytest.importorskip("mcap")
    from mcap.exceptions import EndOfFile
    from mcap.records import Message
    from mcap.stream_reader import StreamReader

    from holdfast.interop.decision_log import CHUNK

    path, found = tmp_path / "seen.mcap", []
    watch = process("monitor", "--mcap", path)
    begun(watch, 2000)
    watch.kill()
    watch.communicate()
    with open(path, "rb") as file, contextlib.suppress(EndOfFile):
        for one in StreamReader(file).records:
            if isinstance(one, Message):
                found.append(one)
    assert CHUNK == 64 * 1024
    lost = CHUNK / min(len(m.data) for m in found)
    assert lost == pytest.approx(300, abs=30)
    assert 2000 - lost <= len(found) < 2000


def test_monitor_counts_what_is_no_decision_and_goes_on(tmp_path):
    lines = [r.line() for r in [*stream("pppp"), *stream("pc")]]
    lines[2:2] = ["nonsense", "{}", '{"t": null' + lines[0][9:]]
    (tmp_path / "in.jsonl").write_text("\n".join(lines))
    answer = called("monitor", tmp_path / "in.jsonl", "--summary", tmp_path / "out.json")
    assert answer.returncode == 1
    assert "line 3: 'nonsense' is no decision\n" in answer.stdout
    assert "line 4: '{}' is no decision\n" in answer.stdout
    assert "line 5: the time of a decision is nan\n" in answer.stdout
    said = json.loads((tmp_path / "out.json").read_text())
    assert (said["samples"], said["sessions"], said["lines_refused"]) == (6, 2, 3)
    assert ", 2 sessions" in answer.stdout
    (tmp_path / "in.jsonl").write_text("nonsense\n" * 100)
    answer = called("monitor", "-", stdin=tmp_path / "in.jsonl")
    assert answer.returncode == 1
    assert answer.stdout.count("is no decision") == 20
    assert "there was no decision to read" in answer.stderr


def test_monitor_refuses_what_it_cannot_read_or_write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.mcap").touch()
    for words, said in (
        (["nowhere.jsonl"], "nowhere.jsonl: cannot be read"),
        ([tmp_path], "it is a folder"),
        (["--gap", "-1"], "the gap is -1"),
        (["--mcap", "old.mcap"], "old.mcap exists already"),
        (["--mcap", "nowhere/a.mcap"], "nowhere/a.mcap cannot be written"),
        (["--summary", "old.mcap/a.json"], "cannot be written"),
    ):
        answer = called("monitor", *words)
        assert (answer.returncode, answer.stdout) == (2, "")
        assert said in answer.stderr
    assert {p.name for p in tmp_path.iterdir()} == {"old.mcap"}
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    monkeypatch.delitem(sys.modules, "holdfast.interop.decision_log", raising=False)
    answer = called("monitor", "--mcap", "new.mcap")
    assert answer.returncode == 2
    assert 'pip install "holdfast[interop]"' in answer.stderr


class Terminal(io.StringIO):
    """A stream that a terminal reads."""

    encoding = "utf-8"

    def isatty(self):
        return True


def test_monitor_on_a_terminal_draws_its_foot_again_and_leaves_the_log(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.delenv("NO_COLOR", raising=False)
    records = stream("ppcccpppppppp", why="changed u: 'wall' is near\x1b[2J")
    (tmp_path / "in.jsonl").write_text("".join(r.line() + "\n" for r in records))
    drawn = called("monitor", tmp_path / "in.jsonl", stdout=Terminal()).stdout
    assert "\x1b[32m" in drawn
    assert "\x1b[2J" not in drawn
    assert "ended: changed for 0.30 s" in drawn
    assert drawn.rstrip().endswith("longest silence  0.1 s")
    monkeypatch.setenv("NO_COLOR", "1")
    drawn = called("monitor", tmp_path / "in.jsonl", stdout=Terminal()).stdout
    assert set(re.findall(r"\x1b\[\??(?:\d|;)*([a-zA-Z])", drawn)) == {"F", "K", "J", "l", "h"}
    for wanted in ("dumb", ""):
        monkeypatch.setenv("TERM", wanted)
        assert "\x1b" not in called("monitor", tmp_path / "in.jsonl", stdout=Terminal()).stdout


def test_foot_of_a_terminal_stays_below_what_is_said(monkeypatch):
    """Of a terminal that moves its cursor up as it is told."""
    monkeypatch.setenv("LINES", "24")
    out = io.StringIO()
    foot = Foot(out)
    foot.draw(["a", "b"])
    foot.draw(["c", "d"], ["one", "two"])
    foot.draw([], ["three"])
    rows, at = [], 0
    for part in re.findall(r"\x1b\[\d*[FKJ]|\x1b\[\?7[lh]|\n|[a-z]+", out.getvalue()):
        if part.endswith("F"):
            at -= int(part[2:-1])
        elif part.endswith("J"):
            del rows[at:]
        elif part == "\n":
            at += 1
        elif part.isalpha():
            rows[at : at + 1] = [part]
    assert rows == ["one", "two", "three"]


@pytest.mark.few("200")
@pytest.mark.parametrize("width", [40, 60, 80, 200])
def test_live_view_fits_the_terminal(width):
    vehicle, keep = camera_filter()
    live = Live(colours=False, blocks=True)
    assert live.lines(width, None, 0, 5.0)[1] == "no decision yet for 5 s"
    seen = Interventions()
    for r in drive(hf.Relay(keep), hf.Plant(vehicle, START), 12, command_until=8.0):
        seen.add(r)
        live.add(r)
    rows = live.lines(width, seen.current, seen.count, 0.0)
    assert all(len(row) <= max(width, 60) for row in rows)
    assert "NO COMMAND" in rows[1]
    assert "▁" in rows[2]
    assert "█" in rows[3]
    assert "no decision for 3 s".upper() in live.lines(width, seen.current, 3, 3.0)[1]


def test_trend_of_the_value_falls_to_the_bottom_at_the_boundary():
    live = Live(colours=False, blocks=False)
    for k in range(101):
        live.add(record(0.1 * k, value=1.0 - 0.01 * k))
    trend = live.lines(100, None, 0, 0.0)[2].split()[1]
    assert (trend[0], trend[-1]) == ("#", "_")
    assert [*trend] == sorted(trend, key="_.-=+*%#".index, reverse=True)
    live.add(record(0.0, value=0.5))  # a new session
    assert live.lines(100, None, 0, 0.0)[2].split()[1] == "#"


def test_work_that_does_not_end_when_it_is_stopped_is_ended():
    code = (
        "import time\n"
        "from holdfast.host.interruption import listening, postponed\n"
        "with listening(), postponed():\n"
        "    print('begun', flush=True)\n"
        "    while True: time.sleep(60)\n"
    )
    working = started(code)
    assert working.stdout.readline() == "begun\n"
    working.terminate()
    working.communicate(timeout=30)
    assert working.returncode == 143


def told_to_end(keep, number):
    """What a filter says that is told to end."""
    keep.send_signal(number)
    _, err = keep.communicate(timeout=30)
    assert keep.returncode == 0, err
    return err.decode()


@pytest.mark.heavy
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_filter_is_a_component_of_mavlink_until_it_is_told_to_end(mine, number):
    pytest.importorskip("pymavlink")
    from holdfast.interop.mavlink import ManualControl, SimulatedVehicle

    vehicle = hf.systems.marine_vehicle()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    keep = process(
        "filter", "mine.toml", "--mavlink", "udpin:127.0.0.1:0", f"udpin:127.0.0.1:{port}"
    )
    boat = SimulatedVehicle(
        vehicle, START, ManualControl(vehicle), connection=f"udpout:127.0.0.1:{port}"
    )
    with boat:
        until = time.monotonic() + 30
        read = b""
        while b'"lost": "command"' not in read:
            assert time.monotonic() < until
            boat.turn(time.monotonic())
            if select.select([keep.stdout], [], [], 0.005)[0]:
                read += os.read(keep.stdout.fileno(), 1 << 16)
    said = told_to_end(keep, number)
    assert "samples" in said


@pytest.mark.heavy
def test_filter_is_a_node_of_ros2_until_it_is_told_to_end(mine):
    pytest.importorskip("zenoh")
    from holdfast.interop.ros2 import Network, VehicleNode, router

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    boat = hf.Plant(hf.systems.marine_vehicle(), START)
    with router(address), VehicleNode(boat, network=Network(connect=(address,))) as sea:
        keep = process("filter", "mine.toml", "--ros2", "--router", address)
        until, read = time.monotonic() + 30, b""
        while b'"lost": "command"' not in read:
            assert time.monotonic() < until
            sea.step(time.monotonic())
            if select.select([keep.stdout], [], [], 0.02)[0]:
                read += os.read(keep.stdout.fileno(), 1 << 16)
        said = told_to_end(keep, signal.SIGTERM)
    assert "samples" in said


def test_files_that_exist_are_not_written_over(mine):
    (mine / "some.jsonl").write_text(record(0.0, "changed", change=0.1).line() + "\n")
    found = called("monitor", "some.jsonl", "--summary", "some.jsonl")
    assert (found.returncode, "exists already" in found.stderr) == (2, True)
    found = called("filter", "mine.toml", "--log", "mine.toml", stdin="some.jsonl")
    assert (found.returncode, "has something else" in found.stderr) == (2, True)
    found = called("export-c", "mine.toml", "--out", "mine.toml")
    assert (found.returncode, "ends in .c" in found.stderr) == (2, True)
    assert (mine / "mine.toml").read_text() == EXTERNAL


def test_filter_has_one_connection(mine):
    found = called("filter", "mine.toml", "--router", "tcp/x:1")
    assert (found.returncode, "give it too" in found.stderr) == (2, True)
    found = called("filter", "mine.toml", "--ros2", "--mavlink", "udpin:h:1", "udpin:h:2")
    assert found.returncode == 2
    assert "give one" in found.stderr


@pytest.mark.heavy
def test_filter_whose_decisions_nobody_reads_ends_all_the_same(mine):
    """A monitor that is stopped: the pipe is full after a while, and nothing waits for it."""
    pytest.importorskip("pymavlink")
    from holdfast.interop.mavlink import ManualControl, SimulatedVehicle

    vehicle = hf.systems.marine_vehicle()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    keep = process(
        "filter", "mine.toml", "--set", "run.sample_time=0.002", "--set", "run.record_every=0.02",
        "--mavlink", "udpin:127.0.0.1:0", f"udpin:127.0.0.1:{port}",
    )  # fmt: skip
    full = 1 << 17  # bytes of decisions: more than a pipe holds
    with SimulatedVehicle(
        vehicle, START, ManualControl(vehicle), connection=f"udpout:127.0.0.1:{port}"
    ) as boat:
        until, decided = time.monotonic() + 30, None
        while decided is None or time.monotonic() < decided + full / 300 * 0.002 + 0.5:
            assert time.monotonic() < until
            boat.turn(time.monotonic())
            if decided is None and select.select([keep.stdout], [], [], 0)[0]:
                decided = time.monotonic()
            time.sleep(0.002)
    keep.send_signal(signal.SIGTERM)
    assert keep.wait(timeout=60) in (0, 1)
    keep.communicate()
