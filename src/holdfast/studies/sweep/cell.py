"""One part of a sweep's cell: the work of a process, local or on a cluster."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from holdfast.analysis.simulation.aggregates import Entry, as_table, tally_of
from holdfast.errors import GainWarning, HoldfastError, ScenarioError
from holdfast.scenario.files import code_digest, overridden
from holdfast.scenario.kernel import KernelResult, KernelScenario
from holdfast.scenario.load import Scenario, scenario_of


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
_last: tuple[object, Scenario | KernelScenario] | None = None


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
    scenario = _composed(part)
    if isinstance(scenario, KernelScenario):
        return kernel_tally(scenario, scenario.run())
    settings = {**scenario.settings, "threads": part.threads}
    if not part.last:
        return tally_of(replace(scenario, settings=settings).run())
    settings["record_every"] = settings["horizon"]  # only the end points
    runs = range(part.first, part.last)
    return tally_of(replace(scenario, settings=settings).run(part=runs))


def _composed(part: Part) -> Scenario | KernelScenario:
    """The scenario; the last one is cached, for the next part of the same cell."""
    global _last
    asked = (part.file, repr(part.tables), part.settings, part.runs, part.seed)
    if _last is None or _last[0] != asked:
        _, tables = overridden("", dict(part.tables), part.settings)
        _last = asked, scenario_of(part.file, "", tables, part.runs, part.seed)
    return _last[1]


def kernel_tally(scenario: KernelScenario, result: KernelResult) -> dict[str, Entry]:
    """The size of the set, the convergence of the march, and the result of the validation."""
    said = result.value.dataset.attrs
    known = (
        ("fraction", result.value.fraction(), "1", "share of the grid in the set"),
        ("volume", result.value.volume(), "1", "volume of the set"),
        ("answered", result.answers(scenario), "1", "1 where the requested set was found"),
        ("converged", said["converged"], "1", "1 where nothing changes any more"),
        ("reached", said["reached_s"], "s", "time marched"),
    )
    found = {name: Entry("most", float(v), 0.0, unit, says) for name, v, unit, says in known}
    for k, trials in enumerate(result.promise.inside if result.promise else ()):
        says = f"share kept inside the set against {trials.what}"
        found[f"kept_{k}"] = Entry("share", trials.kept.count, trials.kept.total, "1", says)
    return found
