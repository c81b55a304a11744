"""Threads that carry out stages together: what they count, who sleeps, and interrupts at any time."""

import random
import signal
import threading
import time

import numpy as np
import pytest

from holdfast.execution.codegen.scalar_llvm import PACKED, scalars_text
from holdfast.execution.codegen.scalar_reader import read
from holdfast.execution.leaf import compiled_text
from holdfast.execution.level_set import stencils
from holdfast.execution.level_set.sweeping import Workers, address

TEXT = """
def work(
    taken: Wholes, slices: Wholes, slice_count: int, thread: int, counts: Floats, out: Floats,
    many: int,
):
    for k in range(slice_count):
        if take(taken[k:]) == 0:
            counts[0] += slices[k + 1] - slices[k]
    counts[1] = thread + 1
    counts[2] = 10 * thread
    for k in range(many):
        out[thread] = out[thread] * 0.5 + 1.0
"""


@pytest.fixture(scope="module")
def work():
    machine = compiled_text(scalars_text(read(TEXT), ["work"], packed=True), optimised=True)
    place = machine.address(f"{PACKED}work")
    yield place
    del machine  # which holds the code


def names():
    return [t.name for t in threading.enumerate() if t.name.startswith("holdfast-march")]


@pytest.mark.parametrize("threads", [1, 2, 3, 5])
def test_every_place_is_counted_once_in_every_stage(work, threads):
    out = np.zeros(threads)
    arguments = np.array([address(out), 100])
    with Workers(threads, 7) as workers:
        for places in (7, 100, 1, 8 * threads):
            workers.share(0, places)
            for _ in range(20):
                counts = workers.run(work, arguments)
                assert counts.tolist() == [places, sum(range(threads + 1)), 10 * (threads - 1)]
    assert names() == []
    assert out.tolist() == pytest.approx([2] * threads)


def test_threads_that_sleep_are_woken(work):
    out = np.zeros(3)
    arguments = np.array([address(out), 1])
    with Workers(3, 5) as workers:
        for wait in (0, 0.001, 0.05, 0.2):
            time.sleep(wait)
            assert workers.run(work, arguments).tolist() == [5, 6, 20]


def test_an_interrupt_at_any_time_ends_the_stage_and_every_thread(work):
    chance = random.Random(1)
    out = np.zeros(2)
    arguments = np.array([address(out), 30_000])
    interrupts = 0
    for _ in range(200):
        try:
            with Workers(2, 16) as workers:
                signal.setitimer(signal.ITIMER_REAL, chance.uniform(1e-5, 1e-3))
                for _ in range(100_000):
                    workers.run(work, arguments)
        except KeyboardInterrupt:
            interrupts += 1
        assert names() == []
    assert interrupts == 200


def test_an_interrupt_at_the_end_leaves_no_thread(work, monkeypatch):
    join = threading.Thread.join

    def joined(thread, timeout=None):
        if thread.name == "holdfast-march-1":
            raise KeyboardInterrupt
        join(thread, timeout)

    out = np.zeros(4)
    workers = Workers(4, 10).__enter__()
    workers.run(work, np.array([address(out), 1]))
    with monkeypatch.context() as inside:
        inside.setattr(threading.Thread, "join", joined)
        with pytest.raises(KeyboardInterrupt):
            workers.__exit__()
    deadline = time.monotonic() + 20
    while names() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert names() == []


@pytest.fixture(autouse=True)
def alarm_is_an_interrupt():
    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


def test_threads_that_were_started_end_when_another_is_not(monkeypatch, work):
    start = threading.Thread.start

    def started(thread):
        if thread.name == "holdfast-march-2":
            raise KeyboardInterrupt
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", started)
    with pytest.raises(KeyboardInterrupt), Workers(4, 10):
        pass
    assert names() == []


def test_a_thread_takes_its_own_slices_and_then_the_last_of_the_others(monkeypatch):
    def take(array):
        array[0] += 1
        return array[0] - 1

    monkeypatch.setattr(stencils, "take", take, raising=False)
    taken, tried = np.zeros(16, dtype=np.int64), np.zeros(1, dtype=np.int64)
    taken[[9, 14, 3]] = 1
    slices = [stencils.next_slice(taken, 16, 1, tried) for _ in range(14)]
    assert slices == [8, 10, 11, 12, 13, 15, 7, 6, 5, 4, 2, 1, 0, -1]
