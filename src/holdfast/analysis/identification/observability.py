"""Which numbers a motion can show at all, and which this log shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.analysis.identification.log import Floats
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.identification.measured_motion import MeasuredMotion

TIED, HOPELESS, VAGUE = 1e-7, 30.0, 0.5
"""A singular value, in parts of the largest, that counts as none; relative deviations that count as
not seen, before the fit and after it."""

_POINTS = 400


def ties(motion: MeasuredMotion, values: Floats) -> list[tuple[str, ...]]:
    """Groups of numbers that the rates show only in combination, however the vehicle moves.

    The null space of df/dv at these values, at random states and inputs (local structural
    identifiability with every state measured). Each group is a combination; a log of fewer states
    may tie more.
    """
    if not len(values):
        return []
    generator = np.random.default_rng(0)
    n = len(motion.states)
    compute = Evaluator(motion.sensitivities, motion.columns, motion.parameters)
    some = generator.uniform(-1, 1, size=(_POINTS, len(motion.columns)))
    scale = np.where(values == 0, 1.0, np.abs(values))
    some[:, some.shape[1] - len(values) :] = values
    found = compute.values(some)[:, n + n * n :].reshape(-1, len(values)) * scale
    found = found[np.isfinite(found).all(axis=1)]
    norm = np.linalg.norm(found, axis=0)
    seen = norm > 0
    _, singular, right = np.linalg.svd(found / np.where(seen, norm, 1.0), full_matrices=False)
    null = right[singular < TIED * singular[0]]
    names = [q.name for q in motion.unknown]
    return [tuple(names[k] for k in np.flatnonzero(np.abs(row) > 1e-6)) for row in _sparse(null)]


def _sparse(rows: Floats) -> Floats:
    """Rows that span the same space with as few entries as elimination gives."""
    rows = rows.copy()
    done = 0
    for column in range(rows.shape[1]):
        if done == len(rows):
            break
        best = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[best, column]) < 1e-6:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        for other in range(len(rows)):
            if other != done:
                rows[other] -= rows[other, column] * rows[done]
        done += 1
    rows[np.abs(rows) < 1e-6] = 0
    return rows


def to_hold(groups: Sequence[tuple[str, ...]], order: Sequence[str]) -> dict[str, str]:
    """For each group the first of its numbers in `order` that is not held yet, and why."""
    held: dict[str, str] = {}
    for group in groups:
        free = [n for n in order if n in group and n not in held]
        others = [n for n in group if n != free[0]]
        why = "no motion shows it" if not others else f"only seen together with {', '.join(others)}"
        held[free[0]] = why
    return held


def not_seen(information: Floats, scale: Floats, names: Sequence[str], vague: float) -> list[str]:
    """Numbers of which the deviation is more than `vague` sizes, the vaguest first."""
    left = list(range(len(names)))
    dropped: list[str] = []
    while left:
        part = information[np.ix_(left, left)] * np.outer(scale[left], scale[left])
        value, vector = np.linalg.eigh(part)
        if value[0] > 1 / vague**2:
            break
        worst = left[int(np.argmax(np.abs(vector[:, 0])))]
        dropped.append(names[worst])
        left.remove(worst)
    return dropped


def deviations(information: Floats) -> Floats:
    """The deviation of each number for this information; infinite where there is none."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    both = np.outer(scale, scale)
    value, vector = np.linalg.eigh(information / both)
    if value[0] < 1e-12 * value[-1]:
        inverse = np.where(value > 1e-12 * value[-1], 1 / np.maximum(value, 1e-300), np.inf)
        with np.errstate(invalid="ignore"):
            found = np.nansum(vector**2 * inverse, axis=1)
    else:
        found = (vector**2 / value).sum(axis=1)
    return np.asarray(np.sqrt(found) / scale)
