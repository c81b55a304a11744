"""The result of a simulation: arrays with names, units and outcomes.

Statistics of station keeping are one number for each run and criterion of chapter 3.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.analysis.simulation.files import NamedArrays, write_arrays, write_netcdf
from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.execution.arrays import Truths
from holdfast.execution.simulation.settings import Outcome
from holdfast.maths.definitions.value import InNotebooks

if TYPE_CHECKING:
    import xarray as xr
    from xarray import Dataset

    from holdfast.maths.definitions.region import Shape
    from holdfast.maths.definitions.system import System


class Result(InNotebooks):
    """Trajectories as `dataset`, the shapes to draw, and the reference state for errors.

    `scene` are the region's and the goal's shapes and the zero levels of their inequalities,
    `parameters` the values in them. `reference` maps states to the desired final values; may be
    empty. `system`: whose trajectories they are; None for those of a file.
    """

    def __init__(
        self,
        dataset: xr.Dataset | NamedArrays,
        scene: tuple[Shape, ...] = (),
        parameters: Mapping[str, float] | None = None,
        reference: Mapping[str, float] | None = None,
        system: System | None = None,
    ) -> None:
        self._kept = dataset
        self.scene = scene
        self.parameters = parameters
        self.reference = reference
        self.system = system

    def __repr__(self) -> str:
        counts = ", ".join(f"{n} {label}" for label, n in self.outcomes.items() if n)
        return f"<Result of {self.arrays.sizes['run']} runs: {counts}>"

    @property
    def dataset(self) -> xr.Dataset:
        """The trajectories as an xarray dataset, made when it is first asked for."""
        if isinstance(self._kept, NamedArrays):
            self._kept = self._kept.dataset()
        return self._kept

    @property
    def arrays(self) -> NamedArrays:
        """The same trajectories as plain arrays, which need no xarray."""
        stored = self._kept
        return stored if isinstance(stored, NamedArrays) else NamedArrays.of(stored)

    @property
    def outcomes(self) -> dict[str, int]:
        """The number of runs with each outcome, by its label."""
        counts = np.bincount(self.arrays["outcome"].values, minlength=len(Outcome))
        first = (Outcome.REACHED, Outcome.STAYED, Outcome.CHATTERED, Outcome.OFF_GRID)
        order = (*first, *(o for o in Outcome if o not in first))
        return {o.label: int(counts[o]) for o in order}

    @property
    def viable(self) -> int:
        """The number of runs that never left the region."""
        values = self.arrays["outcome"].values
        outcomes = (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED, Outcome.OFF_GRID)
        return int(np.isin(values, outcomes).sum())

    @property
    def success_fraction(self) -> float | None:
        """The share of runs that reached the goal without leaving the region; None: no goal."""
        runs = int(self.arrays.sizes["run"])
        if not self.arrays.attrs.get("goal") or not runs:
            return None
        return self.outcomes[Outcome.REACHED.label] / runs

    def summary(self) -> dict[str, Any]:
        """The statistics of summary.json; NaN appears as None."""
        data = self.arrays
        return {
            "scenario": data.attrs.get("scenario", ""),
            "kind": data.attrs.get("kind", "closed-loop"),
            "version": data.attrs["holdfast_version"],
            "seed": int(data.attrs["seed"]),
            "runs": int(data.sizes["run"]),
            "viable": self.viable,
            "no_rest": data.attrs.get("no_rest"),
            "outcomes": self.outcomes,
            "success_fraction": self.success_fraction,
            "worst_constraint": _largest(data, "worst_constraint") if data.sizes["run"] else {},
            "in_goal_since": self._goal_times(),
            "switching": self._switching(),
            "safeguard": self._safeguard(),
            "vertices": self._vertices(),
            "final_error": self._final_error(),
            "peak_input": _largest(data, "peak_input"),
            "peak_actuator": _largest(data, "peak_actuator"),
            "wall_time_s": round(float(data.attrs["wall_time_s"]), 3),
        }

    def _goal_times(self) -> dict[str, float | None]:
        """Settling times [s]: when the runs that end in the goal entered it for the last time."""
        since = self.arrays["goal_time"].values
        since = since[np.isfinite(since)]
        return {
            "median": float(np.median(since)) if since.size else None,
            "worst": float(since.max()) if since.size else None,
        }

    def _switching(self) -> dict[str, float | None]:
        """Changes of mode a minute and the shortest time in one mode [s]; {} for one mode."""
        data = self.arrays
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
        data = self.arrays
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
        data = self.arrays
        names = json.loads(data.attrs.get("vertices", "[]"))
        if not names:
            return []
        columns = [str(n) for n in data["varied_name"].values]
        values = data["varied"].values[:, [columns.index(n) for n in names]]
        outcome, infeasible = data["outcome"].values, data["infeasible"].values
        viable = np.isin(outcome, (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED))
        vertices = []
        for vertex in np.unique(values, axis=0):
            mine = (values == vertex).all(axis=1)
            vertices.append(
                {
                    "at": {n: float(v) for n, v in zip(names, vertex, strict=True)},
                    "runs": int(mine.sum()),
                    "viable": int(viable[mine].sum()),
                    "reached": int((outcome[mine] == Outcome.REACHED).sum()),
                    "runs_relaxed": int((infeasible[mine] > 0).sum()),
                    "samples_relaxed": int(infeasible[mine].sum()),
                    "worst_constraint": _largest(data, "worst_constraint", mine),
                }
            )
        return vertices

    def final_errors(self) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        """The final error from the reference by state, shape (runs,); NaN where a run diverged."""
        errors = {}
        names = [str(n) for n in self.arrays["state_name"].values]
        for name, value in (self.reference or {}).items():
            column = names.index(name)
            final = self.arrays["state"].values[:, -1, column] - value
            if self.arrays["state_is_angle"].values[column]:
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
        stored = self._kept
        if isinstance(stored, NamedArrays):
            return write_arrays(stored, path)
        return write_netcdf(stored, path)


def _largest(data: NamedArrays, name: str, runs: Truths | None = None) -> dict[str, float | None]:
    """The largest value over the runs, by the name of its column; None if there is none."""
    variable = data[name]
    values = variable.values if runs is None else variable.values[runs]
    names = data[variable.dims[1]].values
    worst = np.fmax.reduce(values, axis=0)
    return {str(n): float(v) if np.isfinite(v) else None for n, v in zip(names, worst, strict=True)}


@checked
def station_statistics(
    result: Result, radius: float, *, settled: float, heading: float = 0.1
) -> Dataset:
    """Statistics of every run of a station-keeping simulation, on its recorded samples.

    radius [m]: of the ball |(x, y)| <= radius to enter. settled [s]: the start of the tail. heading
    [rad]: the tolerance of the heading around 0.

    Variables over `run`:

    entered, entry_time [s]: of the first time in the ball (NaN: never). tail_radius [m]:
    the largest distance after `settled`. overshoot [m]: the largest distance beyond the ball after
    entering. heading_share: of the samples after `settled`, those with |psi| < heading.
    switches_per_minute, mean_dwell [s], shortest_dwell [s] (infinite for fewer than two changes
    of mode). A run that diverged has an infinite tail.

    Raises `SimulationError` for a radius or heading that is not positive, if the result has no
    x, y, psi, or no samples after `settled`.

    >>> drifting = hf.systems.drifting_unicycle()
    >>> law = hf.laws.hold_station(drifting)
    >>> run = hf.simulate(drifting, law, starts=[[1.0, 0, 0]], horizon=10.0)
    >>> hf.station_statistics(run, 0.1, settled=5.0)["tail_radius"].values.round(2)
    array([0.15])
    """
    import xarray as xr

    for what, value in (("radius", radius), ("heading", heading)):
        if not (np.isfinite(value) and value > 0):
            raise SimulationError(f"the {what} is {value}", expected="above 0")
    data = result.dataset
    names = [str(n) for n in data["state_name"].values]
    missing = [n for n in ("x", "y", "psi") if n not in names]
    if missing:
        raise SimulationError(f"the result has no state '{missing[0]}'", expected="x, y and psi")
    time = data["time"].values
    tail = time >= settled
    if not tail.any():
        raise SimulationError(
            f"the tail begins at {settled:g} s, the runs end at {time[-1]:g} s",
            expected="an earlier time",
        )
    state = data["state"].values
    x, y, psi = (state[:, :, names.index(n)] for n in ("x", "y", "psi"))
    distance = np.where(np.isfinite(x + y), np.hypot(x, y), np.inf)
    inside = distance <= radius
    entered = inside.any(axis=1)
    first = np.where(entered, inside.argmax(axis=1), len(time))
    after = np.arange(len(time)) >= first[:, None]
    turned = np.abs((psi + np.pi) % (2 * np.pi) - np.pi)
    switches = data["switches"].values
    beyond = np.where(after, distance - radius, -np.inf).max(axis=1)
    columns = {
        "entered": (entered, "1"),
        "entry_time": (np.where(entered, time[np.minimum(first, len(time) - 1)], np.nan), "s"),
        "tail_radius": (distance[:, tail].max(axis=1), "m"),
        "overshoot": (np.where(entered, np.maximum(beyond, 0.0), np.nan), "m"),
        "heading_share": ((turned[:, tail] < heading).mean(axis=1), "1"),
        "switches_per_minute": (60.0 * switches / time[-1], "1/min"),
        "mean_dwell": (time[-1] / (switches + 1), "s"),
        "shortest_dwell": (data["shortest_dwell"].values, "s"),
    }
    return xr.Dataset(
        {name: ("run", values, {"units": unit}) for name, (values, unit) in columns.items()},
        {"run": data["run"].values},
    )
