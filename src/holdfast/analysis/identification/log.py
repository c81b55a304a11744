"""Measurements of a vehicle's motion over time, as a log has them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Signal:
    """One measured or commanded quantity at its own times.

    time: shape (n,) [s], strictly increasing; value: shape (n,), finite, in SI units (rad, m/s, N).
    An angle is continuous: it does not jump by a turn.
    """

    time: Floats
    value: Floats


@dataclass(frozen=True)
class Log:
    """What was measured of the states, and what was commanded.

    name: shown in reports, such as the file's name. states, inputs: signals by the names of a
    system; a state that was not measured is left out. A command holds until the next one. gap: the
    longest time between two values of a signal that counts as whole [s]; a longer one splits
    the log. repairs: a sentence for each repair that was made in reading, with its count.
    """

    name: str
    states: Mapping[str, Signal]
    inputs: Mapping[str, Signal]
    gap: float
    repairs: tuple[str, ...] = ()
