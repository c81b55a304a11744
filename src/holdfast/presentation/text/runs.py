"""Results as a few lines of text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from holdfast.analysis.simulation.files import NamedArrays
from holdfast.analysis.simulation.result import Result

SHOWN_VERTICES = 16


def summary_text(result: Result, files: Sequence[Path] = ()) -> str:
    """The viable runs, the worst constraints, the goal, the peaks, the files."""
    data, summary = result.arrays, result.summary()
    runs = summary["runs"]
    title = data.attrs.get("title") or data.attrs["system"]
    lines = [str(title), ""]
    constraints = [str(n) for n in data["constraint_name"].values]
    if constraints:
        lines.append(f"  viable         {_share(result.viable, runs)}")
    if data.attrs.get("goal"):
        lines.append(f"  reached goal   {_share(summary['outcomes']['reached goal'], runs)}")
    if summary["outcomes"]["chattered"]:
        lines.append(f"  chattered      {_share(summary['outcomes']['chattered'], runs)}")
    if summary["outcomes"]["left grid"]:
        lines.append(f"  left the grid  {_share(summary['outcomes']['left grid'], runs)}")
    if summary["outcomes"]["diverged"]:
        lines.append(f"  diverged       {_share(summary['outcomes']['diverged'], runs)}")
    since = summary["in_goal_since"]
    if since["worst"] is not None:
        lines.append(
            f"  settled after  {since['median']:.3g} s (median), {since['worst']:.3g} s (worst)"
        )
    if switching := summary["switching"]:
        median, worst = switching["median_per_minute"], switching["worst_per_minute"]
        lines.append(f"  mode changes   {median:.3g} a minute (median), {worst:.3g} (worst)")
        if (shortest := switching["shortest_dwell"]) is not None:
            lines.append(f"  shortest dwell {shortest:.3g} s")
    if guard := summary["safeguard"]:
        lines += _safeguard(data, guard)
    lines += _vertices(summary["vertices"], bool(constraints), bool(data.attrs.get("goal")))
    if constraints:
        units = _units(data, "constraint")
        exits = [int((data["exit_constraint"].values == j).sum()) for j in range(len(constraints))]
        lines += ["", "  constraint (safe <= 0)     worst            left by"]
        for (name, worst), left in zip(summary["worst_constraint"].items(), exits, strict=True):
            shown = "not a number" if worst is None else f"{worst:+.4f} {units[name]}"
            lines.append(f"    {name.replace('_', ' '):<22} {shown:<16} {left if left else '-'}")
    if summary["final_error"]:
        lines += ["", "  final error                median       worst"]
        units = _units(data, "state")
        for name, error in summary["final_error"].items():
            median, worst = (
                "-" if error[k] is None else f"{_tidy(error[k])}" for k in ("median", "worst")
            )
            lines.append(f"    {name + ' [' + units[name] + ']':<22} {median:<12} {worst}")
    peaks = summary["peak_actuator"] or summary["peak_input"]
    what = "thrust" if data["actuator"].attrs.get("units") == "N" and peaks else "input"
    if not summary["peak_actuator"]:
        what = "input"
    shown = ", ".join(
        f"{name} {'-' if value is None else format(value, '.3g')}{_unit(result, name)}"
        for name, value in peaks.items()
    )
    lines += ["", f"  peak {what:<10}{shown}"]
    lines.append(f"  simulated in {summary['wall_time_s']:.1f} s, seed {summary['seed']}")
    if files:
        folder = files[0].parent
        lines.append(f"  files in {folder}: " + ", ".join(f.name for f in files))
    return "\n".join(lines)


def _safeguard(data: NamedArrays, guard: dict[str, float]) -> list[str]:
    """Counts of samples and runs in which the filter intervened, or found no admissible input."""

    def counted(what: str) -> str:
        runs = int(guard[f"runs_{what}"])
        return f"{int(guard[f'samples_{what}'])} samples of {runs} run{'s' if runs != 1 else ''}"

    answers = ["an admissible input at every sample"]
    if guard["runs_relaxed"]:
        units = str(data["slack"].attrs["units"]) if "slack" in data else ""
        by = f"{guard['largest_slack']:.3g}" + (f" {units}" if units and "," not in units else "")
        answers = [f"no admissible input at {counted('relaxed')}: relaxed by up to {by}"]
    if "runs_overruled" in guard:
        answers.insert(0, f"overruled the law at {counted('overruled')}")
    return [f"  {'safeguard' if k == 0 else '':<15}{text}" for k, text in enumerate(answers)]


def _vertices(vertices: Sequence[Mapping[str, Any]], constrained: bool, to_goal: bool) -> list[str]:
    """A line for each vertex, those with the fewest viable or successful runs first."""
    if not vertices:
        return []
    worst_first = sorted(vertices, key=lambda v: (v["viable"], v["reached"]))
    lines = ["", f"  of {vertices[0]['runs']} starts at each of {len(vertices)} vertices"]
    for vertex in worst_first[:SHOWN_VERTICES]:
        at = ", ".join(f"{n} {v:.4g}" for n, v in vertex["at"].items())
        counts = [f"viable {vertex['viable']}"] if constrained else []
        counts += [f"reached goal {vertex['reached']}"] if to_goal else []
        if vertex["samples_relaxed"]:
            counts.append(f"no admissible input at {vertex['samples_relaxed']} samples")
        lines.append(f"    {at:<32} " + ", ".join(counts))
    if len(vertices) > SHOWN_VERTICES:
        lines.append(f"    no worse at the {len(vertices) - SHOWN_VERTICES} others (summary.json)")
    return lines


def _share(count: int, total: int) -> str:
    return f"{count} of {total} runs ({100.0 * count / total:.1f} %)"


def _tidy(value: float) -> str:
    return "0" if value < 1e-9 else f"{value:.3g}"


def _unit(result: Result, name: str) -> str:
    data = result.arrays
    if name in data["actuator_name"].values:
        return f" {data['actuator'].attrs['units']}"
    return f" {_units(data, 'input')[name]}"


def _units(data: NamedArrays, axis: str) -> dict[str, str]:
    names, units = data[f"{axis}_name"].values, data[f"{axis}_unit"].values
    return dict(zip(map(str, names), map(str, units), strict=True))
