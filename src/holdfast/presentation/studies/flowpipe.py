"""Text and figure of a flowpipe."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from holdfast.analysis.certificates.flowpipe import Flowpipe
from holdfast.arguments import checked
from holdfast.presentation.figures import style


@checked
def flowpipe_figure(pipe: Flowpipe) -> Figure:
    """The boxes of all states on the way over the first two of them, and those of start and end."""
    (a, unit_a), (b, unit_b) = pipe.states[:2]
    start, ends = list(pipe.start.values()), list(pipe.ends.values())
    with style.look():
        figure, axis = plt.subplots(figsize=(style.WIDTH / 1.6, style.WIDTH / 1.8))
        boxes = np.stack([pipe.low[:, :2], pipe.high[:, :2]], axis=2)
        for several, fill, edge, width in (
            (boxes, style.SKY, style.BLUE, 0.2),
            (np.array([start[:2]]), "none", "black", 2),
            (np.array([ends[:2]]), "none", style.ORANGE, 2),
        ):
            shapes = [Rectangle(q[:, 0], *(q[:, 1] - q[:, 0])) for q in several]
            axis.add_collection(
                PatchCollection(shapes, facecolor=fill, edgecolor=edge, linewidth=width)
            )
        axis.autoscale_view()
        axis.set(
            xlabel=f"{a} [{unit_a}]" if unit_a else a, ylabel=f"{b} [{unit_b}]" if unit_b else b
        )
        handles = [
            Patch(
                facecolor=style.SKY,
                edgecolor=style.BLUE,
                label=f"all on the way, {pipe.seconds:g} s",
            ),
            Patch(facecolor="none", edgecolor="black", linewidth=2, label="start"),
            Patch(facecolor="none", edgecolor=style.ORANGE, linewidth=2, label="end"),
        ]
        axis.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1), ncols=3)
    return figure


def flowpipe_text(pipe: Flowpipe, files: Sequence[Path] = ()) -> str:
    """What is proved, and from where."""
    names = dict(pipe.states)
    goal = ", and is in the target at the end" if pipe.header["target"] else ""
    lines = [pipe.header["title"], ""]
    lines += _table("from", pipe.start, names)
    if not pipe.proved:
        return "\n".join([*lines, "", f"  Nothing is proved of this box: {pipe.why}."])
    lines += _table("ends in", pipe.ends, names)
    lines += [
        f"  by             {pipe.parts} parts of the box, {len(pipe.levels)} steps",
        "",
        f"  Every trajectory from this box keeps every constraint for {pipe.seconds:g} s{goal},",
        "  if the model and the bounds hold.",
    ]
    if files:
        lines += ["", f"  files in {files[0].parent}: {', '.join(f.name for f in files)}",
                  f"  check it: holdfast-check {shlex.quote(str(files[0]))}"]  # fmt: skip
    return "\n".join(lines)


def _table(
    first: str, ranges: Mapping[str, Sequence[float]], units: Mapping[str, str]
) -> list[str]:
    return [
        f"  {first if k == 0 else '':<14} {name} {low:.4g} to {high:.4g} {units[name]}".rstrip()
        for k, (name, (low, high)) in enumerate(ranges.items())
    ]
