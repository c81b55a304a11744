"""The records and the last numbers of runs, to the arrays of a result."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.simulation.block_numbers import Whole
from holdfast.execution.simulation.layout import Layout
from holdfast.execution.simulation.outcomes import Outcome
from holdfast.execution.simulation.trajectories import Trajectories

NOTES = {
    "exit_time": "exit_time", "exit_constraint": "exit_constraint", "switches": "switches",
    "shortest_dwell": "shortest", "overruled": "overrules", "infeasible": "infeasible",
    "largest_slack": "largest_slack", "rejected": "rejected", "off_grid": "off_at",
}  # fmt: skip
"""Arrays of the result, with the rows that they come from."""

NOTED = ("outcome", "inside_since", *NOTES.values(), "worst", "peaks", "beyond")
"""The rows that are read at the end of a run."""


def write_records(
    out: Trajectories,
    layout: Layout,
    log: Array,
    done: Whole,
    runs: slice,
    recorded: int,
    *,
    safeguarded: bool,
) -> None:
    """Records from the number `recorded` on.

    log: (block, record, row, lane), of which the first `done` of each block are there; the others,
    and those of lanes that have ended, are NaN.
    """
    many, count = runs.stop - runs.start, log.shape[1]
    alive = log[:, :, 0] != 0.0
    alive &= (np.arange(count) < done[:, np.newaxis])[:, :, np.newaxis]
    alive = alive.transpose(0, 2, 1).reshape(-1, count)[:many]
    ended = None if alive.all() else ~alive
    place = runs, slice(recorded, recorded + count)

    def of(name: str) -> Array:
        """(run, record, row)"""
        rows = log[:, :, layout.records[name]]
        found = rows.transpose(0, 3, 1, 2).reshape(-1, count, rows.shape[2])[:many]
        if ended is not None:
            found[ended] = np.nan
        return found

    for name in layout.records:
        if name in ("alive", "mode", "safeguard", "sample_slack"):
            continue
        getattr(out, name)[place] = of(name)
    mode = of("mode")[:, :, 0]
    out.mode[place] = mode if ended is None else np.where(ended, -1.0, mode)
    if safeguarded:
        slack = of("sample_slack")[:, :, 0]
        answer = np.where(slack > 0.0, 2.0, of("safeguard")[:, :, 0])
        out.sample_slack[place] = slack
        out.safeguard[place] = answer if ended is None else np.where(ended, -1.0, answer)


def write_notes(
    out: Trajectories, rows: Mapping[tuple[str, int], Array], runs: slice, inputs: int
) -> None:
    """What is known of each run at its end. rows[name, k]: the k-th row of a quantity, by run."""
    outcome, since = rows["outcome", 0].copy(), rows["inside_since", 0]
    outcome[(outcome == Outcome.STAYED) & ~np.isnan(since)] = Outcome.REACHED
    out.outcome[runs] = outcome
    out.goal_time[runs] = np.where(outcome == Outcome.DIVERGED, np.nan, since)
    for name, of in NOTES.items():
        getattr(out, name)[runs] = rows[of, 0]
    for array, of, before in (
        (out.worst, "worst", 0), (out.peak_input, "peaks", 0),
        (out.peak_actuator, "peaks", inputs), (out.beyond, "beyond", 0),
    ):  # fmt: skip
        for i in range(array.shape[1]):
            array[runs, i] = rows[of, before + i]
