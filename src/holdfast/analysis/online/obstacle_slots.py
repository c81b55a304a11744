"""What a filter is handed of obstacles that move: the nearest pairs of discs at a sample.

The pairs are found by compiled code (`execution/obstacle_pairs.py`), into memory that is made once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import sympy as sp

from holdfast.analysis.online.decision import Obstructs
from holdfast.arguments import Metres, MetresPerSecond
from holdfast.errors import DefinitionError, SimulationError, check_name
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.llvm_text import LANES
from holdfast.execution.codegen.lowering import leaf_of
from holdfast.execution.codegen.scalar_llvm import compiled
from holdfast.execution.leaf import compiled_leaves
from holdfast.execution.obstacle_pairs import PAIR, PART, RECORD
from holdfast.execution.simulation.closed_loop import Command, Commander, Function
from holdfast.maths.control.moving_obstacles import avoiding, both_ways
from holdfast.maths.control.parameter_box import ParameterBox
from holdfast.maths.definitions.extension import steady_bounds
from holdfast.maths.definitions.law import Law, Repeated, Safeguard
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.value import Value

Parts = tuple[tuple[tuple[tuple[float, float], ...], float], ...]
"""The convex parts of a hull: the corners (ahead, left) of each, and a radius around them [m]."""


class Paired(Protocol):
    """The kernel of our vehicle and another one: `pair_kernel.PairKernel`."""

    def check_ours(self, system: System, position: tuple[str, str]) -> None: ...

    def slots(
        self, clearing: Clearing, system: System, guard: Safeguard, program: ClosedLoopProgram,
        sample_time: float,
    ) -> ObstacleSlots: ...  # fmt: skip


@dataclass(frozen=True)
class Clearing(Value):
    """How a filter keeps clear of obstacles that `step` is given: `hf.Obstacles` has the words.

    speed [m/s]: of the fastest obstacle. evaded [m/s]: the speed of obstacles that turning evades.
    pair: the kernel of this vehicle and another one.
    """

    most: int
    parts: Parts = ((((0.0, 0.0),), 0.0),)
    lead: Metres | None = None
    speed: MetresPerSecond | None = None
    clearance: Metres = 0.0
    position: tuple[str, str] = ("x", "y")
    heading: str | None = None
    evaded: float = math.inf
    pair: Paired | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.most, int) and 1 <= self.most <= MOST):
            raise DefinitionError(f"{self.most!r} obstacles", expected=f"a number from 1 to {MOST}")

    @property
    def pairs(self) -> int:
        """The pairs of discs that are handed over: of an obstacle one for a corner of the hull,
        and one more for what the kernel of two vehicles asks."""
        corners = sum(len(corners) for corners, _ in self.parts)
        return self.most * (corners + (self.pair is not None))

    @property
    def around(self) -> float:
        """The radius of the hull about the position [m]."""
        if self.lead:
            return self.parts[0][1] - self.lead
        return max(math.hypot(*c) + radius for corners, radius in self.parts for c in corners)

    def of(self, system: System) -> Clearing:
        """The same with a heading, with the lead that a hull of one disc needs, and with what
        turning evades.

        Raises `DefinitionError` for names that are no states, and where no lead is at hand or the
        lead is too short for the speed.
        """
        names = system.state_names
        for name in (*self.position, *([self.heading] if self.heading else [])):
            check_name(name, names, DefinitionError, f"'{name}' is no state of '{system.name}'")
        heading = self.heading
        if heading is None:
            angles = [q.name for q in system.states if q.angle]
            heading = "psi" if "psi" in angles else angles[0] if angles else ""
        if self.pair is not None:
            self.pair.check_ours(system, self.position)
        parts, lead = self.parts, self.lead
        ((x, y), *more), radius = parts[0]
        if len(parts) == 1 and not more and (x, y) == (0.0, 0.0) and heading:
            if lead is None:
                lead = usual_lead(system, self.position, heading, self.speed)
            if lead:
                parts = ((((lead, 0.0),), radius + lead),)
        for corners, _ in parts:
            for ahead, left in corners:
                if not both_ways(system, self.position, heading, (ahead, left)):
                    raise DefinitionError(
                        f"the inputs of '{system.name}' move the point ({ahead:g}, {left:g}) "
                        "of the hull along one line alone",
                        expected="points that can be moved both ways, as those ahead of an axle",
                        remedy="give a lead, or corners that are not beside the axle",
                    )
        evaded = evaded_speed(system, self.position, heading, parts)
        if self.speed is not None and evaded <= self.speed:
            raise DefinitionError(
                f"obstacles of {self.speed:g} m/s are faster than the {evaded:.3g} m/s at which "
                f"turning moves the hull of '{system.name}' aside",
                remedy="a longer lead" if lead is not None else "",
            )
        return Clearing(
            self.most, parts, lead, self.speed, self.clearance, self.position, heading, evaded,
            self.pair,
        )  # fmt: skip

    def law(
        self,
        system: System,
        law: Law,
        *,
        gains: tuple[float, float] | None,
        disturbance_measured: bool,
        worst: Sequence[str],
        box: ParameterBox,
        scales: Mapping[str, float],
        sample_time: float,
    ) -> Law:
        """`law` with the filter, which is handed the numbers of the pairs."""
        return avoiding(
            system, law, self.pairs, self.position, self.heading or "", hull_numbers(self),
            len(self.parts), self.clearance, gains=gains,
            disturbance_measured=disturbance_measured, worst=worst, box=box, scales=scales,
            sample_time=sample_time, rows_handed=self.pair is not None,
        )  # fmt: skip

    def slots(
        self, system: System, law: Law, program: ClosedLoopProgram, sample_time: float
    ) -> ObstacleSlots:
        """The places of the pairs of a filter's law, which the program carries out."""
        assert law.safeguard is not None
        each = law.safeguard.repeated
        assert each is not None
        if self.pair is None:
            return ObstacleSlots(system, each)
        return self.pair.slots(self, system, law.safeguard, program, sample_time)


