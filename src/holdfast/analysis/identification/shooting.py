"""Trajectories of all windows at once, with their sensitivities to what is unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.analysis.identification.log import Floats
from holdfast.analysis.identification.windows import Windows
from holdfast.execution.evaluate import Evaluator
from holdfast.execution.trajectories import Trajectories
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
    """Values and rates at the nodes of every window, shapes (nodes, rows, windows)."""

    value: Floats
    rate: Floats

    def at(self, windows: Windows, of: npt.NDArray[np.intp], rows: npt.NDArray[np.intp]) -> Floats:
        """The cubic Hermite interpolant of some rows at some measurements, a row for each."""
        k, w, h = windows.node[of][:, None], windows.window[of][:, None], windows.step
        s = windows.share[of][:, None]
        a = self.value[k, rows, w]
        if not s.any():
            return a
        b = self.value[k + 1, rows, w]
        c, d = self.rate[k, rows, w] * h, self.rate[k + 1, rows, w] * h
        found: Floats = (
            a * ((1 + 2 * s) * (1 - s) ** 2)
            + b * (s**2 * (3 - 2 * s))
            + c * (s * (1 - s) ** 2)
            - d * (s**2 * (1 - s))
        )
        return found


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
        found = motion.output_sensitivities
        count = len(motion.names)
        self._outputs = []
        for k, output in enumerate(found[:count]):
            slopes = found[count + n * k :][:n]
            direct = found[count + n * count + m * k :][:m]
            used = [i for i, e in enumerate(slopes) if e != 0]
            values = [output, *(slopes[i] for i in used), *direct]
            self._outputs.append((used, Evaluator(values, [*x, *v], motion.parameters)))

    def predicted(self, windows: Windows, first: Floats, unknown: Floats) -> Predicted:
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
                own = np.zeros((len(of), n + m))
                own[:, n:] = seen[:, 1 + len(used) :]
                for place in range(len(used)):
                    by = z[:, n + (n + m) * place :][:, : n + m]
                    own += seen[:, 1 + place, None] * by
                slopes[of] = own
        return Predicted(value, slopes[:, :n], slopes[:, n:])
