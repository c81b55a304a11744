"""Sets of states as a few lines of text for the terminal, and where systems rest.

Of a value function, or of a set that is put together, what its closed-loop validation came to.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from holdfast.analysis.decomposition.parts_law import PartsPromise
from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.analysis.safety.equilibria import RestingState
from holdfast.analysis.safety.promise import Promise, Trials


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
        lines += ["", *_parts_promise(promise)]
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _set(share: float) -> str:
    return f"{100 * share:.3g} % of the grid's box" if share else "empty"


def _parts_promise(promise: PartsPromise) -> list[str]:
    held = f"for {promise.horizon:g} s, with inputs held for {1000 * promise.sample_time:g} ms"
    lines = [
        f"  promise        {100 * promise.promised.value:.3g} % of random states of the region are "
        "promised",
        f"    of those more than {promise.margin:g} inside, {promise.inside.count:,} of "
        f"{promise.inside.total:,} stay {held}",
    ]
    if promise.edge is not None:
        lines.append(
            f"    of the others that are promised, {promise.edge.count:,} of "
            f"{promise.edge.total:,} stay"
        )
    if promise.outside is not None:
        lines.append(
            f"    of those that are not promised the same law keeps "
            f"{promise.outside.count:,} of {promise.outside.total:,}"
        )
    lines.append(f"    {promise.conclusion}")
    return lines


def resting_text(
    title: str, states: Sequence[RestingState], units: Mapping[str, str], drawn: bool, file: Path
) -> str:
    """How many disturbances leave a place at rest, the least margin and that place, the file."""
    held = [f for f in states if f.exists]
    lines = [title, ""]
    if drawn:
        share = 100.0 * len(held) / len(states)
        lines.append(
            f"  at rest        in {len(held)} of {len(states)} drawn disturbances ({share:.1f} %)"
        )
    lost = [f for f in states if not f.exists]
    if lost:
        best = max(lost, key=lambda f: f.margin)
        lines += ["  no place       in " + best.words(units), f"  because        {best.missing}"]
    if held:
        least = min(held, key=lambda f: f.margin)
        lines += [
            f"  {'least margin' if drawn else 'margin':<15}{least.margin:.3g} (m, rad: the units "
            "of the constraints)",
            f"  {'in':<15}{least.words(units)}",
            "",
            "  at rest at",
        ]
        for name, value in (*least.state.items(), *least.inputs.items()):
            lines.append(f"    {name:<13}{_tidy(value)} {units[name]}")
    lines.append(f"  files in {file.parent}: {file.name}")
    return "\n".join(lines)


def _tidy(value: float) -> str:
    return "0" if abs(value) < 1e-9 else f"{value:.4g}"


def value_text(
    value: ValueFunction,
    promise: Promise | None = None,
    begun: ValueFunction | None = None,
    files: Sequence[Path] = (),
    *,
    untried: str = "",
) -> str:
    """The set, the march, the error estimates, the closed-loop validation, the files.

    begun: the initial value function of the march, for the share that remains of it.
    untried: why there is no validation.
    """
    report = value.report
    axes = value.grid.axes
    kind = report.kind.replace("-", " ")
    lines = [report.title or f"{kind} of {report.region}", ""]
    shape = " x ".join(str(a.count) for a in axes)
    lines.append(f"  {kind} of {report.region}, {_until(value)}")
    lines.append(
        f"  grid           {shape} = {value.grid.nodes:,} nodes over " + ", ".join(value.names)
    )
    share = value.fraction()
    text = f"{100 * share:.3g} % of the grid's box"
    if begun is not None and (first := begun.fraction()) > 0:
        name, ratio = begun.report.region, share / first
        text += f", {100 * ratio:.3g} % of {name}" if ratio < 2 else f", {ratio:.3g} times {name}"
    text += f"; {report.approximation}" if report.approximation else ""
    lines.append(f"  the set        {'empty' if report.empty else text}")
    if not report.empty:
        ends = value.extent()
        lines.append(
            "  reaches        "
            + ", ".join(
                " ".join([a.name, _range(*ends[a.name]), _unit(a.state.unit)]).rstrip()
                for a in axes
            )
        )
    if report.approximation and not report.empty:
        lines.append(
            "                 states beyond it may be reached as well: outer() bounds them"
        )
    lines.append(f"  converged      {_converged(value)}")
    if report.ends_reached:
        lines.append(f"  touches        {report.ends_reached}: may depend on extrapolation")
    if report.disputed_share:
        disputed = f"{100 * report.disputed_share:.2g} % of the set"
        lines.append(f"  disputed       {disputed}: won by a scheme of first order alone")
    lines += [f"  {name:<15}{shown}" for name, shown in _worth(value)]
    lines.append(
        f"  march          {report.steps:,} steps, {report.scheme}, order {report.order}, "
        f"{report.precision}, {report.wall_time_s:.1f} s"
    )
    if promise is not None:
        lines += ["", *_promise(promise)]
    elif untried:
        lines += ["", f"  promise        none: {untried}"]
    if files:
        folder = files[0].parent
        lines += ["", f"  files in {folder}: " + ", ".join(f.name for f in files)]
    return "\n".join(lines)


def _range(low: float, high: float) -> str:
    return f"{low:.3g} to {high:.3g}"


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _until(value: ValueFunction) -> str:
    report = value.report
    return "for ever" if report.converged else f"for {report.horizon_s:g} s"


def _converged(value: ValueFunction) -> str:
    report = value.report
    if report.empty:
        return f"yes: empty after {report.reached_s:.3g} s"
    cells = report.residual_cells
    left = "" if cells is None else f"residual {cells:.2g} cells"
    if report.converged:
        return f"yes: after {report.reached_s:.3g} s, {left or 'no node changes any more'}"
    return (
        f"no: {left or 'some nodes still change'} at {report.horizon_s:g} s; the set is valid for "
        "that horizon only"
    )


def _worth(value: ValueFunction) -> list[tuple[str, str]]:
    """The results of further marches on the error of the answer, if they were requested."""
    report = value.report
    unit = report.value_unit
    rows = []
    if report.error_largest is not None:
        shown = f"V up to {report.error_largest:.2g} {unit}, by a coarser grid"
        rows.append(("error", shown.replace(" 1,", ",")))
        rows.append(("boundary", _boundary_error(value)))
    if report.inner_cells is not None:
        rows.append(("inner", f"eroded by {report.inner_cells} cells, the estimated error"))
    if report.nodes_from_outside is not None:
        rows.append(("extrapolation", f"{report.nodes_from_outside:,} nodes depend on it"))
    return rows


def _boundary_error(value: ValueFunction) -> str:
    """How far off the boundary may be, along every axis in its unit."""
    report = value.report
    jumps = "; V jumps there" if report.jumps else ""
    if not report.boundary_error:
        return f"not known: the grids differ too much{jumps}"
    units = {a.name: _unit(a.state.unit) for a in value.grid.axes}
    lengths = ", ".join(
        f"{name} {size:.2g} {units[name]}".rstrip() for name, size in report.boundary_error.items()
    )
    return f"off by up to {lengths} ({report.error_reach} cells){jumps}"


def _promise(promise: Promise) -> list[str]:
    lines = [
        f"  promise        {promise.law}, held for {1000 * promise.sample_time:g} ms, over "
        f"{promise.horizon:g} s, from random states",
        f"    at least {promise.depth} inside, as {100 * promise.share:.3g} % of the set are",
    ]
    lines += [f"      {_trials(t, promise)}" for t in promise.inside]
    for layer in promise.layers:
        lines.append(f"    {layer.where}, as {100 * layer.share:.3g} % of the set are")
        lines.append(f"      {_trials(layer.trials, promise)}")
    if promise.outside is not None:
        lines.append(f"    at least {promise.depth_outside} outside, in the region")
        lines.append(f"      {_trials(promise.outside, promise)}")
    beaten = Counter((b.by, b.outcome) for b in promise.beaten)
    lines += [
        f"    {count} first beaten by {by}: {outcome}" for (by, outcome), count in beaten.items()
    ]
    lines.append(f"    {promise.conclusion}")
    return lines


def _trials(trials: Trials, promise: Promise) -> str:
    low, high = trials.kept.interval
    text = (
        f"against {trials.what + ':':<38} {trials.kept.count} of {trials.kept.total} "
        f"{promise.aim} ({low:.3f} to {high:.3f})"
    )
    if math.isfinite(trials.excursion):
        text += f", worst constraint {trials.excursion:+.4f}"
        text += "" if promise.unit == "1" else f" {promise.unit}"
    if trials.off_grid:
        text += f", {trials.off_grid} left the grid"
    return text
