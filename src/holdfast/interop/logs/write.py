"""A log as a table that `read_log` reads: CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from holdfast.analysis.identification.log import Log
from holdfast.arguments import checked
from holdfast.errors import OutputError


@checked
def write_log(log: Log, path: str | Path) -> Path:
    """Write the states and inputs of a log as CSV, in SI units, with a column `time` [s].

    A row for every time of any signal; a signal that has no value then has an empty place. Times
    and values are written in full. Reading counts the time from the first row on, and makes the
    repairs that a measurement needs. Raises `OutputError` for a file that exists or cannot be
    written, and for a signal that is called `time`.
    """
    path, signals = Path(path), {**log.states, **log.inputs}
    if "time" in signals:
        raise OutputError("a signal is called 'time'", expected="another name")
    times = np.unique(np.concatenate([np.zeros(0), *(s.time for s in signals.values())]))
    frame = pd.DataFrame({"time": times})
    for name, signal in signals.items():
        column = np.full(len(times), np.nan)
        column[np.searchsorted(times, signal.time)] = signal.value
        frame[name] = column
    try:
        frame.to_csv(path, index=False, mode="x")
    except FileExistsError:
        raise OutputError(f"{path} exists already", remedy="choose another file") from None
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror or error})") from None
    return path
