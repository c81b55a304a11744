"""The kernel of two vehicles as an obstacle's condition: it keeps all that can be kept.

V > 0 where our vehicle keeps its distance from another one for ever, whatever that one does
(`relative_system`). At a sample the filter of this kernel alone answers a command w with the least
change u that keeps it, by the sampled game (`analysis/safety/sampled_value.py`). Among several
vehicles and other obstacles that answer becomes a row of the inputs,

    (w - u) . (v - u) <= 0     in units of the scales, for the input v

whose nearest point to w is u. So for one vehicle alone the input is that answer. Where others
change it as well, each kernel is asked again at the input that meets all rows, and adds a row,
until each agrees: an input that is given as admissible has been looked up in every kernel. Where
some kernel does not agree the decision is INFEASIBLE, and names the vehicle.

Beyond the `reach` no condition is needed: a vehicle from outside passes a ring in which W is above
the level that is kept, and there the kernel takes over.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import sympy as sp

from holdfast.analysis.online.decision import Obstructs
from holdfast.analysis.online.obstacle_slots import Clearing, ObstacleSlots
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.problem import definition
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.safety_filter import decided, lookup_of, usual_pace
from holdfast.analysis.safety.sampled_value import moves_of, points_of, sampled_value
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, PromiseFellShortWarning, SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram, closed_loop_program
from holdfast.execution.leaf import Evaluator
from holdfast.execution.obstacle_pairs import FAR, PAIR
from holdfast.execution.simulation.control_sample import ControlSamples
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.control.moving_obstacles import ROW_ITSELF
from holdfast.maths.control.value_filter import keep_sampled_value
from holdfast.maths.control.velocity_tracking import commanded
from holdfast.maths.definitions.bounds import Ball, Bounds, Product
from holdfast.maths.definitions.compose_systems import OTHER, relative_system
from holdfast.maths.definitions.law import Safeguard
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.value import Value

ROUNDS = 6
"""How often each kernel is asked at a sample."""
AGREED = 1e-6  # of the scales, by which an answer may differ from what it was asked of
APART = 1.05  # of the largest speed at which two vehicles near each other
DIRECTIONS = 64  # in which the largest speed of a vehicle is sought
NODES = 2000  # at which that speed is computed


@checked
@dataclass(frozen=True)
class PairKernel(Value):
    """The kernel of our vehicle and another one, for `Obstacles(pair=...)`.

    ours, theirs: the vehicles. value: a kernel of `relative_system` of them, of a region that keeps
    them apart, in m. position, heading, common: as of `relative_system`. relative: that system.

    What the filter promises: as long as each other vehicle is one that `theirs` describes, and W
    of each is above its level, each alone is kept clear of. Several may pinch, and the decision
    says so.

    Raises `DefinitionError` where the other vehicle catches ours from everywhere, with the reason,
    where it does so from the edge of the grid, and for a kernel that has not converged;
    `SimulationError` for a value function of another system.

    >>> slow = hf.systems.unicycle(0.5)
    >>> both = hf.relative_system(robot, slow)
    >>> near = hf.Inequality("near", "0.5 - sqrt(x_r**2 + y_r**2)", "m")
    >>> apart = hf.Region("apart", both.states[:2], (near,))
    >>> box = {"x_r": (-2, 2), "y_r": (-2, 2), "psi_r": (-np.pi, np.pi)}
    >>> nodes = hf.grid(both, box, 13, {"x_r": "extrapolated", "y_r": "extrapolated"})
    >>> value = hf.discriminating_kernel(both, apart, nodes, 20.0)
    >>> round(hf.PairKernel(robot, slow, value).distance, 3)
    0.5
    """

    ours: System
    theirs: System
    value: ValueFunction
    position: tuple[str, str] = ("x", "y")
    heading: str | None = None
    common: tuple[str, ...] = ()
    relative: System = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        relative = relative_system(
            self.ours, self.theirs, position=self.position, heading=self.heading,
            common=self.common,
        )  # fmt: skip
        object.__setattr__(self, "relative", relative)
        decided(relative, self.value)
        report = self.value.report
        if report.kind not in ("viability-kernel", "discriminating-kernel"):
            raise DefinitionError(
                f"the value function is a {report.kind}", expected="a kernel of the two vehicles"
            )
        if report.value_unit != "m":
            raise DefinitionError(
                f"the kernel keeps a region in the unit '{report.value_unit}'",
                expected="a distance in m between the vehicles, without a scale",
            )
        table = self.value.in_memory().values()
        if report.empty or not self.value.highest() > 0:
            raise DefinitionError(
                f"'{self.theirs.name}' catches '{self.ours.name}' from every place of the grid"
                f"{self._faster()}",
                expected="another vehicle that can be evaded",
            )
        cell = report.cell or 0.0
        for axis, of in enumerate(self.value.grid.axes[:2]):
            for place, node in ((of.low, 0), (of.high, -1)):
                least = float(np.take(table, node, axis).min())
                if least <= cell:
                    raise DefinitionError(
                        f"'{self.theirs.name}' catches '{self.ours.name}' from the edge of the "
                        f"grid, from {of.name} = {place:g} m{self._faster()}",
                        expected="a kernel that contains every place at the edges",
                        remedy="" if self._faster() else "take a wider grid",
                    )
        if not report.converged:
            raise DefinitionError(
                f"the kernel of '{self.ours.name}' and '{self.theirs.name}' still shrinks after "
                f"{report.reached_s:.3g} s",
                expected="one that has converged",
                remedy="take a longer horizon",
            )

    def check_ours(self, system: System, position: tuple[str, str]) -> None:
        """Refuse it for another vehicle than ours, or for another point of it."""
        numbers = [{q.name: float(q.value) for q in s.parameters} for s in (system, self.ours)]
        same = definition(system) == definition(self.ours) and numbers[0] == numbers[1]
        if not same or position != self.position:
            raise DefinitionError(
                f"the kernel of two vehicles is one of '{self.ours.name}', not of the vehicle "
                f"'{system.name}' that is filtered",
                expected="the same rates, bounds, parameters and position",
            )

    def slots(
        self, clearing: Clearing, system: System, guard: Safeguard, program: ClosedLoopProgram,
        sample_time: float,
    ) -> VehicleSlots:  # fmt: skip
        """The places of a filter that keeps it beside other obstacles."""
        return VehicleSlots(self, clearing, system, guard, program, sample_time)

    @cached_property
    def distance(self) -> float:
        """The distance that is kept [m]: V is at most what is left of it."""
        ahead, left = np.meshgrid(
            *(a.nodes for a in self.value.grid.axes[:2]), indexing="ij", sparse=True
        )
        highest = self.value.in_memory().values()
        further = tuple(range(2, highest.ndim))
        return float((np.hypot(ahead, left) - highest.max(axis=further)).min())

    def _faster(self) -> str:
        """That the other one is faster, where both speeds are at hand."""
        ours, theirs = (
            largest_speed(self.ours, self.position),
            largest_speed(self.theirs, self.position),
        )
        if math.isnan(ours) or math.isnan(theirs) or theirs <= ours:
            return ""
        return f": it is faster, {theirs:.3g} m/s against {ours:.3g} m/s"

    # -- where the vehicles are

    @cached_property
    def indices(self) -> tuple[list[int], int, list[int], bool]:
        """Of our states those of the place, the heading (-1: none) and the others; whether the
        other vehicle has a heading."""
        names = list(self.ours.state_names)
        place = [names.index(n) for n in self.position]
        seen = self.relative.state_names[2:]
        further = [names.index(n) for n in seen if n in names]
        theirs = [n for n in seen if n.startswith(OTHER)]
        turned = len(seen) > len(further) + len(theirs)
        heading = next((k for k in range(len(names)) if k not in (*place, *further)), -1)
        return place, heading, further, turned

    def seen(self, state: Array, other: Sequence[float]) -> Array:
        """The relative state, shape (relative states,). state: of ours, shape (states,). other: x,
        y, the heading and the further states.

        Raises `SimulationError` for another number of further states.
        """
        (i, j), heading, further, turned = self.indices
        angle = float(state[heading]) if heading >= 0 else 0.0
        dx, dy = other[0] - float(state[i]), other[1] - float(state[j])
        cos, sin = math.cos(angle), math.sin(angle)
        row = [cos * dx + sin * dy, cos * dy - sin * dx]
        if turned:
            row.append(other[2] - angle)
        row += [float(state[k]) for k in further]
        row += other[3:]
        if len(row) != len(self.relative.states):
            more = len(self.relative.states) - len(row) + len(other) - 3
            raise SimulationError(
                f"another vehicle has {len(other) - 3} further states",
                expected=f"{max(more, 0)}, as '{self.theirs.name}' of the kernel",
            )
        return np.array(row)


def largest_speed(system: System, position: tuple[str, str]) -> float:
    """The largest speed of a vehicle whose inputs are velocities [m/s]; NaN for any other."""
    if system.input_bounds is None:
        return math.nan
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    bounds = system.input_bounds.at(numbers)
    still = numbers | {q.symbol: sp.S.Zero for q in (*system.states, *system.disturbances)}
    rates = [system.rates[n].xreplace(still) for n in position]
    inputs = [q.symbol for q in system.inputs]
    gains = [[rate.diff(u) for u in inputs] for rate in rates]
    drift = [rate.xreplace(dict.fromkeys(inputs, sp.S.Zero)) for rate in rates]
    if not all(e.is_number for e in (*drift, *gains[0], *gains[1])):
        return math.nan
    most = 0.0
    for k in range(DIRECTIONS):
        cos, sin = math.cos(2 * math.pi * k / DIRECTIONS), math.sin(2 * math.pi * k / DIRECTIONS)
        along = [float(cos * a + sin * b) for a, b in zip(*gains, strict=True)]
        moved = float(cos * drift[0] + sin * drift[1])
        most = max(most, moved + bounds.support_value(along))
    return most or math.nan


class Answer(NamedTuple):
    """Of the kernel of one vehicle: the input nearest to the one it was asked of, whether that is
    another one, and whether it falls short of the level, or is outside the grid."""

    input: Array
    changed: bool
    short: bool
    outside: bool


class Keeper:
    """The filter of a kernel of two vehicles alone, with inputs that are held.

    Beyond the grid the value counts as at its edge, which is above the level that is kept.
    """

    def __init__(self, kernel: PairKernel, sample_time: float, scales: Array) -> None:
        """scales: shape (inputs,)."""
        relative, grid = kernel.relative, kernel.value.grid
        axes = tuple(replace(a, ends="limited") if k < 2 else a for k, a in enumerate(grid.axes))
        value = replace(kernel.value, grid=Grid(axes), games={})
        self.scales = scales
        model = replace(relative, disturbance_bounds=_around(relative.disturbance_bounds))
        game = sampled_value(model, value, sample_time)
        if game is None:
            raise DefinitionError(
                "the game of the two vehicles with held inputs takes too long",
                expected="fewer nodes, or fewer inputs of both",
            )
        if not game.stays:
            warnings.warn(
                f"the kernel of two vehicles is not kept in trial runs with inputs that are held "
                f"for {sample_time:g} s",
                PromiseFellShortWarning,
                stacklevel=7,
            )
        self.level = level = game.possible_margin(sample_time, 0.0)
        law = keep_sampled_value(
            model, commanded(relative), game.lookup(lookup_of(value), sample_time),
            points=game.points, disturbances=game.moves, errors=game.errors, beyond=game.beyond,
            rate=usual_pace(sample_time), margin=level,
            scales=dict(zip(relative.input_names, scales.tolist(), strict=True)),
        )  # fmt: skip
        program = closed_loop_program(
            model, law, region=None, goal=None, disturbance={}, stepper=RK4
        )
        self._samples = ControlSamples(program, sample_time)
        nearing = APART * _nearing(relative, value)
        least = min(min(-a.low, a.high) for a in grid.axes[:2])
        self.reach = least - nearing * sample_time
        self.speed = nearing
        ahead, left = np.meshgrid(*(a.nodes for a in grid.axes[:2]), indexing="ij", sparse=True)
        cell = math.hypot(*(a.step for a in grid.axes[:2]))
        ring = np.hypot(ahead, left) >= self.reach - nearing * sample_time - cell
        if not float(game.table.reshape(grid.shape)[ring].min()) > level:
            raise DefinitionError(
                f"what held inputs keep of the kernel does not reach a ring {self.reach:.3g} m "
                "around the vehicle",
                expected="one from which every place at the edge of the grid is kept",
                remedy="take a wider or a finer grid, or a shorter sample time",
            )

    def keeps(self, seen: Array) -> bool:
        """Whether the distance is kept from a relative state on: W is above the level. seen: shape
        (relative states,)."""
        none = np.zeros(len(self.scales))
        numbers = self._samples.answer(0.0, np.concatenate([seen, none]))
        return bool(numbers[self._samples.rows.value] >= self.level)

    def answer(self, seen: Array, wanted: Array) -> Answer:
        """What it answers at a relative state. seen: shape (relative states,). wanted: shape
        (inputs,)."""
        numbers = self._samples.answer(0.0, np.concatenate([seen, wanted]))
        rows = self._samples.rows
        near = numbers[rows.command]
        changed = bool((np.abs(near - wanted) > AGREED * self.scales).any())
        outside = not math.isnan(numbers[rows.outside]) or not np.isfinite(near).all()
        return Answer(near, changed, bool(numbers[rows.slack] > 0.0), outside)


def _around(bounds: Bounds | None) -> Bounds | None:
    """Bounds of disturbances of which discs are larger: `moves_of` takes eight points of their
    rims, and what is between these counts too."""
    if isinstance(bounds, Product):
        parts = (_around(part) for part in bounds.parts)
        return Product(tuple(part for part in parts if part is not None))
    if isinstance(bounds, Ball) and bounds.dimension == 2:
        return replace(bounds, radius=bounds.radius / math.cos(math.pi / 8))
    return bounds


def _nearing(relative: System, value: ValueFunction) -> float:
    """The largest speed at which two vehicles near each other, at the nodes [m/s]."""
    x, y = (q.symbol for q in relative.states[:2])
    rates = [relative.rates[q.name] for q in relative.states[:2]]
    toward = sp.expand(x * rates[0] + y * rates[1]) / sp.sqrt(x**2 + y**2)
    acting = [*relative.inputs, *relative.disturbances]
    speed = Evaluator(
        [toward], [q.symbol for q in (*relative.states, *acting)], relative.parameters
    )
    numbers = {q.symbol: sp.Float(float(q.value)) for q in relative.parameters}
    assert relative.input_bounds is not None
    does = [
        [float(sp.sympify(e).xreplace(numbers)) for e in (*u, *d)]
        for u in points_of(relative.input_bounds, len(relative.inputs))
        for d in moves_of(relative.disturbance_bounds, len(relative.disturbances))
    ]
    generator = np.random.default_rng(0)
    axes = value.grid.axes
    nodes = [a.nodes[generator.integers(0, a.count, NODES)] for a in axes]
    states = np.stack(nodes, axis=1)
    states = states[np.hypot(states[:, 0], states[:, 1]) > 0]
    return max(
        float(np.abs(speed.values(np.hstack([states, np.tile(d, (len(states), 1))]))).max())
        for d in does
    )


class Vehicle(NamedTuple):
    """Another vehicle at a sample: its relative state, its places, what it answers the command."""

    seen: Array
    places: list[int]
    first: Answer


class VehicleSlots(ObstacleSlots):
    """The places of pairs of discs, some of which rows of kernels of two vehicles take."""

    def __init__(
        self,
        kernel: PairKernel,
        clearing: Clearing,
        system: System,
        guard: Safeguard,
        program: ClosedLoopProgram,
        sample_time: float,
    ) -> None:
        assert guard.repeated is not None
        super().__init__(system, guard.repeated, clearing.pairs - clearing.most)
        self.kernel, self._around = kernel, clearing.around + clearing.clearance
        values = {q.symbol: sp.Float(float(q.value)) for q in system.parameters}
        self._scales = np.array(
            [float(guard.scales[n].xreplace(values)) for n in system.input_names]
        )
        self.keeper = Keeper(kernel, sample_time, self._scales)
        self._samples = ControlSamples(program, sample_time)
        self._extra = clearing.pairs - clearing.most, clearing.pairs

    def fill(
        self,
        state: Array,
        obstacles: Sequence[Obstructs] | Array,
        command: Array | None = None,
    ) -> int:
        """As of `ObstacleSlots`, with the rows of the vehicles. state: shape (states,). command:
        shape (inputs,)."""
        assert command is not None
        self.unkept = ()
        first, last = self._extra
        self.pairs[first * PAIR :] = np.tile(self._nothing(state), last - first)
        self.near[2 * first :: 2], self.near[2 * first + 1 :: 2] = math.inf, -1.0
        count = super().fill(state, obstacles, command)
        if count < 0 or isinstance(obstacles, np.ndarray):
            return count
        vehicles: dict[int, Vehicle] = {}
        places = self.near[1 : 2 * first : 2].astype(int).tolist()
        number = 0
        for obstacle in obstacles:
            if obstacle.state and not obstacle.age and number in places:
                if not all(map(math.isfinite, obstacle.state)):
                    return -1 - number
                self._check_distance(obstacle)
                taken = [k for k, n in enumerate(places) if n == number]
                seen = self.kernel.seen(state, obstacle.state)
                apart = math.hypot(seen[0], seen[1])
                beyond = apart >= self.keeper.reach
                answer = None if beyond else self.keeper.answer(seen, command)
                if answer is None or not answer.outside:
                    for k in taken:
                        self.pairs[k * PAIR : (k + 1) * PAIR] = self._nothing(state)
                        self.near[2 * k] = apart - self._around - obstacle.radius
                if answer is not None and not answer.outside:
                    vehicles[number] = Vehicle(seen, taken, answer)
            number += obstacle.count
        if vehicles:
            self._agree(state, command, vehicles)
        return count

    def _agree(self, state: Array, command: Array, vehicles: dict[int, Vehicle]) -> None:
        """Add rows until each kernel agrees with the input that meets all of them."""
        spare = list(range(*self._extra))
        rows = self._samples.rows
        wanted = command
        for turn in range(ROUNDS):
            short, cuts = [], 0
            for number, vehicle in vehicles.items():
                answer = self.keeper.answer(vehicle.seen, wanted) if turn else vehicle.first
                if answer.short:
                    short.append(number)
                if not answer.changed:
                    continue
                cuts += 1
                room = vehicle.places if vehicle.places else spare
                if room and turn < ROUNDS - 1:
                    self._cut(room.pop(0), number, wanted, answer.input)
                else:
                    short.append(number)
            self.unkept = tuple(dict.fromkeys(short))
            if (turn and not cuts) or turn == ROUNDS - 1:
                return
            row = np.concatenate([state, command, self.pairs])
            before, wanted = wanted, self._samples.answer(0.0, row)[rows.command]
            if not np.isfinite(wanted).all() or (not cuts and (before == wanted).all()):
                return

    def _cut(self, place: int, number: int, wanted: Array, near: Array) -> None:
        """The row of the inputs that is as far from `wanted` as its nearest admissible one.

        wanted, near: shape (inputs,). Its normal has the size of the speed at which the vehicles
        near each other, so that it gives way in m/s as other conditions do.
        """
        across = (wanted - near) / self._scales
        normal = self.keeper.speed * across / float(np.linalg.norm(across)) / self._scales
        row = self.pairs[place * PAIR : (place + 1) * PAIR]
        row[:] = 0.0
        m = len(normal)
        row[0], row[1 : 1 + m], row[1 + m] = ROW_ITSELF, normal, float(normal @ near)
        if place >= self._extra[0]:
            gaps = self.near[: 2 * self._extra[0]]
            self.near[2 * place] = gaps[::2][gaps[1::2] == number].min()
            self.near[2 * place + 1] = number

    def _nothing(self, state: Array) -> Array:
        """The numbers of a pair that is not there, shape (PAIR,). state: shape (states,)."""
        row = np.zeros(PAIR)
        i, j = self.kernel.indices[0]
        row[3], row[4], row[10] = state[i] + FAR, state[j], 1.0
        return row

    def _check_distance(self, obstacle: Obstructs) -> None:
        wide = self._around + obstacle.radius
        if wide > self.kernel.distance * (1 + 1e-9):
            raise SimulationError(
                f"the hull and the vehicle '{obstacle.name}' touch at {wide:.3g} m",
                expected=f"at most the {self.kernel.distance:.3g} m that the kernel keeps",
            )
