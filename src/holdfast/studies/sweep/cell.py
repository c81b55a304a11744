"""One part of a sweep's cell: the work of a process, local or on a cluster."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.analysis.simulation.aggregates import Entry, as_table
from holdfast.errors import GainWarning, HoldfastError, ScenarioError
from holdfast.execution.cache import code_digest
from holdfast.scenario.files import overridden
from holdfast.scenario.kinds.base import Composed
from holdfast.scenario.load import scenario_of


@dataclass(frozen=True)
class Part:
    """The runs first..last-1 of the scenario of these tables, with the settings of a cell.

    last = 0: the scenario is not a batch of runs. code: the digest of the requesting holdfast;
    threads: 0 for one per core.
    """

    file: str
    tables: Mapping[str, Any]
    settings: tuple[str, ...]
    runs: int | None
    seed: int | None
    first: int
    last: int
    threads: int
    code: str


_one_at_a_time = threading.Lock()  # threads of a process would share its cores and warnings
_last: tuple[object, Composed] | None = None


def run_part(part: Part) -> dict[str, Any]:
    """{"numbers": a tally as lists, "note": warnings} or {"refused": why}.

    The key "failed" marks a failure, which may not recur, in contrast to a refusal. Raises
    `ScenarioError` if the request comes from another version of holdfast.
    """
    if part.code != code_digest():
        raise ScenarioError(
            "a process of the cluster has another version of holdfast",
            remedy="install the same version everywhere",
        )
    with _one_at_a_time, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            numbers = _numbers(part)
        except HoldfastError as error:
            return {"refused": str(error)}
        except Exception as error:  # a failing cell must not end the others
            return {"refused": f"{type(error).__name__}: {error}", "failed": True}
    said = [str(w.message) for w in heard if issubclass(w.category, GainWarning)]
    return {"numbers": as_table(numbers), "note": "; ".join(dict.fromkeys(said))}


def _numbers(part: Part) -> dict[str, Entry]:
    runs = range(part.first, part.last) if part.last else None
    return _composed(part).tally(runs, part.threads)


def _composed(part: Part) -> Composed:
    """The scenario; the last one is kept, for the next part of the same cell."""
    global _last
    asked = (part.file, repr(part.tables), part.settings, part.runs, part.seed)
    if _last is None or _last[0] != asked:
        _, tables = overridden("", dict(part.tables), part.settings)
        _last = asked, scenario_of(part.file, "", tables, part.runs, part.seed)
    return _last[1]
