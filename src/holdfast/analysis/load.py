"""Saved results: trajectories, value functions and the tables of sweeps, read from their files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.reachability.value_function import ValueFunction, value_function
from holdfast.analysis.simulation.files import FORMAT, MARK, read_netcdf
from holdfast.analysis.simulation.result import Result
from holdfast.analysis.simulation.sweep_table import Campaign
from holdfast.arguments import checked
from holdfast.errors import HoldfastError, OutputError

NAMED_AXES = ("state", "input", "actuator", "signal", "constraint", "varied")
"""Each is an axis NAME_name, whose coordinate of the same name describes every column."""

NEEDED = (
    "time", "state", "input", "actuator", "mode", "constraint", "outcome", "exit_time", "goal_time",
    "worst_constraint", "peak_input", "peak_actuator", "switches", "infeasible",
    "largest_slack", "state_name", "state_unit", "state_is_angle", "input_name", "constraint_name",
)  # fmt: skip
"""Variables that a result file must have."""


@checked
def load(path: str | Path) -> Result | ValueFunction | Campaign:
    """A saved result, without the shapes to draw; a saved value function, or table of a sweep.

    Files of older formats are read too. Raises `OutputError` if the file is damaged, is not one of
    from holdfast, has a newer format than this version knows, or lacks variables.
    """
    try:
        dataset = read_netcdf(path)
    except HoldfastError as error:
        raise OutputError(error.cause, expected=error.expected, remedy=error.remedy) from None
    except Exception as error:  # damaged files make the readers raise anything
        raise OutputError(f"{path} cannot be read as NetCDF ({error})") from None
    if MARK not in dataset.attrs:
        raise OutputError(f"{path} was not written by holdfast")
    version = dataset.attrs.pop("format_version", 1)
    if not (isinstance(version, np.integer | int) and 1 <= version <= FORMAT):
        raise OutputError(
            f"{path} has the format {version}, this holdfast {__version__} reads 1 to {FORMAT}",
            remedy=f"read it with holdfast {dataset.attrs['holdfast_version']} or later",
        )
    try:
        return _loaded(dataset if version == FORMAT else _from_format_1(dataset))
    except (KeyError, ValueError, TypeError) as error:
        raise OutputError(
            f"{path}, written by holdfast {dataset.attrs['holdfast_version']}, lacks what holdfast "
            f"{__version__} needs, or is damaged ({error})",
            remedy="read the rest with xarray.open_dataset, or compute it again",
        ) from None


def _loaded(dataset: xr.Dataset) -> Result | ValueFunction | Campaign:
    if "value" in dataset:
        return value_function(dataset)
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
    found = xr.Dataset(parts[0], parts[1], dataset.attrs)
    return found.rename(slack="largest_slack") if "slack" in found else found
