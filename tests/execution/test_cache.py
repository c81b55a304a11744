"""The cache of compiled code: what is damaged heals, and what others could write is never run."""

import gc
import os
import subprocess
import sys
import warnings
import weakref

import numpy as np
import pytest

from holdfast.errors import CacheWarning, OutputError
from holdfast.execution import leaf
from holdfast.host.files import cache_directory, distrust

ANSWER = 4.0
TEXTS = [
    f"define void @f(ptr %out) {{\n  store double {value}, ptr %out, align 8\n  ret void\n}}\n"
    for value in (ANSWER, 8.0)
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(place))
    return place


def anew(text=TEXTS[0]):
    """What a new process finds: (the value, whether it is that of code from the cache)."""
    leaf._machines.clear()
    out, compiled = np.zeros(1), []

    def parse(given, parse=leaf.llvm.parse_assembly):
        compiled.append(given)
        return parse(given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(leaf.llvm, "parse_assembly", parse)
        leaf.compiled_text(text).function("f", 1)(out.ctypes.data)
    return float(out[0]), not any(compiled)


def files(folder):
    return sorted(folder.glob("leaf-*.code"))


@pytest.mark.heavy
def test_a_function_holds_its_machine_code(folder):
    """Else it would lead to memory that is no longer its own."""
    function, out = leaf.compiled_text(TEXTS[0]).function("f", 1), np.zeros(1)
    machine = weakref.ref(function.machine)
    leaf._machines.clear()
    gc.collect()
    assert machine() is not None
    function(out.ctypes.data)
    assert out == ANSWER
    del function
    gc.collect()
    assert machine() is None


DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "one bit": lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
    "other": lambda data: b"raise SystemExit('run by the cache')\n",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_file_of_the_cache_is_replaced_and_never_run(folder, damage):
    assert anew() == (ANSWER, False)
    assert anew() == (ANSWER, True)
    (path,) = files(folder)
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert anew() == (ANSWER, False)
    assert anew() == (ANSWER, True)


def test_code_of_another_function_under_its_name_is_not_run(folder):
    anew(TEXTS[1])
    (other,) = files(folder)
    data = other.read_bytes()
    other.unlink()
    anew()
    (one,) = files(folder)
    one.write_bytes(data)
    assert anew() == (ANSWER, False)


def test_cache_is_for_its_user_alone(folder):
    anew()
    assert folder.stat().st_mode & 0o077 == 0
    assert all(path.stat().st_mode & 0o077 == 0 for path in folder.iterdir())


def test_file_that_others_may_write_to_is_compiled_again(folder):
    anew()
    for path in files(folder):
        path.chmod(0o666)
    assert anew() == (ANSWER, False)
    assert anew() == (ANSWER, True)


@pytest.mark.parametrize("mode", [0o777, 0o1777])
def test_folder_that_others_may_write_to_is_refused_where_it_was_asked_for(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(OutputError, match=r"is not used: others may write to .*chmod go-w"):
        anew()
    assert list(folder.iterdir()) == []


def test_folder_below_one_that_others_may_write_to_is_refused(folder):
    """They could put another in its place; not so where each has his own, as in /tmp."""
    folder.mkdir()
    (folder / "mine").mkdir()
    folder.chmod(0o777)
    assert "others may write" in distrust(folder / "mine")
    folder.chmod(0o1777)
    assert distrust(folder / "mine") == ""


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives away")
def test_folder_and_file_of_another_user_are_not_used(folder):
    anew()
    for path in files(folder):
        os.chown(path, 12345, -1)
    assert anew() == (ANSWER, False)
    os.chown(folder, 12345, -1)
    with pytest.raises(OutputError, match="belongs to another user"):
        anew()


def test_shared_user_cache_is_replaced_with_a_warning(folder, monkeypatch):
    monkeypatch.delenv("HOLDFAST_CACHE_DIR")
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(folder))
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.warns(CacheWarning, match="every run compiles anew"):
        place = cache_directory()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache_directory() == place  # said once
    assert place.stat().st_mode & 0o077 == 0
    assert anew()[0] == ANSWER
    assert list(folder.iterdir()) == []


@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="root writes anywhere")
def test_read_only_user_cache_is_replaced(folder, monkeypatch):
    monkeypatch.delenv("HOLDFAST_CACHE_DIR")
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(folder))
    folder.mkdir()
    folder.chmod(0o500)
    assert cache_directory() != folder


def test_link_to_itself_is_no_cache_folder_and_no_error(folder):
    folder.symlink_to(folder)
    with pytest.warns(CacheWarning, match="cannot be written .*; every run compiles anew"):
        assert cache_directory() != folder


THREADS = """
import threading
import holdfast as hf
from holdfast.execution import leaf
robot = hf.systems.unicycle()
law = hf.laws.steer_unicycle(robot)
begin, found = threading.Barrier(6), []

def run():
    begin.wait()
    result = hf.simulate(robot, law, starts=[[1.0, 0.5, 0.0]], horizon=1.0)
    found.append(float(result.dataset["state"][0, -1, 0]))

# code takes long to be compiled: the others come meanwhile
object_code = leaf._object_code
def slowly(*given):
    import time
    time.sleep(0.2)
    return object_code(*given)
leaf._object_code = slowly

threads = [threading.Thread(target=run) for _ in range(6)]
for thread in threads: thread.start()
for thread in threads: thread.join()
assert len(found) == 6 and len(set(found)) == 1, found
"""


@pytest.mark.heavy
def test_several_threads_that_simulate_first_in_a_process_agree(folder):
    answer = subprocess.run(
        [sys.executable, "-c", THREADS], capture_output=True, text=True, timeout=120
    )
    assert answer.returncode == 0, answer.stderr
    assert not answer.stderr
