"""The cache of compiled code: what is damaged heals, and what others could write is never run."""

import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

from holdfast.errors import CacheWarning, OutputError
from holdfast.execution import cache
from holdfast.execution import compile as compilation

ANSWER = [2.0, 6.0]
TEXT = """@within(forceinline=True)
def function(x):
    return x * x + x


@compiled
def evaluate(points, out):
    for i in range(len(points)):
        out[i] = function(points[i])
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(place))
    return place


def anew():
    """What a new process finds: (values, whether they are those of code from the cache)."""
    kept = {name: module for name, module in sys.modules.items() if name.startswith("functions_")}
    for name in kept:
        del sys.modules[name]
    try:
        text = f"{compilation._import('primitives')}\n\n{TEXT}"
        module, out = compilation._module("functions", text), np.zeros(2)
        module.evaluate(np.array([1.0, 2.0]), out)
        stats = module.evaluate.stats
        assert sum(stats.cache_hits.values()) + sum(stats.cache_misses.values()) == 1
        return out.tolist(), bool(stats.cache_hits)
    finally:
        sys.modules.update(kept)


def files(folder, ending):
    return sorted(folder.glob(f"functions_*{ending}"))


DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "one bit": lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
    "other": lambda data: b"raise SystemExit('run by the cache')\n",
}


@pytest.mark.parametrize("ending", [".py", ".code"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_file_of_the_cache_is_replaced_and_never_run(folder, ending, damage):
    assert anew() == (ANSWER, False)
    assert anew() == (ANSWER, True)
    good = {path: path.read_bytes() for path in files(folder, ending)}
    assert good
    for path, data in good.items():
        path.write_bytes(DAMAGES[damage](data))
    assert anew() == (ANSWER, ending == ".py")
    if ending == ".py":
        assert {path: path.read_bytes() for path in good} == good
    assert anew() == (ANSWER, True)


def test_code_of_another_function_under_its_name_is_not_run(folder):
    anew()
    one, other = (path for path in files(folder, ".code"))
    one.write_bytes(other.read_bytes())
    assert anew()[0] == ANSWER


def test_cache_is_for_its_user_alone(folder):
    anew()
    assert folder.stat().st_mode & 0o077 == 0
    assert all(path.stat().st_mode & 0o077 == 0 for path in folder.iterdir())


def test_file_that_others_may_write_to_is_compiled_again(folder):
    anew()
    for path in files(folder, ".code"):
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
    assert "others may write" in cache.distrust(folder / "mine")
    folder.chmod(0o1777)
    assert cache.distrust(folder / "mine") == ""


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives away")
def test_folder_and_file_of_another_user_are_not_used(folder):
    anew()
    for path in files(folder, ".code"):
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
        place = cache.cache_directory()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache.cache_directory() == place  # said once
    assert place.stat().st_mode & 0o077 == 0
    assert anew()[0] == ANSWER
    assert list(folder.iterdir()) == []


@pytest.mark.skipif(hasattr(os, "geteuid") and os.geteuid() == 0, reason="root writes anywhere")
def test_read_only_user_cache_is_replaced(folder, monkeypatch):
    monkeypatch.delenv("HOLDFAST_CACHE_DIR")
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(folder))
    folder.mkdir()
    folder.chmod(0o500)
    assert cache.cache_directory() != folder


def test_link_to_itself_is_no_cache_folder(folder):
    folder.symlink_to(folder)
    with pytest.raises(OutputError, match="cannot be written"):
        cache.cache_directory()


THREADS = """
import threading
import holdfast as hf
from holdfast.execution import compile
robot = hf.systems.unicycle()
law = hf.laws.steer_unicycle(robot)
begin, found = threading.Barrier(6), []

def run():
    begin.wait()
    result = hf.simulate(robot, law, starts=[[1.0, 0.5, 0.0]], horizon=1.0)
    found.append(float(result.dataset["state"][0, -1, 0]))

# a module takes long to be executed: the others come meanwhile
executed = compile._executed
def slowly(name, text):
    import time
    time.sleep(0.2)
    return executed(name, text)
compile._executed = slowly

threads = [threading.Thread(target=run) for _ in range(6)]
for thread in threads: thread.start()
for thread in threads: thread.join()
assert len(found) == 6 and len(set(found)) == 1, found
"""


def test_several_threads_that_simulate_first_in_a_process_agree(folder):
    answer = subprocess.run(
        [sys.executable, "-c", THREADS], capture_output=True, text=True, timeout=120
    )
    assert answer.returncode == 0, answer.stderr
    assert not answer.stderr
