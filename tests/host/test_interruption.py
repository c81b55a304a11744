"""Ctrl-C, SIGTERM and SIGKILL at any moment: the program ends, and no partial file stays."""

import os
import random
import signal
import subprocess
import sys
import threading
import time

import pytest

from holdfast.host.files import atomic_file, remove_left_over, undisturbed
from tests.command_line import started

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals")

BIG = """
import os, sys, threading, time
import numpy as np, xarray as xr
from pathlib import Path
from holdfast.analysis.simulation.files import write_netcdf
folder = Path(sys.argv[1])
numbers = np.random.default_rng(0).random((100, 1500))
data = xr.Dataset({f"v{k}": (("run", "time"), numbers + k) for k in range(8)})
"""


@pytest.mark.heavy
def test_interrupted_writes_leave_no_file_and_no_lock_behind(tmp_path):
    """In a session that goes on, as a notebook does: the next write works."""
    code = (
        BIG
        + """
import random, signal
moments = random.Random(0)
begun = time.monotonic()
write_netcdf(data, folder / "a.nc")
taken = time.monotonic() - begun
for k in range(8):
    timer = threading.Timer(moments.uniform(0, taken), lambda: os.kill(os.getpid(), signal.SIGINT))
    try:
        timer.start()
        write_netcdf(data, folder / "a.nc")
        time.sleep(2 * taken)
    except KeyboardInterrupt:
        print("interrupted")
write_netcdf(data, folder / "b.nc")
"""
    )
    answer = started(code, tmp_path)
    out, err = answer.communicate(timeout=60)
    assert answer.returncode == 0, err
    assert out.count("interrupted") == 8
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.nc", "b.nc"]


@pytest.mark.heavy
def test_interruptions_are_tested_where_a_script_has_the_tests_in_its_background(tmp_path):
    """Its shell ignores SIGINT for them, and every process that they start would ignore it too."""
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "os.execv(sys.executable, [sys.executable, '-m', 'pytest', '-n', '0', *sys.argv[1:]])\n"
    )
    answer = started(
        code, *("-p", "no:cacheprovider", "-k", "waits_for_ever and 1", "--timeout", "60", __file__)
    )
    out, err = answer.communicate(timeout=120)
    assert answer.returncode == 0, out + err
    assert "1 passed" in out


def hung(where):
    """The program with its `result.nc` never done: another thread holds the lock of the library."""
    return f"""
import sys, threading, time
from holdfast.analysis.simulation import files
from holdfast.host.files import atomic_file
def write(dataset, path):
    with atomic_file(path) as partial:
        partial.write_text("half")
        print("writing", flush=True)
        {where}
files.write_arrays = write
import holdfast.analysis.simulation.result
holdfast.analysis.simulation.result.write_arrays = write
from holdfast.__main__ import main
sys.argv[1:] = ["run", "ch2-unicycle", "--no-figures", "--out", sys.argv[1]]
main()
"""


@pytest.mark.few("1")
@pytest.mark.parametrize("times", [1, 2])
def test_interruption_ends_a_write_that_waits_for_ever(times, tmp_path):
    lock = "lock = threading.Lock(); lock.acquire()\n        "
    code = hung(
        lock
        + "while True:\n            try: lock.acquire()\n            except KeyboardInterrupt: pass"
    )
    process = started(code, tmp_path)
    assert process.stdout.readline() == "writing\n"
    begun = time.monotonic()
    for _ in range(times):
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted; no unfinished result is left" in err
    assert "Traceback" not in err
    assert time.monotonic() - begun < 10  # seconds: not for ever
    assert not list(tmp_path.iterdir())


def test_terminated_run_leaves_no_partial_file(tmp_path):
    process = started(hung("time.sleep(60)"), tmp_path)
    assert process.stdout.readline() == "writing\n"
    process.terminate()
    process.communicate(timeout=30)
    assert process.returncode == 128 + signal.SIGTERM
    assert not list(tmp_path.iterdir())


@pytest.mark.heavy
def test_interruption_at_any_moment_exits_130_or_is_too_late(tmp_path):
    """From the first import on: four moments of a run."""
    command = ["run", "ch2-unicycle", "--no-figures", "--out", str(tmp_path / "out")]
    code = "from holdfast.__main__ import main; main()"
    begun = time.monotonic()
    whole = started(code, *command)
    whole.communicate(timeout=120)
    assert whole.returncode == 0
    taken = time.monotonic() - begun
    moments = random.Random(1)
    for share in (0.05, 0.3, 0.6, 0.9):
        process = started("print('begun', flush=True)\n" + code, *command)
        assert process.stdout.readline() == "begun\n"
        time.sleep(taken * share * moments.uniform(0.9, 1.1))
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        assert process.returncode in (130, 0), err
        assert "Traceback" not in err
        left = {f.name for f in (tmp_path / "out").iterdir()}
        assert left == {"result.nc", "summary.json"}


def test_left_over_files_of_killed_processes_are_removed_by_the_next(tmp_path):
    process = started(hung("time.sleep(60)"), tmp_path)
    assert process.stdout.readline() == "writing\n"
    (partial,) = tmp_path.iterdir()
    with atomic_file(tmp_path / "a.txt") as mine:
        mine.write_text("a")
        remove_left_over(tmp_path)
        assert sorted(tmp_path.iterdir()) == sorted([partial, mine])  # both writers are alive
    process.kill()
    process.communicate(timeout=30)
    assert partial.exists()
    with atomic_file(tmp_path / "b.txt") as mine:
        mine.write_text("b")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.txt", "b.txt"]


def test_what_other_machines_and_other_programs_write_stays(tmp_path):
    other = [".result.nc.by-elsewhere-4711-0123456789abcdef.partial", "mine.partial", ".a.partial"]
    for name in other:
        (tmp_path / name).write_text("")
    remove_left_over(tmp_path)
    assert sorted(f.name for f in tmp_path.iterdir()) == sorted(other)


def test_undisturbed_work_gives_its_answer_or_its_failure():
    assert undisturbed(lambda: None) is None
    with pytest.raises(ZeroDivisionError):
        undisturbed(lambda: 1 / 0)


def test_a_process_that_is_forked_during_work_can_work():
    """Its copy of a lock that a thread of the other has would stay taken for ever."""
    begun, done, ended = threading.Event(), threading.Event(), threading.Event()

    def work():
        begun.set()
        done.wait()
        ended.set()

    working = threading.Thread(target=undisturbed, args=(work,))
    working.start()
    begun.wait()
    threading.Timer(0.1, done.set).start()
    process = os.fork()
    if process == 0:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(20)  # kills a process that waits
        os._exit(undisturbed(lambda: 5))
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 5
    assert ended.is_set()
    working.join()
    assert undisturbed(lambda: 6) == 6


def test_processes_end_with_the_one_that_began_them(tmp_path):
    """Killed, so that it can end nothing itself."""
    code = """
import os, sys, time
from pathlib import Path
from holdfast.studies.process_pool import processes
if __name__ == "__main__":
    with processes(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        pool.submit(time.sleep, 300)
        time.sleep(300)
"""
    path = tmp_path / "begins.py"
    path.write_text(code)
    with subprocess.Popen([sys.executable, path], stdout=subprocess.PIPE, text=True) as process:
        other = int(process.stdout.readline())
        process.kill()
    for _ in range(300):
        try:
            os.kill(other, 0)
        except ProcessLookupError:
            break
        time.sleep(0.05)
    else:
        pytest.fail("it goes on")
