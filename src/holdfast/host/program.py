"""Controllers that are programs: a process for each run, which reads states and writes commands.

A line of JSON for every sample goes to the standard input of the process:

    {"t": 0.02, "run": 0, "x": -1.5, "y": 0.1}

and one comes back from its standard output, with a number for every command, such as {"u": 0.3}.
A "t" in the answer has to be that of the line.
The process ends when its input does.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import shlex
import subprocess
import time
from collections.abc import Sequence

from holdfast.errors import SimulationError

PATIENCE = 10.0
"""Seconds for which the answer to a line is awaited."""

TOGETHER = 32
"""Processes at a time."""

LONGEST = 1 << 16
"""Characters of a line."""


class Programs:
    """The processes of several runs, started with `line`; each answers with `commands`."""

    def __init__(self, line: str, states: Sequence[str], commands: Sequence[str]) -> None:
        try:
            self.words = shlex.split(line)
        except ValueError as error:
            raise SimulationError(f"the controller {line!r} is no command line: {error}") from None
        if not self.words:
            raise SimulationError("the controller is empty", expected="a command line")
        self.states, self.commands = tuple(states), tuple(commands)
        self._running: list[subprocess.Popen[bytes]] = []
        self._said: list[bytes] = []  # what was read of each, behind its last line
        self._runs, self._failing, self._t = range(0), False, 0.0

    def begin(self, runs: range) -> None:
        """Start a process for each of these runs."""
        self._runs = runs
        try:
            for _ in runs:
                self._running.append(
                    subprocess.Popen(
                        self.words,
                        stdin=subprocess.PIPE,
                        stdout=subprocess.PIPE,
                        bufsize=0,
                        start_new_session=True,  # an interruption is ours, not its
                    )
                )
                self._said.append(b"")
        except OSError as error:
            self.end()
            raise SimulationError(
                f"the controller '{self.words[0]}' cannot be started ({error.strerror})"
            ) from None

    def answers(
        self, t: float, states: Sequence[Sequence[float]], alive: Sequence[bool]
    ) -> list[list[float]]:
        """The commands at a sample; zeros for runs that have ended."""
        self._t = t
        asked = [k for k, lives in enumerate(alive) if lives]
        for k in asked:
            said = {"t": t, "run": self._runs[k]}
            said |= dict(zip(self.states, states[k], strict=True))
            pipe = self._running[k].stdin
            assert pipe is not None
            if self._unread(k):
                raise self._failed(k, "answers with more than one line")
            try:
                pipe.write(json.dumps(said).encode() + b"\n")
            except OSError:
                raise self._failed(k, "has ended, or reads no more") from None
        commands = [[0.0] * len(self.commands) for _ in states]
        for k in asked:
            commands[k] = self._answer(k)
        return commands

    def end(self) -> None:
        """Close the input of every process, and end those that go on; at once after a failure."""
        for process in self._running if self._failing else ():
            process.kill()
        for process in self._running:
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError, ValueError):
                    if pipe is not None:
                        pipe.close()
        until = time.monotonic() + 1.0
        for process in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, until - time.monotonic()))
            if process.poll() is None:
                process.kill()
                process.wait()
        self._running.clear()
        self._said.clear()

    def _unread(self, k: int) -> bool:
        """Whether a process said something that nobody asked for."""
        pipe = self._running[k].stdout
        assert pipe is not None
        if select.select([pipe], [], [], 0.0)[0]:
            self._said[k] += os.read(pipe.fileno(), LONGEST)
        return bool(self._said[k])

    def _answer(self, k: int) -> list[float]:
        line = self._line(k)
        try:
            said = json.loads(line)
            if said.get("t", self._t) != self._t:
                raise ValueError
            return [_number(said[name]) for name in self.commands]
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
            shown = line if len(line) < 80 else f"{line[:77]}..."
            example = json.dumps(dict.fromkeys(self.commands, 0.0))
            raise self._failed(k, f"answers {shown!r}", f"a line such as {example}") from None

    def _line(self, k: int) -> str:
        """The next line of a process."""
        pipe = self._running[k].stdout
        assert pipe is not None
        until = time.monotonic() + PATIENCE
        while b"\n" not in self._said[k]:
            ready, _, _ = select.select([pipe], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                raise self._failed(
                    k, f"does not answer within {PATIENCE:g} s", "a line, flushed at once"
                )
            more = os.read(pipe.fileno(), LONGEST)
            if not more:
                raise self._failed(k, "has ended")
            self._said[k] += more
            if len(self._said[k]) > LONGEST:
                raise self._failed(k, f"answers with more than {LONGEST} characters")
        line, self._said[k] = self._said[k].split(b"\n", 1)
        return line.decode(errors="replace").strip()

    def _failed(self, k: int, what: str, expected: str = "") -> SimulationError:
        process, self._failing = self._running[k], True
        with contextlib.suppress(subprocess.TimeoutExpired):
            if process.wait(0.2):
                what += f", with exit status {process.returncode}"
        return SimulationError(
            f"the controller '{self.words[0]}' of run {self._runs[k]} {what}", expected=expected
        )


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError
    return float(value) if math.isfinite(value) else math.nan
