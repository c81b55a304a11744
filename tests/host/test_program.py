"""Programs as controllers: a line for every sample, and a message for everything that goes wrong."""

import sys
import time

import pytest

from holdfast.errors import SimulationError
from holdfast.host import program
from holdfast.host.program import Programs

ECHO = """
import json, sys
for line in sys.stdin:
    said = json.loads(line)
    print(json.dumps({"u": 2 * said["x"] + said["run"], "r": said["t"]}), flush=True)
"""


def written(folder, text):
    path = folder / "controller.py"
    path.write_text(text)
    return f"{sys.executable} {path}"


def test_every_run_has_a_process_that_answers_every_line(tmp_path):
    running = Programs(written(tmp_path, ECHO), ("x", "y"), ("u", "r"))
    running.begin(range(5, 8))
    try:
        for t in (0.0, 0.5):
            found = running.answers(t, [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], [True, False, True])
            assert found == [[2.0 + 5, t], [0.0, 0.0], [6.0 + 7, t]]
        processes = list(running._running)
    finally:
        running.end()
    assert [p.returncode for p in processes] == [0, 0, 0], "they end with their input"


def thrice(running):
    for _ in range(3):
        running.answers(0.0, [[1.0]], [True])
        time.sleep(0.15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "of run 0 (has ended|reads no more)"),
        ("import sys; sys.exit(3)", "with exit status 3"),
        ("for _ in range(9): input(); print('hello', flush=True)", r"answers 'hello'; expected a line such as \{\"u\": 0.0\}"),
        ("input(); print('{\"v\": 1}', flush=True); input()", "answers '{\"v\": 1}'"),
        ("input(); print('{\"u\": true}', flush=True); input()", "answers '{\"u\": true}'"),
        ("input(); print('{\"u\": null}', flush=True); input()", "answers"),
        ("input(); print('{\"u\": 1}\\n{\"u\": 1}', flush=True); input(); input()", "answers with more than one line"),
        ("input(); print('x' * 100000, flush=True); input()", "answers with more than 65536 characters"),
        ("input(); print('{\"u\": 1, \"t\": 3}', flush=True); input()", "answers"),
        ("input(); print('{\"u\": 1' + '0' * 400 + '}', flush=True); input()", "answers"),
        ("import time; input(); print('{\"u\": 1}', flush=True); time.sleep(0.1); print('{\"u\": 1}', flush=True); input(); input()", "answers with more than one line"),
        ("import time; input(); time.sleep(60)", "does not answer within 0.5 s"),
    ],
)  # fmt: skip
def test_what_a_program_does_wrong_is_named(tmp_path, monkeypatch, text, said):
    monkeypatch.setattr(program, "PATIENCE", 0.5)
    running = Programs(written(tmp_path, text), ("x",), ("u",))
    running.begin(range(1))
    try:
        with pytest.raises(SimulationError, match=said):
            thrice(running)
    finally:
        processes = list(running._running)
        running.end()
    assert all(p.poll() is not None for p in processes)


def test_numbers_that_are_not_finite_are_handed_on(tmp_path):
    running = Programs(
        written(tmp_path, "input(); print('{\"u\": NaN}', flush=True)"), ("x",), ("u",)
    )
    running.begin(range(1))
    ((number,),) = running.answers(0.0, [[1.0]], [True])
    running.end()
    assert number != number


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("", "the controller is empty"),
        ("python 'x", "is no command line"),
        ("nowhere-at-all x", "'nowhere-at-all' cannot be started"),
    ],
)
def test_command_lines_that_start_nothing_are_refused(line, said):
    with pytest.raises(SimulationError, match=said):
        Programs(line, ("x",), ("u",)).begin(range(1))
