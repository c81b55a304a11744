"""The result of a simulation: an xarray dataset with names, units and outcomes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from holdfast._version import __version__
from holdfast.analysis.reachability.value_function import ValueFunction, value_function
from holdfast.analysis.simulation.dataset import from_format_1
from holdfast.analysis.simulation.files import FORMAT, MARK, read_netcdf, write_netcdf
from holdfast.analysis.simulation.sweep_table import Campaign
from holdfast.arguments import checked
from holdfast.errors import HoldfastError, OutputError
from holdfast.execution.simulation.outcomes import Outcome

if TYPE_CHECKING:
    from holdfast.maths.definitions.scene import Shape


NEEDED = (
    "time", "state", "input", "actuator", "mode", "constraint", "outcome", "exit_time", "goal_time",
    "worst_constraint", "peak_input", "peak_actuator", "switches", "infeasible",
    "largest_slack", "state_name", "state_unit", "state_is_angle", "input_name", "constraint_name",
)  # fmt: skip
"""Variables that a result file must have."""


@dataclass(frozen=True)
class Result:
    """Trajectories as `dataset`, the shapes to draw, and the reference state for errors.

    `scene` are the region's and the goal's shapes, `parameters` the values in them.
    `reference` maps states to the desired final values; may be empty.
    """

    dataset: xr.Dataset
    scene: tuple[Shape, ...] = ()
    parameters: Mapping[str, float] | None = None
    reference: Mapping[str, float] | None = None

    @property
    def outcomes(self) -> dict[str, int]:
        """The number of runs with each outcome, by its label."""
        counts = np.bincount(self.dataset["outcome"].values, minlength=len(Outcome))
        return {
            o.label: int(counts[o])
            for o in (
                Outcome.REACHED,
                Outcome.STAYED,
                Outcome.CHATTERED,
                Outcome.OFF_GRID,
                Outcome.LEFT,
                Outcome.DIVERGED,
            )
        }

    @property
    def viable(self) -> int:
        """The number of runs that never left the region."""
        values = self.dataset["outcome"].values
        kept = (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED, Outcome.OFF_GRID)
        return int(np.isin(values, kept).sum())

    @property
    def success_fraction(self) -> float | None:
        """The share of runs that reached the goal without leaving the region; None: no goal."""
        runs = int(self.dataset.sizes["run"])
        if not self.dataset.attrs.get("goal") or not runs:
            return None
        return self.outcomes[Outcome.REACHED.label] / runs

    def summary(self) -> dict[str, Any]:
        """The statistics of summary.json; NaN appears as None."""
        data = self.dataset
        worst = data["worst_constraint"].max("run") if data.sizes["run"] else None
        return {
            "scenario": data.attrs.get("scenario", ""),
            "kind": data.attrs.get("kind", "closed-loop"),
            "version": data.attrs["holdfast_version"],
            "seed": int(data.attrs["seed"]),
            "runs": int(data.sizes["run"]),
            "viable": self.viable,
            "outcomes": self.outcomes,
            "success_fraction": self.success_fraction,
            "worst_constraint": _by_name(worst) if worst is not None else {},
            "in_goal_since": self._goal_times(),
            "switching": self._switching(),
            "safeguard": self._safeguard(),
            "vertices": self._vertices(),
            "final_error": self._final_error(),
            "peak_input": _by_name(data["peak_input"].max("run")),
            "peak_actuator": _by_name(data["peak_actuator"].max("run")),
            "wall_time_s": round(float(data.attrs["wall_time_s"]), 3),
        }

    def _goal_times(self) -> dict[str, float | None]:
        """Settling times [s]: when the runs that end in the goal entered it for the last time."""
        since = self.dataset["goal_time"].values
        since = since[np.isfinite(since)]
        return {
            "median": float(np.median(since)) if since.size else None,
            "worst": float(since.max()) if since.size else None,
        }

    def _switching(self) -> dict[str, float | None]:
        """Changes of mode a minute and the shortest time in one mode [s]; {} for one mode."""
        data = self.dataset
        modes = str(data["mode"].attrs["flag_meanings"]).split()
        if len(modes) < 2 or not data.sizes["run"] or "shortest_dwell" not in data:
            return {}  # one mode, or a result of an older version
        rate = data["switches"].values * (60.0 / float(data["time"].values[-1]))
        shortest = float(data["shortest_dwell"].values.min())
        return {
            "median_per_minute": float(np.median(rate)),
            "worst_per_minute": float(rate.max()),
            "shortest_dwell": shortest if np.isfinite(shortest) else None,
        }

    def _safeguard(self) -> dict[str, float]:
        """Counts of samples and runs in which the safety filter changed the command, and in which
        it found no admissible input; {} without a safety filter.
        """
        data = self.dataset
        if not data.attrs.get("safeguarded", 0):
            return {}
        overruled = {}
        if "overruled" in data:  # missing in files of format 1
            counts = data["overruled"].values
            overruled = {
                "runs_overruled": int((counts > 0).sum()),
                "samples_overruled": int(counts.sum()),
            }
        return {
            **overruled,
            "runs_relaxed": int((data["infeasible"].values > 0).sum()),
            "samples_relaxed": int(data["infeasible"].values.sum()),
            "largest_slack": float(data["largest_slack"].values.max(initial=0.0)),
        }

    def _vertices(self) -> list[dict[str, Any]]:
        """The outcomes at each vertex of the varied parameters; [] without vertices."""
        data = self.dataset
        names = json.loads(data.attrs.get("vertices", "[]"))
        if not names:
            return []
        known = [str(n) for n in data["varied_name"].values]
        values = data["varied"].values[:, [known.index(n) for n in names]]
        outcome, infeasible = data["outcome"].values, data["infeasible"].values
        viable = np.isin(outcome, (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED))
        found = []
        for vertex in np.unique(values, axis=0):
            mine = (values == vertex).all(axis=1)
            found.append(
                {
                    "at": {n: float(v) for n, v in zip(names, vertex, strict=True)},
                    "runs": int(mine.sum()),
                    "viable": int(viable[mine].sum()),
                    "reached": int((outcome[mine] == Outcome.REACHED).sum()),
                    "runs_relaxed": int((infeasible[mine] > 0).sum()),
                    "samples_relaxed": int(infeasible[mine].sum()),
                    "worst_constraint": _by_name(data["worst_constraint"][mine].max("run")),
                }
            )
        return found

    def final_errors(self) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        """The final error of every run from the reference, by state (run); NaN if it diverged."""
        errors = {}
        for name, value in (self.reference or {}).items():
            final = self.dataset["state"].sel(state_name=name).isel(time=-1).values - value
            if bool(self.dataset["state_is_angle"].sel(state_name=name)):
                final = (final + np.pi) % (2 * np.pi) - np.pi
            errors[name] = np.abs(final)
        return errors

    def _final_error(self) -> dict[str, dict[str, float | None]]:
        errors: dict[str, dict[str, float | None]] = {}
        for name, final in self.final_errors().items():
            size = final[np.isfinite(final)]
            # a diverged run has no final state, and the worst error is undefined
            errors[name] = {
                "median": float(np.median(size)) if size.size else None,
                "worst": float(size.max()) if size.size == final.size else None,
            }
        return errors

    @checked
    def save(self, path: str | Path) -> Path:
        """Write NetCDF-4, atomically: the file appears whole under its name or not at all.

        Raises `OutputError` when the folder cannot be written.
        """
        return write_netcdf(self.dataset, path)


def _by_name(values: xr.DataArray) -> dict[str, float | None]:
    (dimension,) = values.dims
    return {
        str(name): float(value) if np.isfinite(value) else None
        for name, value in zip(values[dimension].values, values.values, strict=True)
    }


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
        return _loaded(dataset if version == FORMAT else from_format_1(dataset))
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
