"""Statistics of station keeping: one number for each run and criterion of chapter 3."""

from __future__ import annotations

import numpy as np
import xarray as xr

from holdfast.analysis.simulation.result import Result
from holdfast.arguments import checked
from holdfast.errors import SimulationError


@checked
def station_statistics(
    result: Result, radius: float, *, settled: float, heading: float = 0.1
) -> xr.Dataset:
    """Statistics of every run of a station-keeping simulation, on its recorded samples.

    `radius` [m] is that of the ball |(x, y)| <= radius to enter, `settled` [s] the start of the
    tail, `heading` [rad] the tolerance of the heading around 0. Variables over `run`:

    entered, entry_time [s]: of the first time in the ball (NaN: never). tail_radius [m]:
    the largest distance after `settled`. overshoot [m]: the largest distance beyond the ball after
    entering. heading_share: of the samples after `settled`, those with |psi| < heading.
    switches_per_minute, mean_dwell [s], shortest_dwell [s] (infinite for fewer than two changes
    of mode). A run that diverged has an infinite tail.

    Raises `SimulationError` for a radius or heading that is not positive, if the result has no
    x, y, psi, or no samples after `settled`.
    """
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
