"""Saved results: trajectories, value functions and the tables of sweeps, read from their files."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.decomposition.parts_value import (
    DECOMPOSITION,
    PartsValue,
    check_part,
    decomposition_of,
    group_names,
)
from holdfast.analysis.kernel_store import referred
from holdfast.analysis.reachability.stored_values import (
    CACHE,
    Stamp,
    StoredTables,
    StoredValues,
    as_read,
)
from holdfast.analysis.reachability.value_function import ValueFunction, value_function
from holdfast.analysis.simulation.files import FORMAT, HIGHEST, MARK, read_netcdf
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.sweep_table import Campaign
from holdfast.arguments import checked
from holdfast.errors import HoldfastError, OutputError
from holdfast.execution.table_in_parts import can_reserve

LARGE = 256 * 2**20
"""Bytes of values from which on they stay in their file."""

NAMED_AXES = ("state", "input", "actuator", "signal", "constraint", "varied")
"""Each is an axis NAME_name, whose coordinate of the same name describes every column."""

NEEDED = (
    "time", "state", "input", "actuator", "mode", "constraint", "outcome", "exit_time", "goal_time",
    "worst_constraint", "peak_input", "peak_actuator", "switches", "infeasible",
    "largest_slack", "state_name", "state_unit", "state_is_angle", "input_name", "constraint_name",
)  # fmt: skip
"""Variables that a result file must have."""


@checked
def load(
    path: str | Path, *, lazy: bool | None = None, cache: float = CACHE / 2**20
) -> Result | ValueFunction | PartsValue | Campaign:
    """A saved result, without the shapes to draw; a saved value function, or table of a sweep.

    Of a set that is put together from parts every part is a value function of its own.

    path: a file, or a kernel of the store (store:NAME, or NAME where no file has it), of a folder
    with an index (FOLDER#NAME) or of one on the web (https://...#NAME), whose digest is checked.
    lazy: whether the values of a value function stay in the file, and what is asked of it reads the
    chunks that it needs; by default those of `LARGE` bytes or more (256 MiB). cache: of these, MiB
    of chunks that are kept in memory. Such a file stays open; one that was written to since is
    refused. Numbers that another program packed (scale_factor, add_offset) are read as a whole.

    Files of older formats are read too. Raises `OutputError` if the file is damaged, is not one of
    from holdfast, has a newer format than this version knows, or lacks variables.

    >>> _ = result.save("result.nc")
    >>> hf.load("result.nc")
    <Result of 2 runs: 1 stayed, 1 left region>
    """
    if lazy is not None and not isinstance(lazy, bool):
        raise OutputError(f"lazy is {lazy!r}", expected="True, False or None")
    if not 0 <= cache < math.inf:
        raise OutputError(f"cache is {cache}", expected="MiB, 0 or more")
    with _reading(path):
        path = referred(str(path))
        stamp = Stamp.of(path)
        dataset, left = _dataset(path, lazy)
    room = int(cache * 2**20)
    if MARK not in dataset.attrs:
        raise OutputError(f"{path} was not written by holdfast")
    version = dataset.attrs.pop("format_version", 1)
    if not (isinstance(version, np.integer | int) and 1 <= version <= FORMAT):
        raise OutputError(
            f"{path} has the format {version}, this holdfast {__version__} reads 1 to {FORMAT}",
            remedy=f"read it with holdfast {dataset.attrs['holdfast_version']} or later",
        )
    try:
        if "value" in dataset:
            return _values(dataset, path, left, room, stamp)
        if DECOMPOSITION in dataset:
            return _parts(dataset, path, lazy, room, stamp)
        return _loaded(dataset if version == FORMAT else _from_format_1(dataset))
    except (KeyError, ValueError, TypeError) as error:
        raise OutputError(
            f"{path}, written by holdfast {dataset.attrs['holdfast_version']}, lacks what holdfast "
            f"{__version__} needs, or is damaged ({error})",
            remedy="read the rest with xarray.open_dataset, or compute it again",
        ) from None


def _left(dataset: xr.Dataset, lazy: bool | None) -> list[str]:
    """The arrays over the grid of a value function that stay in the file."""
    if "value" not in dataset or lazy is False or not can_reserve():
        return []
    value = dataset["value"]
    grid = tuple(d for d in value.dims if d != "time")
    over = [
        str(n)
        for n, v in dataset.data_vars.items()
        if v.dims in (grid, ("time", *grid)) and _is_plain(v)
    ]
    large = lazy or value.size * value.dtype.itemsize >= LARGE
    return over if grid and large and "value" in over else []


def _is_plain(array: xr.DataArray) -> bool:
    """Whether the numbers of the file are those that are meant."""
    said = array.encoding
    marks = [said[n] for n in ("_FillValue", "missing_value") if n in said]
    packed = "scale_factor" in said or "add_offset" in said
    return array.dtype.kind == "f" and not packed and bool(np.isnan(marks).all())


@contextlib.contextmanager
def _reading(path: str | Path) -> Iterator[None]:
    """While a file is read: damaged files make the readers raise anything."""
    try:
        yield
    except HoldfastError as error:
        raise OutputError(error.cause, expected=error.expected, remedy=error.remedy) from None
    except Exception as error:
        raise OutputError(f"{path} cannot be read as NetCDF ({error})") from None


def _dataset(
    path: Path, lazy: bool | None, group: str | None = None
) -> tuple[xr.Dataset, list[str]]:
    """The root of a file, or a group of it, and its arrays that stay in the file."""
    left: list[str] = []

    def chosen(data: xr.Dataset) -> list[str]:
        left.extend(_left(data, lazy))
        return left

    return read_netcdf(path, chosen, group), left


def _values(
    dataset: xr.Dataset, path: Path, left: list[str], room: int, stamp: Stamp, group: str = ""
) -> ValueFunction:
    """The value function of a dataset, of which some arrays are still in the file."""
    highest = dataset["value"].attrs.pop(HIGHEST, None)  # not of what is made of these values
    if not left:
        return value_function(dataset)
    first = StoredValues(path, f"{group}/value".strip("/"), room, stamp=stamp)
    stored = {
        name: first if name == "value" else first.beside(f"{group}/{name}".strip("/"))
        for name in left
    }
    for values in stored.values():
        dataset = as_read(dataset, values)
    return value_function(dataset, StoredTables(stored, highest))


def _parts(
    dataset: xr.Dataset, path: Path, lazy: bool | None, room: int, stamp: Stamp
) -> PartsValue:
    """The set that is put together from the groups of a file."""
    whole = decomposition_of(dataset)
    names, values = group_names(whole), []
    for name, part in zip(names, whole.parts, strict=True):
        with _reading(path):
            group, left = _dataset(path, lazy, name)
        group.attrs.pop("format_version", None)
        values.append(_values(group, path, left, room // len(names), stamp, name))
        check_part(part, values[-1], name)
    return PartsValue.of(whole, values)


def _loaded(dataset: xr.Dataset) -> Result | Campaign:
    if "over" in dataset.attrs:
        return Campaign(dataset)
    for name in NEEDED:
        dataset[name]
    parameters, reference = (json.loads(dataset.attrs[n]) for n in ("parameters", "reference"))
    return Result(dataset, parameters=parameters, reference=reference)


def _from_format_1(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset of a file of format 1, with the present names.

    There a variable `state` lay along an axis `state`: xarray treats it as a coordinate, and does
    not select along it by name. `slack` was the largest of every run.
    """
    names = {axis: f"{axis}_name" for axis in NAMED_AXES if f"{axis}_name" in dataset}
    parts: list[dict[str, xr.Variable]] = [{}, {}]
    for name, variable in dataset.variables.items():
        dims = [names.get(str(d), d) for d in variable.dims]
        part = parts[name in dataset.coords and name not in NAMED_AXES]
        part[str(name)] = xr.Variable(dims, variable.values, variable.attrs, variable.encoding)
    renamed = xr.Dataset(parts[0], parts[1], dataset.attrs)
    return renamed.rename(slack="largest_slack") if "slack" in renamed else renamed
