"""Logs as tables: names, units and times of their columns, and files that are none."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import holdfast as hf
from holdfast.analysis.identification.log import Log, Signal
from holdfast.errors import HoldfastError, OutputError, SimulationError

pytest.importorskip("pandas", reason="needs holdfast[interop]")

from holdfast.interop.logs.read import read_log, write_log

BOAT = hf.systems.marine_vehicle()
T = np.arange(20) * 0.1


def file(folder, header, rows, mark=","):
    path = folder / "log.csv"
    lines = [header, *(mark.join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def read(folder, header, rows=None, mark=",", **how):
    rows = np.column_stack([T] * (header.count(mark) + 1)) if rows is None else rows
    return read_log(file(folder, header, rows, mark), BOAT, **how)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_columns_of_the_names_of_the_system_are_read_with_their_units(tmp_path, mark):
    rows = np.column_stack([1000 * T, 100 * T, 10 * T, T])
    log = read(tmp_path, mark.join(["time [ms]", "x (cm)", "psi [deg]", "tau_u"]), rows, mark)
    assert list(log.states) == ["x", "psi"]
    assert list(log.inputs) == ["tau_u"]
    assert log.states["x"].value == pytest.approx(T)
    assert log.states["psi"].value == pytest.approx(np.radians(10 * T))
    assert log.states["psi"].time == pytest.approx(T)
    assert log.gap == pytest.approx(0.5)
    assert log.repairs == ()


def test_other_names_and_units_are_given(tmp_path):
    names = {"psi": "heading [deg]", "x": "pose.x"}
    log = read(tmp_path, "stamp,heading,pose.x", names=names, time="stamp [min]")
    assert log.states["psi"].value == pytest.approx(np.radians(T))
    assert log.states["x"].time == pytest.approx(60 * T)


@pytest.mark.parametrize(
    ("header", "scale"),
    [("time", 1), ("t", 1), ("Time (s)", 1), ("time_ms", 1e3), ("TimeUS", 1e6), ("timestamp [ns]", 1e9),
     ("stamp_us", 1e6)],
)  # fmt: skip
def test_units_of_times_are_recognised(tmp_path, header, scale):
    log = read(tmp_path, f"{header},x", np.column_stack([np.round(T * scale, 6), T]))
    assert log.states["x"].time == pytest.approx(T, abs=1e-9)


def test_times_since_1970_are_recognised_though_one_is_0(tmp_path):
    stamps = [1_700_000_000_000_000 + round(1e6 * t) for t in T]
    stamps[7] = 0
    log = read(tmp_path, "timestamp,x", list(zip(stamps, T, strict=True)))
    assert np.diff(log.states["x"].time)[1:] == pytest.approx(
        np.delete(np.diff(T), 7)[:18], abs=0.11
    )
    assert "'timestamp' read as us since 1970" in log.repairs
    dates = [f"2024-05-01T10:00:{t:06.3f}Z" for t in T]
    log = read(tmp_path, "timestamp,x", list(zip(dates, T, strict=True)))
    assert log.states["x"].time == pytest.approx(T)


def test_times_in_milliseconds_without_a_unit_are_questioned(tmp_path):
    log = read(tmp_path, "time,x", np.column_stack([1000 * T, T]))
    assert log.repairs == (
        "'time' has no unit: taken as seconds, with a value every 100 s; "
        'if it is in another unit, say it: --time "time [ms]"',
    )


def test_text_empty_places_and_ragged_lines_are_counted(tmp_path):
    rows = [[t, t, "", ""] for t in T]
    rows[3][1], rows[5][1], rows[4][2], rows[9][2] = "n/a?", "", "1", "2"
    rows[7] = [0.7, 1, 2, 3, 4, 5]
    log = read(tmp_path, "t,x,y,psi", rows)
    assert log.states["x"].time == pytest.approx(np.delete(T, [3, 5, 7]))
    assert log.states["y"].time == pytest.approx([0.4, 0.9])
    assert log.repairs == (
        "1 lines with another number of columns left out",
        "x: 1 values that are not numbers left out",
        "psi: the column is empty",
    )


def test_what_is_not_there_is_named_with_what_is(tmp_path):
    for header, how, cause in (
        ("t,x,psii", {"names": {"psi": "psie"}}, "no column 'psie'; did you mean 'psii'?"),
        ("t,a,b", {}, r"no state of system .* the log has a, b"),
        ("a,x", {}, "no column of times"),
        ("t,x", {"time": "when"}, "no column 'when'"),
        ("t,x [m/s]", {}, "the unit 'm/s' does not fit"),
        ("t [kg],x", {}, "column 't .kg.'"),
        ("t,x", {"names": {"z": "x"}}, "'z' is neither a state nor an input"),
        ("t,psi [deg],psi [rad]", {}, "several columns 'psi'"),
        ("t,x", {"gap": 0.0}, "gap is 0"),
    ):
        with pytest.raises(SimulationError, match=cause):
            read(tmp_path, header, **how)


def test_one_of_two_columns_is_chosen_by_its_whole_header(tmp_path):
    log = read(tmp_path, "t,psi [deg],psi [rad]", names={"psi": "psi [rad]"})
    assert log.states["psi"].value == pytest.approx(T)


@pytest.mark.parametrize(
    "content",
    [b"", b"\n\n", b"t,x\n", b"t,x\n1,2\n", b"\x00" * 4096, b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
     b"t,x\n" + b"a,b\n" * 9, b"t" * 1_000_000, b"t,x\n1," + b"9" * 100_000 + b"\n", b't,x\n"1,2\n3,4\n',
     b"t,x\n\xff,1\n2,3\n", b"\x89MCAP0\r\n" + b"\x01" * 50],
    ids=range(12),
)  # fmt: skip
def test_hostile_file_is_refused_with_a_cause(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with pytest.raises(HoldfastError):
        read_log(path, BOAT)


def test_file_of_hundred_thousand_rows_and_one_of_ten_thousand_columns_are_read_soon(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,x,y,psi,u\n" + "".join(f"{k},1.25,2.5,0.125,{k}\n" for k in range(100_000)))
    began = time.process_time()
    assert len(read_log(path, BOAT).states["x"].time) == 100_000
    path.write_text("t,x," + ",".join(f"c{k}" for k in range(10_000)) + "\n" + "1,2\n2,3\n" * 5)
    assert len(read_log(path, BOAT).states["x"].time) == 2
    assert time.process_time() - began < 5.0  # 0.2 s and 0.6 s alone


SIGNALS = st.lists(
    st.tuples(st.integers(0, 10**6), st.floats(-3, 3)), min_size=2, max_size=40, unique_by=lambda p: p[0]
)  # fmt: skip


@given(SIGNALS, SIGNALS)
def test_log_that_was_written_is_read_as_it_was(tmp_path_factory, one, other):
    def signal(points):
        points = sorted(points)
        return Signal(
            np.array([t / 1000 for t, _ in points]), np.array([value for _, value in points])
        )

    written = Log("a", {"x": signal(one)}, {"tau_u": signal(other)}, 1.0)
    path = write_log(written, tmp_path_factory.mktemp("log") / "a.csv")
    try:
        log = read_log(path, BOAT, gap=1.0)
    except SimulationError as refusal:
        pytest.fail(str(refusal))
    first = min(s.time[0] for s in (written.states["x"], written.inputs["tau_u"]))
    if not [s for s in log.repairs if "far off" in s]:
        assert log.states["x"].time + first == pytest.approx(written.states["x"].time, rel=1e-12)
        assert log.states["x"].value == pytest.approx(written.states["x"].value, rel=1e-12)
    assert log.inputs["tau_u"].time + first == pytest.approx(
        written.inputs["tau_u"].time, rel=1e-12
    )
    assert log.inputs["tau_u"].value == pytest.approx(written.inputs["tau_u"].value, rel=1e-12)
    with pytest.raises(OutputError, match="exists already"):
        write_log(written, path)


def test_heading_of_a_log_stays_continuous_through_a_file(tmp_path):
    turning = Signal(T, 8 * math.pi * T)
    path = write_log(Log("a", {"psi": turning}, {}, 1.0), tmp_path / "a.csv")
    assert read_log(path, BOAT).states["psi"].value == pytest.approx(turning.value)
