"""Arrays with names, axes and attributes: what a result file holds, without a library for it.

xarray takes half a second to load, and is loaded when a dataset is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy.typing as npt

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class NamedArray:
    """An array, the names of its axes, and what it means (units, long_name)."""

    dims: tuple[str, ...]
    values: npt.NDArray[Any]
    attrs: Mapping[str, Any]


@dataclass(frozen=True)
class NamedArrays:
    """Arrays by name, those in `coordinates` describing the axes of the others."""

    variables: Mapping[str, NamedArray]
    coordinates: tuple[str, ...]
    attrs: Mapping[str, Any]

    @classmethod
    def of(cls, dataset: xr.Dataset) -> NamedArrays:
        """The arrays of a dataset, without copies."""
        variables = {str(n): cast(NamedArray, v) for n, v in dataset.variables.items()}
        attributes = {str(n): v for n, v in dataset.attrs.items()}
        return cls(variables, tuple(str(n) for n in dataset.coords), attributes)

    def __getitem__(self, name: str) -> NamedArray:
        return self.variables[name]

    def __contains__(self, name: str) -> bool:
        return name in self.variables

    @property
    def sizes(self) -> dict[str, int]:
        """The length of every axis."""
        found: dict[str, int] = {}
        for variable in self.variables.values():
            found.update(zip(variable.dims, variable.values.shape, strict=True))
        return found

    def dataset(self) -> xr.Dataset:
        """The same as an xarray dataset, without copies."""
        import xarray as xr

        parts: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
        for name, v in self.variables.items():
            parts[name in self.coordinates][name] = (v.dims, v.values, dict(v.attrs))
        return xr.Dataset(*parts, dict(self.attrs))
