"""Types of arrays, for annotations."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""Numbers in double precision."""

AnyArray = npt.NDArray[Any]
"""Numbers in the precision of the problem."""
