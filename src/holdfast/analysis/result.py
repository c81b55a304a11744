"""The result of a simulation: an xarray dataset with names, units and outcomes."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from holdfast.errors import OutputError
from holdfast.execution.closed_loop import Outcome, Trajectories
from holdfast.execution.settings import Settings
from holdfast.execution.translate import ClosedLoopProgram

if TYPE_CHECKING:
    from holdfast.maths.quantity import Quantity
    from holdfast.maths.scene import Shape

NO_CONSTRAINT = -1
NAMED_AXES = ("state", "input", "actuator", "signal", "constraint", "varied")


@dataclass(frozen=True)
class Result:
    """Trajectories as `dataset`, the shapes to draw, and the reference state for errors.

    `scene` are the region's and the goal's shapes, `parameters` the values in them.
    `reference` maps states to the values the run is meant to end at; may be empty.
    """

    dataset: xr.Dataset
    scene: tuple[Shape, ...] = ()
    parameters: Mapping[str, float] | None = None
    reference: Mapping[str, float] | None = None

    @property
    def outcomes(self) -> dict[str, int]:
        """How many runs ended in each way, by the outcome's label."""
        counts = np.bincount(self.dataset["outcome"].values, minlength=len(Outcome))
        return {
            o.label: int(counts[o])
            for o in (
                Outcome.REACHED,
                Outcome.STAYED,
                Outcome.CHATTERED,
                Outcome.LEFT,
                Outcome.DIVERGED,
            )
        }

    @property
    def viable(self) -> int:
        """How many runs never left the region."""
        values = self.dataset["outcome"].values
        kept = (Outcome.STAYED, Outcome.REACHED, Outcome.CHATTERED)
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
            "final_error": self._final_error(),
            "peak_input": _by_name(data["peak_input"].max("run")),
            "peak_actuator": _by_name(data["peak_actuator"].max("run")),
            "wall_time_s": round(float(data.attrs["wall_time_s"]), 3),
        }

    def _goal_times(self) -> dict[str, float | None]:
        """Since when the runs that end in the goal are in it [s]."""
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

    def _final_error(self) -> dict[str, dict[str, float | None]]:
        errors: dict[str, dict[str, float | None]] = {}
        for name, value in (self.reference or {}).items():
            final = self.dataset["state"].sel(state_name=name).isel(time=-1).values - value
            if bool(self.dataset["state_is_angle"].sel(state_name=name)):
                final = (final + np.pi) % (2 * np.pi) - np.pi
            size = np.abs(final[np.isfinite(final)])
            # a run that diverged has no final state: then there is no worst one either
            errors[name] = {
                "median": float(np.median(size)) if size.size else None,
                "worst": float(size.max()) if size.size == final.size else None,
            }
        return errors

    def save(self, path: str | Path) -> Path:
        """Write NetCDF-4, atomically: the file appears whole under its name or not at all.

        Raises `OutputError` when the folder cannot be written.
        """
        path = Path(path)
        encoding: dict[str, dict[str, Any]] = {}
        for name, variable in self.dataset.variables.items():
            if variable.dtype.kind == "U":
                encoding[str(name)] = {"dtype": "S1"}  # characters, which MATLAB reads too
            elif variable.ndim >= 2:
                encoding[str(name)] = {"zlib": True, "complevel": 1, "shuffle": True}
        with atomic_file(path) as partial:
            self.dataset.to_netcdf(partial, engine="netcdf4", format="NETCDF4", encoding=encoding)
        return path


def _by_name(values: xr.DataArray) -> dict[str, float | None]:
    (dimension,) = values.dims
    return {
        str(name): float(value) if np.isfinite(value) else None
        for name, value in zip(values[f"{dimension}_name"].values, values.values, strict=True)
    }


