"""One control sample at a time, with the arithmetic of `simulate`.

Of a compiled controller that is called so, and of a whole closed loop, for other simulators.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.simulation.blocks import NEVER, Blocks, Numbers
from holdfast.execution.simulation.built_loop import WIDTH
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import Outcome, Settings

_NONE = np.empty(0, dtype=np.int64)


class Controller(NamedTuple):
    """What a controller carries from one sample to the next; no memory: it begins."""

    memory: Array | None
    mode: int
    in_mode: float


class Sample(NamedTuple):
    """The input of a sample, with the unfiltered command and the slack of a safeguard; the end."""

    state: Array
    controller: Controller
    input: Array
    nominal: Array
    slack: float


class OneRun:
    """A closed loop that is advanced by one control sample at a time."""

    def __init__(self, loop: ClosedLoop, settings: Settings) -> None:
        loop.program.check_alone()
        self.program, self.sample_time = loop.program, settings.sample_time
        self.blocks = Blocks(*loop.loop(), loop.program, settings, runs=1)

    def sample(self, t: float, state: Array, before: Controller, p: Array) -> Sample:
        """One control sample as `simulate` computes it; `p` ends with the sample time [s]. state:
        shape (states,). p: shape (parameters + 1,)."""
        program, blocks, limited = self.program, self.blocks, self.program.limited
        none = np.empty((1, 0))
        numbers = Numbers(p, p, _NONE, _NONE, none, none, np.zeros((2, len(state))))
        blocks.rows("time")[:] = blocks.rows("seen_at")[:] = t
        blocks.rows("mode")[:], blocks.rows("since")[:] = before.mode, t - before.in_mode
        blocks.begin(state[np.newaxis], numbers, 0, 0)
        if before.memory is not None:
            blocks.rows("memory")[:] = before.memory[:, np.newaxis]
        blocks.sample()

        def row(name: str) -> Array:
            entries: Array = blocks.rows(name)[0, :, 0].copy()
            return entries

        mode, u = int(row("mode")[0]), row("actuation")[2 * limited :]
        nominal = row("nominal") if program.safeguarded else row("command")
        slack = float(row("slack")[0])
        stays = before.in_mode if mode == before.mode else 0.0
        controller = Controller(row("memory"), mode, stays + self.sample_time)
        return Sample(row("q"), controller, u, nominal, slack)


class Rows(NamedTuple):
    """Where the numbers of an answer are in one row.

    command: of the law, kept by its safeguard; nominal: before that. actuators: the limited values
    for the command; input: what these produce. outside: since when the state is outside the table.
    conditions: those of the safeguard, normals and offsets in turn, then the scales.
    """

    command: slice
    input: slice
    actuators: slice
    nominal: slice
    slack: int
    overruled: int
    mode: int
    outside: int
    value: int
    conditions: slice


class ControlSamples:
    """Controllers of one kind, each called at the samples of its own vehicle.

    count: how many of them. What each sees are the states, the disturbances that it measures, and
    what others hand it (`ClosedLoopProgram.handed`), in this order.
    """

    def __init__(self, program: ClosedLoopProgram, sample_time: float, count: int = 1) -> None:
        settings = Settings(horizon=sample_time, sample_time=sample_time, record_every=sample_time)
        loop = ClosedLoop(program)
        self.program, self.count = program, count
        self.blocks = Blocks(*loop.loop(), program, settings, count)
        self.width = len(program.states) + program.measured + len(program.handed)
        self._numbers = loop.parameter_array(None, sample_time)
        self._at, self._rows = self._places()
        functions = self.blocks.functions
        self._pointers = [
            (w.ctypes.data, s.ctypes.data, functions.addresses.ctypes.data, NEVER.ctypes.data)
            for w, s in zip(self.blocks.w, self.blocks.s, strict=True)
        ]
        self._seen = self.blocks.rows("seen")[:, : self.width]
        self._time = self.blocks.rows("time")
        self._off = self.blocks.rows("off_at")
        self._first, self._answer = functions.first, functions.answer
        self._memory = self.blocks.rows("memory")
        self._before = self._memory.copy()
        self._one = self.blocks.w[0], self._seen[0], self._time[0], self._pointers[0]
        self.begun = False
        self.reset()

    @property
    def rows(self) -> Rows:
        """Where the numbers of an answer are in a row of `answer`."""
        return self._rows

    def _places(self) -> tuple[np.ndarray, Rows]:
        """The places in w of the first lane of what is read, and where each is among them."""
        program, layout = self.program, self.blocks.layout
        m, limited = len(program.inputs), program.limited
        wanted = {
            "command": ("command", 0, m),
            "input": ("actuation", 2 * limited, m),
            "actuators": ("actuation", limited, limited),
            "nominal": ("nominal" if program.safeguarded else "command", 0, m),
            "slack": ("slack", 0, 1),
            "overruled": ("overruled", 0, 1),
            "mode": ("mode", 0, 1),
            "outside": ("off_at", 0, 1),
            "value": ("look", 0, 1),
            "conditions": ("answer", m, layout.counts["answer"] - m),
        }
        places: list[int] = []
        by_name: dict[str, slice | int] = {}
        for name, (of, first, count) in wanted.items():
            begins = layout.at[of] + first * WIDTH
            one = name in ("slack", "overruled", "mode", "outside", "value")
            by_name[name] = len(places) if one else slice(len(places), len(places) + count)
            places += [begins + i * WIDTH for i in range(count)]
        return np.array(places, dtype=np.intp), Rows(**by_name)  # type: ignore[arg-type]

    def reset(self) -> None:
        """Before the first sample: the first mode, and no memory."""
        blocks = self.blocks
        for name in ("plant", "gains"):
            rows = blocks.rows(name)
            rows[:, : len(self._numbers)] = self._numbers[:, np.newaxis]
        for name in ("switches", "recent", "slack", "overruled", "memory", "time"):
            blocks.rows(name)[:] = 0.0
        blocks.empty_rings()
        blocks.rows("mode")[:] = self.program.initial_mode
        lanes = np.arange(len(blocks.w) * WIDTH) < self.count
        blocks.rows("alive")[:, 0] = lanes.reshape(-1, WIDTH)
        self._off[:] = np.nan
        self.begun = False

    def now(self) -> tuple[Any, bool]:
        """What is carried from the last sample to the next, for `resume`."""
        return self.blocks.now(), self.begun

    def resume(self, earlier: tuple[Any, bool]) -> None:
        """Go on from there."""
        numbers, self.begun = earlier
        self.blocks.resume(numbers)

    def answer(self, t: float, seen: Array) -> Array:
        """The numbers (see `rows`) at a sample of the one controller, from what it sees. seen:
        shape (measured,). The numbers have the shape (numbers,)."""
        w, room, time, pointers = self._one
        room[:] = seen[:, np.newaxis]
        time[:] = t
        self.begin(t)
        if self.program.remembered:
            self._before = self._memory.copy()
        if self.blocks.fetching is None:
            self._answer(*pointers)
        else:
            self._answer_from_parts()
        numbers: Array = w.take(self._at)
        if not math.isnan(numbers[self._rows.outside]):
            self._inside_again()
        return numbers

    def answers(self, t: float, seen: Array) -> Array:
        """The numbers at a sample of every controller, from what each sees: rows of them. seen:
        shape (count, measured). The rows have the shape (count, numbers)."""
        for i in range(self.width):
            self.blocks.set_runs("seen", seen[:, i], i)
        self._time[:] = t
        self.begin(t)
        if self.blocks.fetching is None:
            for pointers in self._pointers:
                self._answer(*pointers)
        else:
            self._answer_from_parts()
        places = self._at[:, np.newaxis] + np.arange(WIDTH)
        numbers: Array = self.blocks.w[:, places].transpose(0, 2, 1).reshape(-1, len(self._at))
        self._inside_again()
        return numbers[: self.count]

    def _answer_from_parts(self) -> None:
        """Answer from a table of which what is read is fetched."""
        fetching = self.blocks.fetching
        assert fetching is not None
        before = self._memory.copy()
        try:
            fetching.begin()
            for pointers in self._pointers:
                self._answer(*pointers)
            fetching.end(len(self._pointers))
        except BaseException:
            self._memory[:] = before
            raise

    def forget(self) -> None:
        """Nothing is remembered of the last answer."""
        self._memory[:] = self._before

    @property
    def memory(self) -> Array:
        """What is remembered of every controller, in the order of the program: rows of it. The
        shape is (count, remembered)."""
        width = len(self.program.remembered)
        rows = [self.blocks.of_runs("memory", i) for i in range(width)]
        return np.stack(rows, axis=1) if rows else np.empty((self.count, 0))

    def remember_all(self, memory: Array) -> None:
        """Replace it: memory (count, remembered)."""
        for i in range(len(self.program.remembered)):
            self.blocks.set_runs("memory", memory[:, i], i)

    def nothing(self) -> Array:
        """The numbers where there is no answer, shape (numbers,)."""
        return np.full(len(self._at), math.nan)

    def begin(self, t: float) -> None:
        """Before the first answer: the memory from what is seen then."""
        if self.begun:
            return
        self.blocks.rows("since")[:] = t
        for pointers in self._pointers:
            self._first(*pointers)
        self.begun = True

    def _inside_again(self) -> None:
        """A controller that was outside its table goes on."""
        self._off[:] = np.nan
        self.blocks.rows("outcome")[:] = Outcome.STAYED


class PlantSamples:
    """A plant that is handed its command and its disturbances at every sample."""

    def __init__(self, program: ClosedLoopProgram, sample_time: float, substeps: int) -> None:
        settings = Settings(
            horizon=sample_time, sample_time=sample_time, record_every=sample_time,
            substeps=substeps,
        )  # fmt: skip
        loop = ClosedLoop(program)
        self.program = program
        self.blocks = Blocks(*loop.loop(), program, settings, runs=1)
        rows, n = self.blocks.rows, len(program.states)
        self._q, self._time, self._plant = rows("q")[0], rows("time")[0], rows("plant")[0]
        self._handed = rows("seen")[0][n + program.measured :][: len(program.handed)]
        behind = len(program.parameters)
        self._given = slice(behind, behind + len(program.given))
        numbers = loop.parameter_array(None, sample_time)
        for name in ("plant", "gains"):
            rows(name)[0][: len(numbers)] = numbers[:, np.newaxis]
        self._alive, self._outcome = rows("alive")[0, 0], rows("outcome")[0, 0]

    def after(self, t: float, state: Array, command: Array, disturbance: Array) -> Array:
        """The state after a sample with these held; NaN where it diverges. state: shape (states,),
        as what comes after. command: shape (inputs,). disturbance: shape (disturbances,)."""
        self._alive[0], self._outcome[:] = 1.0, Outcome.STAYED
        self._q[:], self._handed[:] = state[:, np.newaxis], command[:, np.newaxis]
        self._plant[self._given] = disturbance[:, np.newaxis]
        self._time[:] = self.blocks.rows("seen_at")[:] = t
        self.blocks.sample(first=True)
        if self._alive[0] == 0.0:
            return np.full(len(self._q), math.nan)
        reached: Array = self._q[:, 0].copy()
        return reached