MOST = 1000
"""Obstacles at a time."""


def evaded_speed(system: System, position: tuple[str, str], heading: str, parts: Parts) -> float:
    """The speed at which turning moves the least movable corner of a hull aside [m/s].

    Infinite where the inputs move the position both ways without a turn, or where no bound of the
    rate of turn is at hand.
    """
    if not heading or both_ways(system, position, heading, (0.0, 0.0)):
        return math.inf
    try:
        turn = _most(system, sp.sympify(system.rates[heading]))
    except DefinitionError:
        turn = 0.0
    least = min(abs(ahead) for corners, _ in parts for ahead, _ in corners)
    return least * turn if turn > 0 else math.inf


def usual_lead(
    system: System, position: tuple[str, str], heading: str, obstacles: float | None
) -> float:
    """How far ahead the point is that keeps clear: 0 where the inputs move the axis both ways.

    Else it is 1.25 times the speed of the `obstacles` over the largest rate of turn, or without
    that speed the largest of the vehicle over it, so that turning alone evades what comes from
    abeam.
    """
    if both_ways(system, position, heading, (0.0, 0.0)):
        return 0.0
    ahead = {s.symbol: sp.S.Zero for s in system.states if s.name == heading}
    try:
        turn = _most(system, sp.sympify(system.rates[heading]))
        speed = 1.25 * obstacles if obstacles else 0.0
        speed = speed or _most(system, sp.sympify(system.rates[position[0]]).xreplace(ahead))
    except DefinitionError:
        speed = turn = 0.0
    if not (speed > 0.0 and turn > 0.0):
        raise DefinitionError(
            f"the speed and the rate of turn of '{system.name}' have no bounds at hand",
            remedy="give a lead [m]: hf.Obstacles(20, lead=...), above the speed of the obstacles "
            "over the largest rate of turn",
        )
    return speed / turn