class atomic_file:
    """Context manager: a temporary path beside `path`, renamed to it on success only."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> Path:
        try:
            handle, name = tempfile.mkstemp(
                dir=self.path.parent, prefix=f".{self.path.name}.", suffix=".partial"
            )
        except OSError as error:
            raise OutputError(
                f"{self.path} cannot be written ({error.strerror})",
                remedy="choose another folder with --out",
            ) from None
        os.close(handle)
        self.partial = Path(name)
        return self.partial

    def __exit__(self, kind: object, problem: object, trace: object) -> None:
        if kind is not None:
            self.partial.unlink(missing_ok=True)
            return
        self.partial.chmod(0o666 & ~_umask())
        try:
            os.replace(self.partial, self.path)
        except OSError as error:
            self.partial.unlink(missing_ok=True)
            raise OutputError(
                f"{self.path} cannot be written ({error.strerror})",
                remedy="choose another folder with --out",
            ) from None


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current


def to_dataset(
    program: ClosedLoopProgram,
    trajectories: Trajectories,
    settings: Settings,
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """Names, units and meanings around the arrays of a batch of runs."""
    s, names = trajectories, [c[0] for c in program.constraints]
    exits = [NO_CONSTRAINT, *range(len(names))]

    def meanings(
        array: np.ndarray[Any, Any], values: Sequence[int], words: Sequence[str], text: str
    ) -> dict[str, Any]:
        return {
            "long_name": text,
            "flag_values": np.array(values, dtype=array.dtype),
            "flag_meanings": " ".join(w.replace(" ", "_") for w in words),
        }

    def named(text: str, names: Sequence[str], units: Sequence[str]) -> dict[str, str]:
        return {"long_name": text, "names": ", ".join(names), "units": ", ".join(units)}

    variables: dict[str, Any] = {
        "state": (("run", "time", "state"), s.state, named("state", *_columns(program.states))),
        "input": (
            ("run", "time", "input"),
            s.input,
            named("input after saturation", *_columns(program.inputs)),
        ),
        "actuator": (
            ("run", "time", "actuator"),
            s.actuator,
            {"long_name": "actuator value", "units": program.actuator_unit},
        ),
        "mode": (
            ("run", "time"),
            s.mode,
            meanings(s.mode, range(len(program.modes)), program.modes, "mode of the law"),
        ),
        "signal": (
            ("run", "time", "signal"),
            s.signal,
            {"long_name": "signal of the law", "names": ", ".join(program.signals)},
        ),
        "constraint": (
            ("run", "time", "constraint"),
            s.constraint,
            named("constraint, safe where <= 0", names, [c[1] for c in program.constraints]),
        ),
        "outcome": (
            ("run",),
            s.outcome,
            meanings(s.outcome, list(Outcome), [o.label for o in Outcome], "how the run ended"),
        ),
        "exit_time": (
            ("run",),
            s.exit_time,
            {"units": "s", "long_name": "time of leaving the region, chattering or diverging"},
        ),
        "exit_constraint": (
            ("run",),
            s.exit_constraint,
            meanings(s.exit_constraint, exits, ["none", *names], "first constraint violated"),
        ),
        "goal_time": (
            ("run",),
            s.goal_time,
            {"units": "s", "long_name": "since when the run is in the goal at its end"},
        ),
        "worst_constraint": (
            ("run", "constraint"),
            s.worst,
            {"long_name": "largest value over all of time"},
        ),
        "peak_input": (("run", "input"), s.peak_input, {"long_name": "largest magnitude"}),
        "peak_actuator": (
            ("run", "actuator"),
            s.peak_actuator,
            {"long_name": "largest magnitude", "units": program.actuator_unit},
        ),
        "switches": (("run",), s.switches, {"long_name": "changes of mode"}),
        "shortest_dwell": (
            ("run",),
            s.shortest_dwell,
            {"units": "s", "long_name": "shortest time between two changes of mode"},
        ),
        "varied": (("run", "varied"), s.varied, {"long_name": "what differs from run to run"}),
        "rejected_steps": (("run",), s.rejected, {"long_name": "adaptive steps refused"}),
        "state_is_angle": (("state",), np.array([q.angle for q in program.states], dtype=np.int8)),
    }
    coordinates = {
        "time": ("time", s.time, {"units": "s", "long_name": "time"}),
        "run": np.arange(len(s.outcome), dtype=np.int32),
        "state_name": ("state", _labels([q.name for q in program.states])),
        "input_name": ("input", _labels([q.name for q in program.inputs])),
        "actuator_name": ("actuator", _labels(program.actuators)),
        "signal_name": ("signal", _labels(program.signals)),
        "constraint_name": ("constraint", _labels(names)),
        "state_unit": ("state", _labels([q.unit for q in program.states])),
        "state_description": ("state", _labels([q.description or q.name for q in program.states])),
        "input_unit": ("input", _labels([q.unit for q in program.inputs])),
        "input_description": ("input", _labels([q.description or q.name for q in program.inputs])),
        "constraint_unit": ("constraint", _labels([c[1] for c in program.constraints])),
        "varied_name": ("varied", _labels(program.varied.labels)),
    }
    fixed = {
        "Conventions": "CF-1.11",
        "sample_time_s": settings.sample_time,
        "tolerance": settings.tolerance,
        "seed": settings.seed if settings.seed < 2**63 else str(settings.seed),
    }
    return indexed(xr.Dataset(variables, coordinates, {**fixed, **attributes}))


def _columns(quantities: Sequence[Quantity]) -> tuple[list[str], list[str]]:
    return [q.name for q in quantities], [q.unit for q in quantities]


def indexed(dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with `.sel(state_name="x")` and the like."""
    for axis in NAMED_AXES:
        if f"{axis}_name" not in dataset:  # a result of an older version
            continue
        dataset = dataset.set_xindex(f"{axis}_name")
    return dataset


def load(path: str | Path) -> Result:
    """A saved result, without the shapes to draw; `OutputError` if it is not one of ours."""
    try:
        dataset = xr.load_dataset(path, engine="netcdf4")
    except (OSError, ValueError) as error:
        raise OutputError(f"{path} cannot be read as NetCDF ({error})") from None
    if "holdfast_version" not in dataset.attrs:
        raise OutputError(f"{path} was not written by holdfast")
    parameters, reference = (json.loads(dataset.attrs[n]) for n in ("parameters", "reference"))
    return Result(indexed(dataset), parameters=parameters, reference=reference)


def _labels(names: Any) -> np.ndarray[Any, Any]:
    return np.array(list(names), dtype=str) if len(names) else np.array([], dtype="<U1")
