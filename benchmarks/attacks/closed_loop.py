"""Filtered closed loops under adversaries, with an integrator of this folder.

Many runs side by side; the input is held between samples, measurements may be late by whole
samples. The adversaries: one that lowers a value along its slope, one that looks a sample ahead,
constant extremes, extremes that switch at random, and random members. The commands are constants,
members that change at a random pace, and the member that lowers the value most: what a filter is
for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from attacks.oracle import moved, points, worst
from attacks.problems import TURN, Problem

Array = np.ndarray
ADVERSARIES = ("slope", "ahead", "constant", "switching", "random")
SUBSTEPS = 4


@dataclass
class Runs:
    """What became of closed loops: the worst inequality along each run, and what was decided."""

    worst: Array
    inputs_out: int = 0
    not_finite: int = 0
    lies: list[str] = field(default_factory=list)
    infeasible: Array = field(default_factory=lambda: np.zeros(0, bool))
    """Whether a run had a sample at which the filter said that it could not keep its conditions."""
    left_at: Array = field(default_factory=lambda: np.zeros(0))
    adversary: Array = field(default_factory=lambda: np.zeros(0, int))


def inside_bounds(bound: list[Any], u: Array) -> Array:
    """Whether inputs (runs, m) are within their bound, but for rounding."""
    slack = 1e-6
    if bound[0] == "ball":
        return np.sqrt((u**2).sum(axis=1)) <= bound[1] * (1 + slack)
    if bound[0] == "image":
        u = u @ np.linalg.inv(np.array(bound[1])).T
    low, high = np.array(bound[-2]), np.array(bound[-1])
    wide = slack * np.maximum(high - low, 1e-9)
    return ((u >= low - wide) & (u <= high + wide)).all(axis=1)


def command_pool(bound: list[Any]) -> Array:
    """Commands: members of the bound, and some well beyond it."""
    members = points(bound, 3)
    return np.vstack([members, 1.5 * members])


def run(
    p: Problem,
    keep: Any,
    starts: Array,
    sample: float,
    duration: float,
    value: Callable[[Array], Array],
    generator: np.random.Generator,
    delay: int = 0,
    slack: float = 0.0,
) -> Runs:
    """Runs of a filter `keep` from states (n, runs); `value` is what adversaries lower.

    sample, duration: of the problem's time. delay: of measurements, in samples. slack: by how much
    an inequality is exceeded before a run counts as one that has left.
    """
    scales, clock = np.array(p.scales)[:, None], p.clock
    x, count = starts.copy(), starts.shape[1]
    foe = np.arange(count) % len(ADVERSARIES)
    members = points(p.disturbances, 2)
    pool = command_pool(p.inputs)
    nominal = pool[generator.integers(len(pool), size=count)]
    temper = generator.random(count)
    restless, outward = temper < 0.4, temper > 0.6
    extremes = points(p.inputs, 2)
    pushed = members[generator.integers(len(members), size=count)]
    pace = generator.uniform(0.02, 0.3, count)
    result = Runs(np.full(count, -np.inf), left_at=np.full(count, np.inf), adversary=foe)
    result.infeasible = np.zeros(count, bool)
    seen = [x]
    width = np.maximum(p.cells, 1e-9)[:, None]
    for step in range(max(int(duration / sample), 1)):
        changed = restless & (generator.random(count) < 10 * sample / duration)
        nominal = np.where(
            changed[:, None], pool[generator.integers(len(pool), size=count)], nominal
        )
        ones = np.ones(count)
        nexts = [value(moved(p, x, [v * ones for v in c], pushed.T, sample)) for c in extremes]
        nominal = np.where(outward[:, None], extremes[np.argmin(nexts, axis=0)], nominal)
        measured = seen[max(len(seen) - 1 - delay, 0)]
        decisions = keep.step_many(
            np.ascontiguousarray((measured * scales).T), nominal, t=step * sample * clock
        )
        u = np.asarray(decisions.input)
        doubt = inspect(p, result, decisions, nominal, u)
        result.infeasible |= doubt & ~np.isfinite(result.left_at)
        u = np.where(np.isfinite(u), u, 0.0)
        d = pushed
        if members.shape[1] and len(members) > 1:
            d = _pushes(p, x, u, members, foe, pushed, sample, value, width)
            switch = generator.random(count) < pace
            fresh = members[generator.integers(len(members), size=count)]
            mixed = fresh * np.where(foe == 4, generator.random(count), 1.0)[:, None]
            pushed = np.where((switch & (foe >= 3))[:, None], mixed, pushed)
        for _ in range(SUBSTEPS):
            x = moved(p, x, u.T, d.T, sample / SUBSTEPS)
            now = worst(p, x)
            result.left_at = np.where(
                (now > slack) & ~np.isfinite(result.left_at), step * sample, result.left_at
            )
            result.worst = np.fmax(result.worst, now)
        for i, turn in enumerate(p.angles):
            if turn:
                x[i] = (x[i] - p.low[i]) % TURN + p.low[i]
        x = np.clip(np.nan_to_num(x), -1e6, 1e6)
        seen = [*seen[-delay - 1 :], x]
    return result


def _pushes(
    p: Problem,
    x: Array,
    u: Array,
    members: Array,
    foe: Array,
    pushed: Array,
    sample: float,
    value: Callable[[Array], Array],
    width: Array,
) -> Array:
    """The disturbance of each run."""
    ones = np.ones(x.shape[1])
    slopes = []
    for i in range(len(x)):
        shift = np.zeros_like(width)
        shift[i] = 0.5 * width[i]
        slopes.append((value(x + shift) - value(x - shift)) / width[i])
    nexts, falls = [], []
    for d in members:
        held = [v * ones for v in d]
        then = moved(p, x, u.T, np.array(held), sample)
        nexts.append(value(then))
        falls.append((np.array(slopes) * (then - x)).sum(axis=0))
    chosen = np.where((foe == 1)[:, None], members[np.argmin(nexts, axis=0)], pushed)
    return np.where((foe == 0)[:, None], members[np.argmin(falls, axis=0)], chosen)


def inspect(p: Problem, result: Runs, decisions: Any, nominal: Array, u: Array) -> Array:
    """What decisions say, against what they are; where they say that they promise nothing."""
    status = np.array([s.value for s in decisions.status])
    finite = np.isfinite(u).all(axis=1)
    result.not_finite += int((~finite).sum())
    result.inputs_out += int((finite & ~inside_bounds(p.inputs, u)).sum())
    same = np.isclose(u, nominal, rtol=1e-6, atol=1e-9).all(axis=1)
    if ((status == "passed") & ~same).any():
        result.lies.append("says that it passed a command, and changed it")
    doubt: Array = (status == "infeasible") | (status == "outside the grid")
    return doubt
