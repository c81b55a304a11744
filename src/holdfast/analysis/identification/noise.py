"""The noise of each signal of a log, and the weights of outliers."""

from __future__ import annotations

import numpy as np

from holdfast.analysis.identification.log import Floats
from holdfast.analysis.identification.windows import Windows

HUBER = 2.5
"""Deviations beyond which a residual counts linearly."""

_SMALLEST = 1e-9
"""Noise at least, as a part of the range of a signal."""


def huber_weights(ratio: Floats) -> Floats:
    """Square roots of Huber's weights of residuals in deviations."""
    return np.sqrt(np.minimum(1.0, HUBER / np.maximum(np.abs(ratio), 1e-300)))


def deviations(w: Windows, residual: Floats, signals: int, fitted_numbers: int) -> Floats:
    """The noise of each signal, from the median of its residuals, for the numbers fitted."""
    free = max(1 - fitted_numbers / len(w.value), 0.1)
    each = [1.4826 * float(np.median(np.abs(residual[w.signal == k]))) for k in range(signals)]
    return np.array(each) / np.sqrt(free)


def first_noise(w: Windows, signals: int) -> Floats:
    """The noise of each signal, from its second differences within windows."""
    found = []
    for k in range(signals):
        of = w.signal == k
        bend = np.diff(w.value[of], 2)
        within = w.window[of][2:] == w.window[of][:-2]
        some = bend[within] if within.any() else np.zeros(1)
        found.append(1.4826 * float(np.median(np.abs(some))) / np.sqrt(6))
    return np.maximum(np.array(found), least_noise(w, signals))


def least_noise(w: Windows, signals: int) -> Floats:
    spans = [
        np.ptp(w.value[w.signal == k]) if (w.signal == k).any() else 0.0 for k in range(signals)
    ]
    return np.maximum(_SMALLEST * np.array(spans), 1e-300)