def _most(system: System, rate: sp.Expr) -> float:
    """The largest value of a rate that inputs set, or a state that inputs hold, in still water."""
    values = {p.symbol: sp.Float(p.value) for p in system.parameters}
    still = {q.symbol: sp.S.Zero for q in system.disturbances}
    rate = rate.xreplace(still)
    inputs = [q.symbol for q in system.inputs]
    states = {q.symbol: q.name for q in system.states if rate.diff(q.symbol) != 0}
    if rate.free_symbols & set(inputs):
        if system.input_bounds is None:
            return 0.0
        rest = dict.fromkeys(states, sp.S.Zero)
        weights = [rate.diff(u).xreplace(rest) for u in inputs]
        return float(system.input_bounds.support(weights, 1)[0].xreplace(values))
    most = 0.0
    for state, name in states.items():
        slope = rate.diff(state).xreplace(dict.fromkeys(states, sp.S.Zero) | values)
        if slope.is_number and slope != 0:
            most += abs(float(slope)) * float(steady_bounds(system, (name,)).upper[0])
    return most


class ObstacleSlots:
    """The places of the pairs of a safeguard, which are filled at every sample."""

    def __init__(self, system: System, each: Repeated, most: int | None = None) -> None:
        """most: how many of the places are filled with pairs of discs; by default all."""
        of, self._most = each.found, each.count if most is None else most
        leaf = leaf_of({"q": [q.symbol for q in system.states]}, of.pose)
        self._leaves = compiled_leaves({"pose": leaf})
        self._pose_of: Callable[..., None] = self._leaves.function("pose")
        self._find = compiled("obstacle_pairs", "find_pairs")
        self._hull = np.array(of.hull)
        self._states = np.zeros((len(system.states), LANES))
        poses, touch = np.zeros((len(of.pose), LANES)), np.zeros(6)
        self._room = poses, touch
        self.pairs, self.near = np.zeros(each.count * PAIR), np.zeros(2 * each.count)
        self._how = self._most, of.clearance, of.first
        self._at: Any = tuple(
            a.ctypes.data for a in (self._states, poses, self._hull, self.pairs, self.near, touch)
        )
        self._parts = of.parts

    unkept: tuple[int, ...] = ()
    """The bodies that the kernel of two vehicles does not keep clear of at the last sample."""

    def fill(
        self,
        state: Array,
        obstacles: Sequence[Obstructs] | Array,
        command: Array | None = None,
    ) -> int:
        """Fill the pairs at a state; how many there are, or -1 - k for a faulty body k. state:
        shape (states,). command: shape (inputs,), of which kernels of two vehicles are asked.
        obstacles: or discs, as of `disc_records`."""
        if isinstance(obstacles, np.ndarray):
            return self.fill_from(state, disc_records(obstacles))
        try:
            records = b"".join([o.records for o in obstacles])
        except (TypeError, AttributeError):
            raise SimulationError(
                f"the obstacles are {obstacles!r}"[:80], expected="a list of hf.Obstacle"
            ) from None
        return self.fill_from(state, records)

    def fill_from(self, state: Array, records: bytes) -> int:
        """`fill`, from records of obstacles. state: shape (states,)."""
        states, poses, hull, pairs, near, touch = self._at
        self._states[:] = state[: len(self._states), np.newaxis]  # not what actuators add
        self._pose_of(states, poses, LANES, LANES)
        count: int = self._find(
            hull, self._parts, poses, LANES, records, len(records) // 8, *self._how, pairs, near,
            touch,
        )  # fmt: skip
        return count


DISC = ("x", "y", "radius", "vx", "vy", "acceleration", "share", "age", "velocity_error")
"""The columns of discs, of which the first three are always there."""


