"""A certificate whose search is interrupted or killed goes on, and is the same to the last bit."""

import errno
import os
import subprocess
import sys

import pytest

import holdfast as hf
from holdfast.analysis.certificates import images
from holdfast.errors import CacheWarning, OutputError
from holdfast.execution.intervals.held_flow import HeldFlow
from tests.certified_systems import CART, cart, vehicle

KILLED = """
import os, signal, sys
from holdfast.analysis.certificates import images
from tests.analysis.certificates import test_stored_images as case

images.BLOCK, images.EVERY = case.BLOCK, 0.0

def tell(what, share):
    if share > 0.4:
        os.kill(os.getpid(), signal.SIGKILL)

case.certified(sys.argv[1], store=sys.argv[2], progress=tell)
"""
BLOCK = 200


def certified(kind, **more):
    if kind == "keep":
        return hf.certify(*cart(), box=CART, cells=41, sample_time=0.2, steps=1, **more)
    system, room, goal = vehicle()
    return hf.certify(
        system, room, target=goal, box={"x": (0, 3), "y": (0, 2), "psi": (-3, 3)},
        cells={"x": 15, "y": 10, "psi": 8}, sample_time=0.4, inputs=3, steps=1, **more,
    )  # fmt: skip


@pytest.fixture
def counted(monkeypatch):
    """How many blocks are found, of many small ones."""
    calls = []
    own = HeldFlow.held

    def held(self, low, high, inputs, most=None):
        calls.append(len(low))
        return own(self, low, high, inputs, most)

    monkeypatch.setattr(HeldFlow, "held", held)
    monkeypatch.setattr(images, "BLOCK", BLOCK)
    return calls


def left_in(folder):
    return sorted(p.name for p in folder.glob("certificate.images*"))


def test_search_that_is_killed_goes_on_and_its_certificate_has_the_same_bytes(counted, tmp_path):
    whole = certified("keep").write(tmp_path / "whole.holdfast").read_bytes()
    every = len(counted)
    folder = tmp_path / "run"
    folder.mkdir()
    done = subprocess.run([sys.executable, "-c", KILLED, "keep", str(folder)], capture_output=True)
    assert done.returncode == -9, done.stderr
    assert len(left_in(folder)) == 1
    counted.clear()
    found = certified("keep", store=folder)
    assert 0 < len(counted) < 0.7 * every
    assert left_in(folder)
    assert found.write(folder / "part.holdfast").read_bytes() == whole
    assert left_in(folder) == []


@pytest.mark.few("keep")
@pytest.mark.parametrize("kind", ["keep", "reach"])
def test_search_that_is_interrupted_keeps_what_is_done(kind, counted, tmp_path):
    def tell(what, share):
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certified(kind, store=tmp_path, progress=tell)
    counted.clear()
    shares = []
    found = certified(kind, store=tmp_path, progress=lambda what, share: shares.append(share))
    assert 0.5 < shares[1] < 0.7  # behind the first, which only says what is to be done
    assert found.header() == certified(kind).header()
    counted.clear()
    again = certified(kind, store=tmp_path)
    assert not counted
    assert (again.kept.entries == found.kept.entries).all()


def test_another_problem_begins_anew_and_says_so(counted, tmp_path):
    certified("keep", store=tmp_path)
    first = left_in(tmp_path)
    with pytest.warns(CacheWarning, match="of another problem or version: this one begins anew"):
        found = certified("keep", store=tmp_path, delay=0.02)
    assert len(left_in(tmp_path)) == 1
    assert left_in(tmp_path) != first
    assert found.header() == certified("keep", delay=0.02).header()


def test_folder_without_room_is_refused_before_the_work(counted, tmp_path, monkeypatch):
    def full(*given):
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OutputError, match="'none' is no folder"):
        certified("keep", store="none")
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
        certified("keep", store=tmp_path)
    assert not counted
    assert left_in(tmp_path) == []


def test_file_that_was_cut_is_begun_anew(counted, tmp_path):
    certified("keep", store=tmp_path)
    (name,) = left_in(tmp_path)
    os.truncate(tmp_path / name, 100)
    counted.clear()
    found = certified("keep", store=tmp_path)
    assert counted
    assert found.header() == certified("keep").header()
