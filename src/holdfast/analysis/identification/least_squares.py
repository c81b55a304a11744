"""Robust least squares over windows: first states of each are eliminated, the rest is shared.

The trajectories of all windows are computed at once, with their sensitivities to what is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from holdfast.analysis.identification.log import (
    Windows,
    deviations,
    first_noise,
    huber_weights,
    least_noise,
)
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array, Truths
from holdfast.execution.leaf import Evaluator
from holdfast.execution.trajectories import Trajectories
from holdfast.maths.identification import MeasuredMotion


@dataclass(frozen=True)
class Predicted:
    """What the model says at each measurement, and its slopes.

    value: shape (measurements,). by_state, by_unknown: its derivatives by the first states of its
    window and by the unknown numbers, shapes (measurements, states) and (measurements, unknown).
    """

    value: Array
    by_state: Array
    by_unknown: Array


@dataclass(frozen=True)
class _Nodes:
    """Values and rates at the nodes of every window, shapes (nodes, rows, windows)."""

    value: Array
    rate: Array

    def at(self, windows: Windows, of: npt.NDArray[np.intp], rows: npt.NDArray[np.intp]) -> Array:
        """The cubic Hermite interpolant of some rows at some measurements, a row for each."""
        k, w, h = windows.node[of][:, None], windows.window[of][:, None], windows.step
        s = windows.share[of][:, None]
        a = self.value[k, rows, w]
        if not s.any():
            return a
        b = self.value[k + 1, rows, w]
        c, d = self.rate[k, rows, w] * h, self.rate[k + 1, rows, w] * h
        interpolated: Array = (
            a * ((1 + 2 * s) * (1 - s) ** 2)
            + b * (s**2 * (3 - 2 * s))
            + c * (s * (1 - s) ** 2)
            - d * (s**2 * (1 - s))
        )
        return interpolated


class Shooting:
    """Windows of a motion by classical Runge-Kutta steps, with the variational equations.

    S' = df/dx S + df/dv,     S = dx/d(x(0), v)
    """

    def __init__(self, motion: MeasuredMotion) -> None:
        self.motion = motion
        n, m = len(motion.states), len(motion.unknown)
        self.states, self.unknown = n, m
        x, u, v = ([q.symbol for q in g] for g in (motion.states, motion.inputs, motion.unknown))
        self._paths = Trajectories(motion.sensitivities, x, u, v, motion.parameters)
        expressions = motion.output_sensitivities
        count = len(motion.names)
        self._outputs = []
        for k, output in enumerate(expressions[:count]):
            slopes = expressions[count + n * k :][:n]
            direct = expressions[count + n * count + m * k :][:m]
            used = [i for i, e in enumerate(slopes) if e != 0]
            values = [output, *(slopes[i] for i in used), *direct]
            self._outputs.append((used, Evaluator(values, [*x, *v], motion.parameters)))

    def predicted(self, windows: Windows, first: Array, unknown: Array) -> Predicted:
        """The measurements of windows that begin at `first`, shape (windows, states).

        unknown: shape (windows, unknown), constant in each window.
        """
        n, m = self.states, self.unknown
        value = np.empty(len(windows.value))
        slopes = np.empty((len(windows.value), n + m))
        with np.errstate(over="ignore", invalid="ignore"):  # a diverged window is not a number
            nodes = _Nodes(*self._paths.nodes(first, windows.inputs, unknown, windows.step))
            for k, (used, outputs) in enumerate(self._outputs):
                of = np.flatnonzero(windows.signal == k)
                seeds = [n + (n + m) * i + j for i in used for j in range(n + m)]
                z = nodes.at(windows, of, np.array([*range(n), *seeds], dtype=np.intp))
                points = np.concatenate([z[:, :n], unknown[windows.window[of]]], axis=1)
                seen = outputs.values(points)
                value[of] = seen[:, 0]
                gradient = np.zeros((len(of), n + m))
                gradient[:, n:] = seen[:, 1 + len(used) :]
                for place in range(len(used)):
                    by = z[:, n + (n + m) * place :][:, : n + m]
                    gradient += seen[:, 1 + place, None] * by
                slopes[of] = gradient
        return Predicted(value, slopes[:, :n], slopes[:, n:])


LOOSE = 1e3
"""The deviation of a number from its first guess, in parts of it: what nothing shows stays finite,
and what is seen moves by a millionth of its interval."""

ROUNDS, FEW, SETTLED = 25, 10, 0.02
"""Times at most that the noise and the weights are estimated again, evaluations between them, and
the largest change of a noise, in parts of it, that ends them."""

_INNER, _CLOSE = 25, 1e-3
"""Steps at most to the best first states of a window, and deviations that end them."""

DRAWS = 4
"""Times that the noise of first states is drawn again."""

_FAR = 1e8
"""What a residual counts as, in deviations, where the model diverges."""

DETERMINED = 1e-9
"""The least eigenvalue, in correlations, of what determines the local numbers of a window."""


class DivergenceError(SimulationError):
    """The model diverges within a window."""


@dataclass(frozen=True)
class Fitted:
    """The numbers that explain the windows best.

    shared: the estimated unknown numbers. local: for each window its first states, then its own
    unknown numbers, shape (windows, ...). noise: deviation of each signal. weight: of each
    measurement, 1 over its deviation, less for outliers. residual: measured less predicted.
    slopes: of the weighted prediction by the shared numbers, with the local ones at their best.
    spread: covariance of the local numbers of each window by the noise alone. follow: how the best
    local numbers change with the shared ones. settled: whether more steps would change nothing.
    """

    shared: Array
    local: Array
    noise: Array
    weight: Array
    residual: Array
    slopes: Array
    spread: Array
    follow: Array
    settled: bool = True

    @property
    def information(self) -> Array:
        """The inverse of the covariance of the shared numbers, for independent noise, shape
        (shared, shared)."""
        matrix: Array = self.slopes.T @ self.slopes
        return matrix


class Problem:
    """Windows, the unknown numbers that all share, and those that each has for itself.

    given: the value of every unknown number of the motion, a first guess of the estimated ones,
    shape (unknown,). shared, local: which of them (by number) are estimated for all windows, or
    for each.
    """

    def __init__(
        self,
        shooting: Shooting,
        windows: Windows,
        given: Array,
        shared: Sequence[int],
        local: Sequence[int] = (),
    ) -> None:
        self.shooting, self.windows, self.given = shooting, windows, np.asarray(given, float)
        self.shared, self.local = list(shared), list(local)
        starts = np.searchsorted(windows.window, np.arange(windows.count))
        self._starts = starts
        if (counts := np.diff(np.append(starts, len(windows.window)))).min() == 0:
            raise SimulationError(f"{int((counts == 0).sum())} windows have no measurement")

    def first_local(self) -> Array:
        """A first guess: the measured states at the beginning of each window, and zero else. The
        shape is (windows, states + local numbers)."""
        w = self.windows
        guess = np.zeros((w.count, self.shooting.states + len(self.local)))
        for k, name in enumerate(self.shooting.motion.names):
            of = w.signal == k
            places = [q.name for q in self.shooting.motion.states]
            if name in places and of.any():
                guess[:, places.index(name)] = np.interp(w.start, w.time[of], w.value[of])
        return guess

    def summed(self, rows: Array) -> Array:
        """Sums of rows over the measurements of each window: shapes (measurements, ...) and
        (windows, ...)."""
        sums: Array = np.add.reduceat(rows, self._starts, axis=0)
        return sums

    def predict(self, shared: Array, local: Array) -> tuple[Predicted, Array, Array]:
        """The prediction, and its slopes by the local and by the shared numbers. shared: shape
        (shared,). local: shape (windows, states + local). The slopes have the shapes
        (measurements, states + local) and (measurements, shared)."""
        n = self.shooting.states
        unknown = np.repeat(self.given[None, :], self.windows.count, axis=0)
        unknown[:, self.shared] = shared
        unknown[:, self.local] = local[:, n:]
        predicted = self.shooting.predicted(self.windows, local[:, :n], unknown)
        by_local = np.concatenate([predicted.by_state, predicted.by_unknown[:, self.local]], axis=1)
        return predicted, by_local, predicted.by_unknown[:, self.shared]

    def settle(self, shared: Array, local: Array, weight: Array) -> Fitted:
        """The best local numbers for these shared ones (Levenberg-Marquardt, window by window)."""
        with np.errstate(over="ignore", invalid="ignore"):  # windows that diverge are rejected
            return self._settled(shared, local, weight)

    def _settled(self, shared: Array, local: Array, weight: Array) -> Fitted:
        residual, rows, common = self._weighted(shared, local, weight)
        cost = self.summed(residual**2)
        damping = np.zeros(self.windows.count)
        for _ in range(_INNER):
            matrices = self.summed(rows[:, :, None] * rows[:, None, :])
            pull = self.summed(rows * residual[:, None])
            move = np.einsum("wij,wj->wi", _inverse(matrices, damping), pull)
            if not np.einsum("wi,wi->w", move, pull).max(initial=0.0) > _CLOSE**2:
                break
            tried, its_rows, its_common = self._weighted(shared, local + move, weight)
            new = self.summed(tried**2)
            better = new <= cost
            local = np.where(better[:, None], local + move, local)
            cost = np.where(better, new, cost)
            damping = np.where(better, damping / 10, np.maximum(10 * damping, 0.01))
            at = better[self.windows.window]
            residual = np.where(at, tried, residual)
            rows = np.where(at[:, None], its_rows, rows)
            common = np.where(at[:, None], its_common, common)
        inverse, cross, slopes = self._eliminated(rows, common)
        noise = np.empty(0)
        off = residual / weight
        return Fitted(shared, local, noise, weight, off, slopes, inverse, -cross)

    def information_without_noise(self, fit: Fitted) -> Array:
        """The information of a fit less twice what the noise of its first states adds to it.

        States that are wrong by noise move as well, and seem to show what no motion shows. A second
        error like theirs adds as much again (simulation extrapolation, J. R. Cook and
        L. A. Stefanski, 1994).

        The shape is (shared, shared).
        """
        random = np.random.default_rng(0)
        with np.errstate(over="ignore", invalid="ignore"):
            return self._without_noise(fit, random)

    def _without_noise(self, fit: Fitted, random: np.random.Generator) -> Array:
        value, vector = np.linalg.eigh(fit.spread)
        root = vector * np.sqrt(np.maximum(value, 0))[:, None, :]
        added = np.zeros_like(fit.information)
        for _ in range(DRAWS):
            wrong = np.einsum("wij,wj->wi", root, random.standard_normal(fit.local.shape))
            _, rows, common = self._weighted(fit.shared, fit.local + wrong, fit.weight)
            slopes = self._eliminated(rows, common)[2]
            stays = np.isfinite(slopes).all(axis=1)  # a window may diverge from a wrong state
            usual = fit.slopes[stays]
            added += (slopes[stays].T @ slopes[stays] - usual.T @ usual) / DRAWS
        return fit.information - 2 * added

    def determined(self, fit: Fitted) -> Truths:
        """Whether the measurements of each window show all its local numbers, shape (windows,)."""
        _, rows, _ = self._weighted(fit.shared, fit.local, fit.weight)
        matrices = self.summed(rows[:, :, None] * rows[:, None, :])
        scale = np.sqrt(np.einsum("wii->wi", matrices))
        sure: Truths = (scale > 0).all(axis=1) & np.isfinite(matrices).all((1, 2))
        both = scale[sure][:, :, None] * scale[sure][:, None, :]
        sure[sure] = np.linalg.eigvalsh(matrices[sure] / both)[:, 0] > DETERMINED
        return sure

    def _eliminated(self, rows: Array, common: Array) -> tuple[Array, Array, Array]:
        """(H^-1, H^-1 C, the slopes by the shared numbers with the local ones at their best)."""
        matrices = self.summed(rows[:, :, None] * rows[:, None, :])
        inverse = _inverse(matrices, np.zeros(len(matrices)))
        cross = inverse @ self.summed(rows[:, :, None] * common[:, None, :])
        return inverse, cross, common - np.einsum("ki,kij->kj", rows, cross[self.windows.window])

    def _weighted(self, shared: Array, local: Array, weight: Array) -> tuple[Array, Array, Array]:
        """The residuals, and the slopes of the prediction, in deviations."""
        predicted, by_local, common = self.predict(shared, local)
        off = (self.windows.value - predicted.value) * weight
        return off, by_local * weight[:, None], common * weight[:, None]


def _inverse(matrices: Array, damping: Array) -> Array:
    """Pseudo-inverses, free of units: what the measurements do not show does not move."""
    good = np.isfinite(matrices).all(axis=(1, 2))  # windows that diverge stay unknown
    inverse: Array = np.full_like(matrices, np.nan)
    some, extra = matrices[good], damping[good]
    scale = np.sqrt(np.einsum("wii->wi", some))
    scale = np.where(scale > 0, scale, 1.0)
    both = scale[:, :, None] * scale[:, None, :]
    damped = some / both + extra[:, None, None] * np.eye(matrices.shape[1])
    inverse[good] = np.linalg.pinv(damped, rcond=1e-10, hermitian=True) / both
    return inverse


def fitted(
    problem: Problem,
    first: Array,
    lower: Array,
    *,
    noise: Array | None = None,
    loose: float = LOOSE,
) -> Fitted:
    """The numbers of least squares with Huber's weights, the noise of each signal re-estimated.

        minimise  sum_k rho((y_k - h(x(t_k), v)) / sigma)    over v and x(0) of each window

    (P. J. Huber, Robust statistics, 1981.) The first states are eliminated at each step (variable
    projection, G. H. Golub and V. Pereyra, 1973) and the shared numbers are found by SciPy's
    trust-region method. first: of the shared numbers; lower: their exclusive lower limits. noise:
    of each signal where it is known. loose: how far a number may be from its first guess, as a
    deviation in parts of that guess, which keeps numbers finite that nothing shows. Raises
    `DivergenceError` where no number fits.
    """
    w = problem.windows
    deviation = first_noise(w, len(problem.shooting.motion.names)) if noise is None else noise
    floor = least_noise(w, len(deviation))
    local, shared = problem.first_local(), np.array(first, float)
    begun = problem.settle(shared, local, 1 / np.maximum(deviation, floor)[w.signal])
    far = np.nan_to_num(begun.residual, nan=_FAR) / np.maximum(deviation, floor)[w.signal]
    huber = huber_weights(far)
    scale = np.where(shared == 0, 1.0, np.abs(shared))
    held = _Held(shared / scale, np.where(shared == 0, 0.0, 1 / loose))
    settled = False
    for turn in range(ROUNDS):
        weight = huber / np.maximum(deviation, floor)[w.signal]
        fit, ended = _minimised(problem, shared, local, weight, scale, lower, held)
        shared, local, before = fit.shared, fit.local, deviation
        if noise is None:
            count = fit.local.size + len(problem.shared)
            new = np.maximum(deviations(w, fit.residual, len(deviation), count), floor)
            deviation = new if turn < 2 else (new + deviation) / 2  # they may alternate
        huber = huber_weights(fit.residual / np.maximum(deviation, floor)[w.signal])
        settled = ended and bool((np.abs(deviation - before) <= SETTLED * before).all())
        if settled:
            break
    weight = huber / np.maximum(deviation, floor)[w.signal]
    fit = problem.settle(shared, local, weight)
    if not np.isfinite(fit.residual).all():
        raise DivergenceError(
            f"the model diverges within windows of {w.length:.3g} s",
            remedy="take a shorter window",
        )
    return replace(fit, noise=deviation, settled=settled)


@dataclass(frozen=True)
class _Held:
    """Numbers, in parts of their first guesses, that are pulled towards these."""

    to: Array
    strength: Array


def _minimised(
    problem: Problem,
    shared: Array,
    local: Array,
    weight: Array,
    scale: Array,
    lower: Array,
    held: _Held,
) -> tuple[Fitted, bool]:
    """A few steps of least squares with these weights, and whether more would change nothing."""
    if not problem.shared:
        return problem.settle(shared, local, weight), True
    tried: tuple[bytes, Fitted] | None = None
    accepted: Fitted | None = None

    def at(x: Array) -> Fitted:
        """The fit with these numbers, its first states sought from those of the last accepted."""
        nonlocal tried
        if tried is None or tried[0] != x.tobytes():
            begin = local
            if accepted is not None:
                begin = accepted.local + accepted.follow @ (x * scale - accepted.shared)
            tried = x.tobytes(), problem.settle(x * scale, begin, weight)
        return tried[1]

    def residual(x: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            weighted = at(x).residual * weight
        clipped = np.where(np.isfinite(weighted), np.clip(weighted, -_FAR, _FAR), _FAR)
        return np.concatenate([clipped, held.strength * (x - held.to)])

    def jacobian(x: Array) -> Array:
        """Asked for at the first numbers and at accepted ones."""
        nonlocal accepted
        accepted = at(x)
        slopes = np.nan_to_num(-accepted.slopes * scale)
        return np.concatenate([slopes, np.diag(held.strength)])

    least = np.where(np.isfinite(lower), lower / scale, -np.inf)
    result: Any = least_squares(
        residual, shared / scale, jac=jacobian, bounds=(least, np.inf), x_scale="jac",
        ftol=1e-8, xtol=1e-8, gtol=1e-10, max_nfev=FEW,
    )  # fmt: skip
    assert accepted is not None
    return accepted, result.status > 0