def disc_records(discs: Array) -> bytes:
    """Discs as records; discs: shape (count, 3 to 9), the columns `DISC`."""
    count, width = discs.shape if discs.ndim == 2 else (0, 0)
    if not 3 <= width <= len(DISC) or discs.dtype.kind not in "fiu":
        raise SimulationError(
            f"the obstacles are an array of the shape {discs.shape}",
            expected=f"(count, 3 to {len(DISC)}): {', '.join(DISC)}",
        )
    rows = np.zeros((count, RECORD + 2))
    rows[:, 0], rows[:, 5] = 1.0, 1.0
    rows[:, _DISC_PLACES[:width]] = discs
    return rows.tobytes()


_DISC_PLACES = [8, 9, 1, 2, 3, 4, 5, 6, 7]

Surroundings = Callable[[float, Array], Sequence[Sequence[Obstructs]] | Array]
"""A function of t [s] and of the states (run, state) to the obstacles of every run, or to discs of
the shape (runs, count, columns)."""


class Among:
    """A controller among obstacles, for `simulate`: the command, and the pairs of every run.

    least: the smallest gap of every run [m], of all bodies that have been near, where no input met
    all conditions too. Where a number of an obstacle is not finite, the command is NaN. unkept:
    at how many samples of every run the kernel of two vehicles was not kept.
    """

    def __init__(
        self, slots: ObstacleSlots, command: Command | Commander, obstacles: Surroundings
    ) -> None:
        self.slots, self.obstacles = slots, obstacles
        for what, function in (("command", command), ("obstacles", obstacles)):
            if not callable(function) and not (what == "command" and hasattr(command, "most")):
                raise SimulationError(
                    f"{what} is {function!r}"[:80], expected="a function of t and the states"
                )
        self.of_command: Commander = Function(command) if callable(command) else command
        self.most = self.of_command.most
        self.least, self.unkept = np.empty(0), np.empty(0, dtype=np.int64)

    def begin(self, runs: range) -> None:
        self.of_command.begin(runs)
        self.least = np.full(len(runs), math.inf)
        self.unkept = np.zeros(len(runs), dtype=np.int64)

    def command(self, t: float, states: Array, alive: Truths) -> Array:
        """The commands and the numbers of the pairs, a row for each run. states: shape (runs,
        states). alive: shape (runs,). The rows have the shape (runs, handed)."""
        slots = self.slots
        commands = np.asarray(self.of_command.command(t, states, alive), dtype=np.float64)
        around = self.obstacles(t, states)
        if len(around) != len(states):
            raise SimulationError(
                f"obstacles of {len(around)} runs", expected=f"a list for each of {len(states)}"
            )
        if commands.ndim != 2 or len(commands) != len(states):
            raise SimulationError(
                f"the controller commands an array of the shape {commands.shape}",
                expected=f"({len(states)}, inputs)",
            )
        rows = np.empty((len(states), commands.shape[1] + len(slots.pairs)))
        rows[:, : commands.shape[1]] = commands
        for k in np.flatnonzero(alive).tolist():
            if slots.fill(states[k], around[k], commands[k]) < 0:
                rows[k, : commands.shape[1]] = math.nan
            rows[k, commands.shape[1] :] = slots.pairs
            self.unkept[k] += bool(slots.unkept)
            self.least[k] = min(self.least[k], slots.near[::2].min())
        rows[~alive] = 0.0
        return rows

    def end(self) -> None:
        self.of_command.end()


def check_pose(clearing: Clearing, measured: Sequence[str]) -> None:
    """Refuse a filter that does not measure where the vehicle is."""
    wanted = (*clearing.position, *([clearing.heading] if clearing.heading else []))
    if missing := [name for name in wanted if name not in measured]:
        raise DefinitionError(
            f"'{missing[0]}' is not measured, and obstacles are kept clear of by it",
            expected=f"states={', '.join(wanted)} and others",
        )


def hull_numbers(clearing: Clearing) -> list[float]:
    """The hull in the layout of `execution/obstacle_pairs.py`."""
    numbers: list[float] = []
    for corners, radius in clearing.parts:
        numbers += [float(len(corners)), radius, *(x for corner in corners for x in corner)]
    assert len(numbers) == sum(PART + 2 * len(corners) for corners, _ in clearing.parts)
    return numbers
