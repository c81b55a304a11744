"""Types of arrays, for annotations."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
"""Numbers in double precision."""

AnyArray = npt.NDArray[Any]
"""Numbers in the precision of the problem."""

Floats: TypeAlias = npt.NDArray[Any]
Wholes: TypeAlias = npt.NDArray[Any]
Table: TypeAlias = npt.NDArray[Any]
"""Arrays of scalar functions (`codegen/scalar_reader.py`), of which a part is `array[k:]`."""
