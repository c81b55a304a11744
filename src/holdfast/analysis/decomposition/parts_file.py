"""The file of a set that is put together: what it is put together from, and a group for each part.

The root has the decomposition as text, whose expressions are those that were solved, and every
group `part_K` is what the file of that part's value function would be.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.decomposition.decomposition import Decomposition, Part
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.simulation.files import MARK, write_groups
from holdfast.analysis.simulation.named_arrays import NamedArray, NamedArrays
from holdfast.errors import DefinitionError, HoldfastError, OutputError
from holdfast.maths.decomposition.prediction import Prediction
from holdfast.maths.definitions.written import read, written

DECOMPOSITION = "decomposition"
"""The variable of the root with the text."""

LAYOUT = 1
RECORDS = (Prediction, Part, Decomposition)


def group_names(decomposition: Decomposition) -> list[str]:
    """The group of every part."""
    return [f"part_{k}" for k in range(1, len(decomposition.parts) + 1)]


def write_parts(
    decomposition: Decomposition, values: Iterable[ValueFunction], path: str | Path
) -> Path:
    """The file; `OutputError` where a part of the decomposition cannot be written."""
    text = _text(decomposition)
    array = NamedArray(("text",), np.array([text]), {"long_name": "what was taken apart, as JSON"})
    about = {
        MARK: __version__,
        "kind": decomposition.kind,
        "system": decomposition.system.name,
        "verdict": decomposition.verdict,
    }
    groups = {
        name: NamedArrays.of(value.dataset)
        for name, value in zip(group_names(decomposition), values, strict=True)
    }
    return write_groups(NamedArrays({DECOMPOSITION: array}, (), about), groups, path)


def decomposition_of(dataset: xr.Dataset) -> Decomposition:
    """The decomposition of the root; `ValueError` for a text that is none."""
    said = json.loads(str(dataset[DECOMPOSITION].values[0]))
    if (layout := said["layout"]) != LAYOUT:
        raise ValueError(f"the decomposition has the layout {layout!r:.20}, not {LAYOUT}")
    try:
        found: Decomposition = read(said, Decomposition, *RECORDS)
    except HoldfastError as error:
        raise ValueError(error.cause) from None
    return found


def check_part(part: Part, value: ValueFunction, name: str) -> None:
    """Refuse values that are not over the states of their part (`ValueError`)."""
    if value.names != part.system.state_names:
        raise ValueError(
            f"{name} is over {', '.join(value.names)}, not {', '.join(part.system.state_names)}"
        )


def _text(decomposition: Decomposition) -> str:
    """The text, from which the same decomposition is read: this is tried before it is kept."""
    try:
        said = _said(decomposition)
        again = _said(read(json.loads(json.dumps(said)), Decomposition, *RECORDS))
        if again != said:
            raise DefinitionError("what is read from its text is not the same")
    except HoldfastError as error:
        raise OutputError(
            f"the decomposition of '{decomposition.system.name}' cannot be written: {error.cause}",
            expected=error.expected,
            remedy="save the values of the parts, and take the problem apart again",
        ) from None
    return json.dumps({"layout": LAYOUT, **said}, separators=(",", ":"))


def _said(decomposition: Decomposition) -> dict[str, Any]:
    return written(decomposition, *RECORDS)
