"""Lines of a stream as they come."""

import contextlib
import os
import threading

import pytest

from holdfast.host.streams import LONGEST, lines


@pytest.fixture
def pipe():
    ends = os.pipe()
    yield ends
    for end in ends:
        with contextlib.suppress(OSError):
            os.close(end)


def test_lines_come_whole_however_they_are_cut(pipe):
    read, write = pipe
    found = lines(read, 0.01)
    os.write(write, b"one\ntw")
    assert next(found) == b"one"
    assert next(found) is None
    os.write(write, b"o\n\nthree")
    assert next(found) == b"two"
    assert next(found) == b""
    os.close(write)
    assert list(found) == [b"three"]


def test_line_that_is_too_long_is_given_in_part_and_those_after_it_whole(pipe):
    read, write = pipe
    text = b"x" * LONGEST + b"y" * LONGEST + b"\nnext\n"

    def feed():
        for k in range(0, len(text), 1000):
            os.write(write, text[k : k + 1000])
        os.close(write)

    feeder = threading.Thread(target=feed)
    feeder.start()
    assert list(lines(read)) == [b"x" * LONGEST, b"next"]
    feeder.join()


def test_stream_that_ends_at_once_has_no_lines(pipe):
    read, write = pipe
    os.close(write)
    assert list(lines(read, 0.01)) == []
