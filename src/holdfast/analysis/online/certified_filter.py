"""A filter by proof: a command passes if, held, it surely leads back into certified cells.

A law or a function behind it is the controller of many runs.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import sympy as sp

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.certified_law import (
    Proof,
    certified_system,
    check_fits,
    check_usable,
)
from holdfast.analysis.online.controller import Given, Remade, numbers, time_of
from holdfast.analysis.online.decision import Decision, Decisions, Status
from holdfast.arguments import checked
from holdfast.errors import ArgumentError, DefinitionError, SimulationError, check_name
from holdfast.execution.arrays import Array, Truths, Wholes
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import Alive, Command
from holdfast.execution.simulation.control_sample import ControlSamples, Rows
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System


class Filtered:
    """What `simulate` asks for the commands of runs: those of a controller, filtered.

    counts: how many samples of all runs have had each `Status`.
    """

    most = sys.maxsize

    def __init__(self, keep: CertifiedFilter, controller: Law | Switching | Command) -> None:
        self.keep, self.counts = keep, Counter[Status]()
        self._law = controller if isinstance(controller, Law | Switching) else None
        self._wished: Callable[[float, Array], Array]
        if not isinstance(controller, Law | Switching):
            if not callable(controller):
                raise ArgumentError(
                    f"around: controller is {controller!r:.60}", expected="a law or a function"
                )
            self._wished = controller
        self._sample = 0

    def begin(self, runs: range) -> None:
        """Before the first sample of these runs."""
        self._sample = 0
        if self._law is None:
            return
        program = closed_loop_program(
            self.keep.system, self._law, region=None, goal=None, disturbance={}, stepper=RK4
        )
        if program.measured or program.handed:
            raise SimulationError(
                f"law '{self._law.name}' reads more than the states", expected="one of the states"
            )
        samples = ControlSamples(program, self.keep.sample_time, len(runs))
        self._wished = lambda t, q: samples.answers(t, q)[:, samples.rows.command]

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        """The filtered command of every run, at the states that are measured. states: shape (runs,
        states). alive: shape (runs,). The commands have the shape (runs, inputs)."""
        due = self._sample * self.keep.sample_time
        if not abs(t - due) <= 1e-6 * self.keep.sample_time * (1 + self._sample):
            raise SimulationError(
                f"sample {self._sample} is at {t:g} s, and the filter has samples of "
                f"{self.keep.sample_time:g} s",
                expected=f"sample_time={self.keep.sample_time:g}",
            )
        self._sample += 1
        seen = states[:, : len(self.keep.system.states)]
        decisions = self.keep.step_many(seen, self._wished(t, seen.copy()))
        self.counts.update(np.array(decisions.status)[alive].tolist())
        return decisions.input

    def end(self) -> None:
        """After the last sample."""


MOST_TOGETHER = 1 << 16
"""Inputs at states that are enclosed at a time."""


class CertifiedFilter(Remade):
    """The least change of a command that a certificate allows, sample by sample.

        u = w,  if from x the input w, held for T, surely leads to certified cells and keeps the
                region on the way, whatever the disturbances; else the nearest u_k that does

    w is the command of your own controller, within the bounds of the inputs; u_k are the inputs
    that were tried for the certificate. With a delay the certificate counts what is still under way
    within the range of those: a command beyond it is limited to it, and the input before the first
    sample has to be within it. The enclosures are those of `certify`, from the measured state
    itself. For a horizon an input has to lead to cells that are kept for as long as the
    input of the certificate would keep the state. With a target it has to lead to cells that are
    closer to it by one T, so that the state arrives whatever passes; from the target, to any.

    certificate: found, or read from its file. system: the vehicle, see `certified_law`; by default
    `certified_system(certificate)`. scales: input -> the change of it that counts as 1, by default
    a half of the range that was tried. fallback: the input where a measurement or the command is
    not finite, by default 0 within the bounds.

    A loop calls it every T (`sample_time`). From a state in no certified cell an input that surely
    leads to one counts too; where there is none the status is OUTSIDE_GRID, the input is that of
    the nearest cell, and nothing is promised. `Decision.value` is for how long the state is kept
    [s], infinite for ever and 0 where nothing is promised; with a target it is when the state is
    there at the latest, 0 at the target.

    Raises `DefinitionError` for a certificate without a cell, for another system, and for one whose
    inputs have no bounds, or bounds that an uncertain number changes.

    >>> hf.CertifiedFilter(certificate, cart).step([0.0, 0.4], [1.0])
    <Decision at 0 s: changed, input [0.0]>
    """

    @checked
    def __init__(
        self,
        certificate: Certificate,
        system: System | None = None,
        *,
        scales: Mapping[str, float] | None = None,
        fallback: Sequence[float] | None = None,
    ) -> None:
        check_usable(certificate)
        if system is not None:
            check_fits(certificate, system)
        self.system = certified_system(certificate) if system is None else system
        self.certificate, self.sample_time = certificate, certificate.hold
        _check_bounds(certificate, self.system)
        self._proof = Proof(certificate)
        cells = "the target or cells that lead to it" if certificate.target else "certified cells"
        self._cells = cells
        self._scales = _scales(certificate, scales or {})
        inputs = [q.symbol for q in self.system.inputs]
        limited = self.system.limited(self.system.allocated(inputs))
        produced = self.system.produced(limited)
        self._limits = Evaluator([*produced, *limited], inputs, self.system.parameters)
        under_way = certificate.candidates if certificate.sampling.delay > 0 else None
        self._counted = (
            None if under_way is None else (under_way.min(axis=0), under_way.max(axis=0))
        )
        self._fallback = self._checked_fallback(fallback)
        m, acts = len(inputs), len(limited)
        self._rows = Rows(
            command=slice(0, m), input=slice(0, m), actuators=slice(m, m + acts),
            nominal=slice(m + acts, 2 * m + acts), slack=-4, overruled=-3, mode=-4, outside=-2,
            value=-1, conditions=slice(0, 0),
        )  # fmt: skip
        self._count = 0

    @property
    def measured_states(self) -> tuple[str, ...]:
        """The states that `step` is given."""
        return self.system.state_names

    @property
    def measured_disturbances(self) -> tuple[str, ...]:
        """The disturbances that `step` is given: none."""
        return ()

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """The names of `Decision.actuators`."""
        return self.system.actuators or self.system.input_names

    @property
    def fallback(self) -> Array:
        """The input where a measurement or the command is not finite, shape (inputs,)."""
        return self._fallback.copy()

    # -- at a sample -------------------------------------------------------------------------

    def step(
        self,
        state: Given,
        command: Given,
        t: float | None = None,
        disturbance: Given | None = None,
    ) -> Decision:
        """The decision on a command [units of the inputs] at a measured state.

        state, command: numbers in the order of their names, or by name. t [s]: by default the
        number of samples since `reset` times the sample time; the answer does not depend on it. A
        disturbance is not measured: it is any within its bounds.
        Raises `SimulationError` for wrong names or shapes; numbers that are not finite are a
        status.
        """
        if disturbance is not None:
            raise SimulationError("a disturbance is given, and the filter measures none")
        seen = numbers(state, self.system.state_names, "state")
        wanted = numbers(command, self.system.input_names, "command")
        t = time_of(t, self._count, self.sample_time)
        self._count += 1
        rows, codes = self._answers(seen[np.newaxis], wanted[np.newaxis])
        overruled = bool(rows[0, self._rows.overruled])
        row = np.concatenate([seen, wanted])
        return Decision(rows[0], self._rows, _STATUSES[codes[0]], overruled, t, row, self)

    def step_many(self, states: npt.ArrayLike, commands: npt.ArrayLike) -> Decisions:
        """The decisions on many commands at many states, shapes (count, states), (count, inputs).

        Each is that of `step`.
        """
        seen = _table(states, len(self.system.states), "states")
        wanted = _table(commands, len(self.system.inputs), "commands")
        if len(seen) != len(wanted):
            raise SimulationError(f"{len(seen)} states and {len(wanted)} commands")
        answers, codes = self._answers(seen, wanted)
        rows = self._rows
        return Decisions(
            answers[:, rows.input], answers[:, rows.actuators], answers[:, rows.nominal],
            answers[:, rows.overruled] != 0.0, answers[:, rows.slack], answers[:, rows.value],
            tuple(_STATUSES[k] for k in codes.tolist()),
        )  # fmt: skip

    def around(self, controller: Law | Switching | Command) -> Filtered:
        """The filtered commands of a controller, for `simulate(system, commanded(system), ...)`.

        controller: a law of this system, or a function of t [s] and the states (runs, states) to
        commands (runs, inputs). The result is the argument `command`; its `counts` are how many
        samples had each status, since a run does not end where nothing is promised.
        """
        return Filtered(self, controller)

    def reset(self) -> None:
        """Begin anew: the time is 0."""
        self._count = 0

    def _now(self) -> Any:
        return self._count

    def _resume(self, earlier: Any) -> None:
        self._count = earlier

    def prepare(self) -> None:
        """All is compiled already."""

    def _answers(self, seen: Array, wanted: Array) -> tuple[Array, Wholes]:
        """The rows of the decisions, and the numbers of their statuses."""
        m, proof = wanted.shape[1], self._proof
        finite: Truths = np.asarray(np.isfinite(np.hstack([seen, wanted])).all(axis=1))
        x, w = np.where(finite[:, None], seen, 0.0), np.where(finite[:, None], wanted, 0.0)
        chosen, counted = self._within(w)
        seconds, stored = proof.looked_up(x)
        proved = seconds > 0
        sure = proved if proved.all() else proved | proof.inside(x)
        needed = proof.needed(seconds)
        passes = sure & counted & proof.leads(x, chosen, needed)
        held = passes | proved
        rest = np.flatnonzero(~passes)
        many = max(1, MOST_TOGETHER // len(proof.candidates))
        for begin in range(0, len(rest), many):
            k = rest[begin : begin + many]
            chosen[k], exists = self._nearest(
                x[k], chosen[k], needed[k], stored[k], proved[k], sure[k]
            )
            held[k] |= exists
        lasts = np.where(
            proved, seconds, (needed + 1) * self.sample_time if proof.lasts else math.inf
        )
        lasts[seconds == 0] = 0.0
        chosen[~finite] = self._fallback
        rows = np.zeros((len(x), 2 * m + self._limits.count - m + 4))
        rows[:, : self._limits.count] = self._limits.values(chosen)
        rows[:, self._rows.input] = chosen
        rows[:, self._rows.nominal] = wanted
        rows[:, self._rows.overruled] = ~passes | ~finite
        rows[:, self._rows.outside] = ~held
        rows[:, self._rows.value] = np.where(finite, np.where(held, lasts, 0.0), math.nan)
        changed = (chosen != wanted).any(axis=1)
        return rows, np.select([~finite, ~held, changed], [4, 3, 1], default=0)

    def _within(self, wanted: Array) -> tuple[Array, Truths]:
        """The commands within the bounds and within what may be under way, and where that is so."""
        m = wanted.shape[1]
        limited = np.ascontiguousarray(self._limits.values(wanted)[:, :m])
        if self._counted is None:
            return limited, np.ones(len(wanted), dtype=bool)
        counted = np.clip(limited, *self._counted)
        bounded = np.ascontiguousarray(self._limits.values(counted)[:, :m])
        return bounded, (np.clip(bounded, *self._counted) == bounded).all(axis=1)

    def _nearest(
        self, x: Array, wanted: Array, needed: Wholes, stored: Array, proved: Truths, sure: Truths
    ) -> tuple[Array, Truths]:
        """The nearest inputs that were tried and surely lead so far, and where there is one.

        A cell that is proved is certified as a whole, so that its own input does; of another cell
        it is that of the nearest one, where no input does.
        """
        tried, count = self._proof.candidates, len(x)
        most = len(tried)
        fine = self._proof.leads(
            np.repeat(x, most, axis=0), np.tile(tried, (count, 1)), np.repeat(needed, most)
        ).reshape(count, most)
        fine &= sure[:, None]
        fine |= proved[:, None] & (tried == stored[:, None]).all(axis=2)
        far = (((tried - wanted[:, None]) / self._scales) ** 2).sum(axis=2)
        nearest = tried[np.where(fine, far, math.inf).argmin(axis=1)]
        exists: Truths = np.asarray(fine.any(axis=1))
        return np.where(exists[:, None], nearest, stored), exists

    # -- what is said of a decision ----------------------------------------------------------

    def value_at(self, decision: Decision) -> float:
        """`Decision.value`."""
        return decision.looked_up

    def reason(self, decision: Decision) -> str:
        """`Decision.why`."""
        hold, status = f"held for {self.sample_time:g} s", decision.status
        if status is Status.NOT_A_NUMBER:
            names = (*self.system.state_names, *self.system.input_names)
            faulty = ", ".join(
                f"{n} is {v}"
                for n, v in zip(names, decision.seen, strict=True)
                if not math.isfinite(v)
            )
            return f"{faulty}, so that the input is the fallback"
        if status is Status.OUTSIDE_GRID:
            return (
                "the state is in no certified cell that leads on, and no input that was tried "
                f"surely leads to {self._cells}: nothing is promised"
            )
        if not decision.overruled:
            surely = f"{hold}, surely leads to {self._cells}"
            if status is Status.PASSED:
                return f"the command, {surely}"
            tried = " or the range of those that were tried" if self._counted else ""
            return (
                f"the command is beyond the bounds of the inputs{tried}; within them it, {surely}"
            )
        closer = "cells that are closer to the target" if self.certificate.target else self._cells
        return f"the command, {hold}, need not lead to {closer}; the nearest input does"

    def gave_way(self, decision: Decision) -> tuple[str, ...]:
        """`Decision.gave_way`: nothing does."""
        return ()

    # -- what is given -----------------------------------------------------------------------

    def _checked_fallback(self, fallback: Sequence[float] | None) -> Array:
        names = self.system.input_names
        wanted = (
            np.zeros(len(names)) if fallback is None else np.asarray(fallback, dtype=np.float64)
        )
        if wanted.shape != (len(names),) or not np.isfinite(wanted).all():
            raise SimulationError(
                f"fallback is {fallback!r}", expected=f"{len(names)} numbers: {', '.join(names)}"
            )
        (chosen,), (counted,) = self._within(wanted[np.newaxis])
        if not counted:
            raise SimulationError(
                f"the fallback {', '.join(f'{v:g}' for v in chosen)} is beyond the inputs that "
                "were tried: while an input is late, others may not be under way",
                expected="a fallback within them",
            )
        return chosen


_STATUSES = tuple(Status)


def _check_bounds(certificate: Certificate, system: System) -> None:
    bounds = system.input_bounds
    if bounds is None:
        raise DefinitionError(
            f"system '{system.name}' has no bounds of its inputs",
            expected="bounds, within which a command may pass",
            remedy="give the system that was certified",
        )
    for name, _ in certificate.parameters:
        low, high = certificate.ranges[name]
        if low < high and sp.Symbol(name, real=True) in bounds.free_symbols:
            raise DefinitionError(
                f"the bounds of the inputs of '{system.name}' depend on {name}, which is uncertain",
                expected="bounds that are known",
            )


def _scales(certificate: Certificate, wanted: Mapping[str, float]) -> Array:
    tried, names = certificate.candidates, [n for n, _ in certificate.inputs]
    half = 0.5 * (tried.max(axis=0) - tried.min(axis=0))
    scales = dict(zip(names, np.where(half > 0, half, 1.0).tolist(), strict=True))
    for name, value in wanted.items():
        check_name(name, scales, SimulationError, f"scales of '{name}'")
        if not (math.isfinite(value) and value > 0):
            raise SimulationError(f"the scale of {name} is {value}", expected="above 0")
        scales[name] = float(value)
    return np.array(list(scales.values()))


def _table(rows: npt.ArrayLike, width: int, what: str) -> Array:
    try:
        table = np.ascontiguousarray(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise SimulationError(f"the {what} are no array of numbers") from None
    if table.ndim != 2 or table.shape[1] != width:
        raise SimulationError(
            f"the {what} have the shape {table.shape}", expected=f"(count, {width})"
        )
    return table
