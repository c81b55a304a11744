"""Trajectories of all windows at once, with their sensitivities to what is unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.analysis.identification.log import Floats
from holdfast.analysis.identification.windows import Windows
from holdfast.execution.evaluate import Evaluator
from holdfast.maths.identification.measured_motion import MeasuredMotion


@dataclass(frozen=True)
class Predicted:
    """What the model says at each measurement, and its slopes.

    value: shape (measurements,). by_state, by_unknown: its derivatives by the first states of its
    window and by the unknown numbers, shapes (measurements, states) and (measurements, unknown).
    """

    value: Floats
    by_state: Floats
    by_unknown: Floats


@dataclass(frozen=True)
class _Nodes:
    """Values and rates at the nodes of every window, shapes (nodes, windows, ...)."""

    value: Floats
    rate: Floats

    def at(self, windows: Windows) -> Floats:
        """The cubic Hermite interpolant at each measurement."""
        k, w, h = windows.node, windows.window, windows.step
        s = windows.share.reshape(-1, *(1,) * (self.value.ndim - 2))
        a, b = self.value[k, w], self.value[k + 1, w]
        c, d = self.rate[k, w] * h, self.rate[k + 1, w] * h
        found: Floats = (
            a * (1 + 2 * s) * (1 - s) ** 2
            + b * s**2 * (3 - 2 * s)
            + c * s * (1 - s) ** 2
            - d * s**2 * (1 - s)
        )
        return found


class Shooting:
    """Windows of a motion by classical Runge-Kutta steps, with the variational equations.

    S' = df/dx S + df/dv,     S = dx/d(x(0), v)
    """

    def __init__(self, motion: MeasuredMotion) -> None:
        self.motion = motion
        self.states, self.unknown = len(motion.states), len(motion.unknown)
        self._rates = Evaluator(motion.sensitivities, motion.columns, motion.parameters)
        seen = [q.symbol for q in (*motion.states, *motion.unknown)]
        self._outputs = Evaluator(motion.output_sensitivities, seen, motion.parameters)

    def predicted(self, windows: Windows, first: Floats, unknown: Floats) -> Predicted:
        """The measurements of windows that begin at `first`, shape (windows, states).

        unknown: shape (windows, unknown), constant in each window.
        """
        n, m = self.states, self.unknown
        count = windows.count
        slopes = np.zeros((count, n, n + m))
        slopes[:, :, :n] = np.eye(n)
        z = np.concatenate([first[:, :, None], slopes], axis=2)
        values = np.empty((windows.steps + 1, *z.shape))
        rates = np.empty_like(values)
        points = np.empty((count, n + windows.inputs.shape[2] + m))
        points[:, points.shape[1] - m :] = unknown
        h = windows.step

        def rate(z: Floats, k: int) -> Floats:
            points[:, :n] = z[:, :, 0]
            points[:, n : points.shape[1] - m] = windows.inputs[:, k]
            found = self._rates.values(points)
            by_state = found[:, n : n + n * n].reshape(count, n, n)
            moved = np.empty_like(z)
            moved[:, :, 0] = found[:, :n]
            moved[:, :, 1:] = by_state @ z[:, :, 1:]
            moved[:, :, 1 + n :] += found[:, n + n * n :].reshape(count, n, m)
            return moved

        with np.errstate(over="ignore", invalid="ignore"):  # a diverged window is not a number
            for k in range(windows.steps):
                a = rate(z, k)
                values[k], rates[k] = z, a
                b = rate(z + h / 2 * a, k)
                c = rate(z + h / 2 * b, k)
                z = z + h / 6 * (a + 2 * b + 2 * c + rate(z + h * c, k))
            values[-1], rates[-1] = z, rate(z, windows.steps - 1)
            return self._seen(windows, _Nodes(values, rates).at(windows), unknown)

    def _seen(self, windows: Windows, z: Floats, unknown: Floats) -> Predicted:
        """The outputs of the states at each measurement."""
        n, m, count = self.states, self.unknown, len(self.motion.names)
        points = np.concatenate([z[:, :, 0], unknown[windows.window]], axis=1)
        found = self._outputs.values(points)
        row, of = np.arange(len(points)), windows.signal
        by_state = found[:, count : count + count * n].reshape(len(row), count, n)[row, of]
        direct = found[:, count + count * n :].reshape(len(row), count, m)[row, of]
        slopes = np.einsum("ki,kij->kj", by_state, z[:, :, 1:])
        return Predicted(found[row, of], slopes[:, :n], slopes[:, n:] + direct)
