"""Types of arrays, for annotations: one name for each kind of numbers.

The shape of an array stands in the docstring of what takes or gives it, as a tuple of what its axes
count: (runs, samples, states). A last axis of states is in the units of the states.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
"""Numbers in double precision."""

AnyArray: TypeAlias = npt.NDArray[Any]
"""Numbers in the precision of the problem."""

Wholes: TypeAlias = npt.NDArray[np.int64]
"""Counts, and places in other arrays."""

Ranks: TypeAlias = npt.NDArray[np.int32]
"""Whole numbers of which there are many, in half the room."""

Truths: TypeAlias = npt.NDArray[np.bool_]
"""Yes or no."""

Floats: TypeAlias = npt.NDArray[Any]
Table: TypeAlias = npt.NDArray[Any]
"""Arrays of scalar functions (`codegen/scalar_reader.py`), of which a part is `array[k:]`."""
