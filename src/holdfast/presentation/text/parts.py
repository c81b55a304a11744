"""A set that is put together, and its closed-loop validation, as a few lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from holdfast.analysis.decomposition.parts_promise import PartsPromise
from holdfast.analysis.decomposition.parts_value import PartsValue


def parts_text(
    title: str, value: PartsValue, promise: PartsPromise | None, files: Sequence[Path] = ()
) -> str:
    """The parts and the verdict, the march of each part, the promise, the files."""
    lines = [title, ""]
    lines += [f"  {line}" for line in value.decomposition.lines()]
    for solved in (s for parts in value.parts for s in parts):
        report, grid = solved.value.report, solved.value.grid
        shape = " x ".join(str(a.count) for a in grid.axes)
        kind = report.kind.replace("-", " ")
        done = "for ever" if report.converged else f"for {report.horizon_s:g} s"
        lines += [
            "",
            f"  part           {', '.join(solved.value.names)}: {kind}, {done}",
            f"  grid           {shape} = {grid.nodes:,} nodes",
            f"  the set        {_set(solved.value.fraction())}",
            f"  march          {report.steps:,} steps, {report.scheme}, {report.wall_time_s:.1f} s",
        ]
        if report.ends_reached:
            lines.append(f"  touches        {report.ends_reached}: may depend on extrapolation")
    if promise is not None:
        lines += ["", *_promise(promise)]
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _set(share: float) -> str:
    return f"{100 * share:.3g} % of the grid's box" if share else "empty"


def _promise(promise: PartsPromise) -> list[str]:
    held = f"for {promise.horizon:g} s, with inputs held for {1000 * promise.sample_time:g} ms"
    found = [
        f"  promise        {100 * promise.promised.value:.3g} % of random states of the region are "
        "promised",
        f"    of those more than {promise.margin:g} inside, {promise.inside.count:,} of "
        f"{promise.inside.total:,} stay {held}",
    ]
    if promise.edge is not None:
        found.append(
            f"    of the others that are promised, {promise.edge.count:,} of "
            f"{promise.edge.total:,} stay"
        )
    if promise.outside is not None:
        found.append(
            f"    of those that are not promised the same law keeps "
            f"{promise.outside.count:,} of {promise.outside.total:,}"
        )
    found.append(f"    {promise.conclusion}")
    return found
