"""Kernels from the web: fetched on from where it stopped, and nothing else than what was published."""

import errno
import multiprocessing
import os
import threading

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis import kernel_store
from holdfast.analysis.kernel_store import INDEX, Store, entry_of
from holdfast.errors import OutputError
from tests.served_files import served

FIRST = 3000


@pytest.fixture
def web(tmp_path, monkeypatch, kernel):
    """A server of a published kernel, for a user with an empty store."""
    value, path = kernel
    folder = tmp_path / "web"
    Store(folder).add(path, entry_of(path, value, "cart", "CC0", "Doe 2026"))
    monkeypatch.setenv("HOLDFAST_STORE", str(tmp_path / "store"))
    with served(folder) as found:
        yield found


def is_loaded(web, kernel):
    return np.array_equal(hf.load(f"{web.address}#cart").values(), kernel[0].values())


def in_the_store():
    return sorted(p.suffix for p in Store().folder.iterdir() if p.name != ".lock")


def stopped(web, kernel):
    """A download of which the first bytes came."""
    web.cut = FIRST
    with pytest.raises(OutputError, match=f"ended after {FIRST:,} of .*goes on from there"):
        is_loaded(web, kernel)
    web.cut = None
    assert in_the_store() == [".part"]
    return next(Store().folder.glob(".*.part"))


def test_a_download_goes_on_where_it_stopped(web, kernel):
    stopped(web, kernel)
    assert is_loaded(web, kernel)
    assert web.kernels_asked() == [None, f"bytes={FIRST}-"]
    assert in_the_store() == [".json", ".nc"]
    assert Store().verify("cart").licence == "CC0"
    assert is_loaded(web, kernel)
    assert len(web.kernels_asked()) == 2


def test_where_the_server_gives_no_parts_the_download_begins_anew(web, kernel):
    stopped(web, kernel)
    web.ranges = False
    assert is_loaded(web, kernel)
    assert in_the_store() == [".json", ".nc"]


def test_a_beginning_that_is_of_another_file_is_not_kept(web, kernel):
    part = stopped(web, kernel)
    part.write_bytes(b"x" * FIRST)
    with pytest.raises(OutputError, match="has not the digest that its index gives"):
        is_loaded(web, kernel)
    assert in_the_store() == []
    assert is_loaded(web, kernel)


@pytest.mark.parametrize("more", [0, 1, 10_000_000], ids=["whole", "longer", "much longer"])
def test_a_beginning_that_is_whole_or_longer_ends_well(web, kernel, more):
    part = stopped(web, kernel)
    part.write_bytes(kernel[1].read_bytes() + bytes(more))
    assert is_loaded(web, kernel)
    assert web.kernels_asked() == ([None] if not more else [None, None])


def test_what_came_before_an_interruption_is_kept(web, kernel, monkeypatch):
    pieces, size = kernel_store.pieces, kernel[1].stat().st_size

    def interrupted(answer, most):
        if most != size:
            yield from pieces(answer, most)
            return
        yield answer.read(FIRST)
        raise KeyboardInterrupt

    with monkeypatch.context() as inside:
        inside.setattr(kernel_store, "pieces", interrupted)
        with pytest.raises(KeyboardInterrupt):
            is_loaded(web, kernel)
    assert in_the_store() == [".part"]
    assert is_loaded(web, kernel)
    assert web.kernels_asked()[-1] == f"bytes={FIRST}-"


def test_a_kernel_that_is_cut_or_gone_in_the_store_is_fetched_again(web, kernel):
    assert is_loaded(web, kernel)
    path = Store().path("cart")
    path.write_bytes(path.read_bytes()[:-9])
    assert is_loaded(web, kernel)
    path.unlink()
    assert is_loaded(web, kernel)
    assert list(Store().entries()) == ["cart"]
    assert web.kernels_asked() == [None] * 3


def test_a_server_that_says_nothing_is_given_up(web, kernel, monkeypatch):
    monkeypatch.setattr(kernel_store, "PATIENCE", 0.2)
    web.silent = threading.Event()
    with pytest.raises(OutputError, match=r"cannot be fetched \(timed out\)"):
        is_loaded(web, kernel)
    web.silent.set()


def test_a_redirect_is_followed_with_what_is_missing(web, kernel):
    part = stopped(web, kernel)
    name = Store(web.folder).entry("cart").file
    os.rename(web.folder / name, web.folder / "moved.nc")
    web.moved = {name: "/moved.nc"}
    assert part.exists()
    assert is_loaded(web, kernel)
    assert web.asked[-1] == ("moved.nc", f"bytes={FIRST}-")


def test_a_disk_without_room_is_found_before_and_while_it_is_written(web, kernel, monkeypatch):
    few = type("Usage", (), {"free": 1000})()
    with monkeypatch.context() as inside:
        inside.setattr(kernel_store.shutil, "disk_usage", lambda folder: few)
        with pytest.raises(OutputError, match="has room for"):
            is_loaded(web, kernel)

    def full(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as inside:
        inside.setattr(kernel_store.os, "fsync", full)
        with pytest.raises(OutputError, match=r"No space left .* with HOLDFAST_STORE"):
            is_loaded(web, kernel)
    assert is_loaded(web, kernel)


def _fetch(address, done):
    done.put(hf.load(f"{address}#cart").report.system)


@pytest.mark.heavy
def test_processes_that_fetch_the_same_kernel_at_once_fetch_it_once(web, kernel):
    context = multiprocessing.get_context("spawn")
    done = context.Queue()
    both = [context.Process(target=_fetch, args=(web.address, done)) for _ in range(2)]
    for process in both:
        process.start()
    assert [done.get(timeout=200) for _ in both] == ["cart", "cart"]
    for process in both:
        process.join(100)
    assert in_the_store() == [".json", ".nc"]
    assert web.kernels_asked() == [None]


def test_a_file_that_is_in_the_store_and_not_yet_in_its_index_is_not_fetched_again(
    web, kernel, monkeypatch
):
    write, found, others = Store._write, [], []

    def written_late(store, entries):
        other = threading.Thread(target=lambda: found.append(is_loaded(web, kernel)))
        others.append(other)
        other.start()
        other.join(1)  # time to find the new kernel nowhere
        write(store, entries)

    with monkeypatch.context() as inside:
        inside.setattr(Store, "_write", written_late)
        assert is_loaded(web, kernel)
    others[0].join(100)
    assert (found, len(others)) == ([True], 1)
    assert in_the_store() == [".json", ".nc"]
    assert web.kernels_asked() == [None]


def test_a_file_can_be_read_before_the_index_of_the_store_has_it(web, kernel, monkeypatch):
    write, values = Store._write, []

    def written_late(store, entries):
        (entry,) = entries.values()
        values.append(hf.load(store.folder / entry.file).values())
        write(store, entries)

    monkeypatch.setattr(Store, "_write", written_late)
    assert is_loaded(web, kernel)
    assert np.array_equal(values, [kernel[0].values()])


def test_an_index_that_is_endless_or_a_page_is_refused(web, kernel, monkeypatch):
    (web.folder / INDEX).write_text("<html>sign in</html>")
    with pytest.raises(OutputError, match="is no index of kernels"):
        is_loaded(web, kernel)
    monkeypatch.setattr("holdfast.analysis.kernel_store.MOST_INDEX", 5)
    with pytest.raises(OutputError, match="is too large"):
        is_loaded(web, kernel)
