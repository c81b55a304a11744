"""Texts and figures of a certificate, of a flowpipe, and of a largest number certified."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from holdfast.analysis.certificates.cells import Cells
from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.flowpipe import Flowpipe
from holdfast.analysis.certificates.largest import Advice, LargestCertified
from holdfast.analysis.certificates.law_keeps import LawJudgement
from holdfast.analysis.certificates.outer_set import OuterSet
from holdfast.analysis.reachability.solve import Answer
from holdfast.arguments import checked
from holdfast.execution.arrays import Array
from holdfast.presentation.figures import style


def largest_text(largest: LargestCertified, files: Sequence[Path] = ()) -> str:
    """One line for every trial, the limit, and what it means."""
    unit = "" if largest.unit == "1" else f" {largest.unit}"
    asked = "a cell" if largest.share == 0 else f"{100 * largest.share:g} % of the cells"
    head = f"{largest.name} [{largest.unit}]"
    width = max(len(head), 10) + 2
    lines = [largest.title, "", f"  {largest.key}: largest value for which {asked} in the region "
             "is certified", ""]  # fmt: skip
    lines.append(f"    {head:<{width}}certified            seconds")
    for t in largest.trials:
        shown = f"{t.certified} of {t.inside}"
        enough = "" if t.answer is Answer.HELD else "  not enough"
        share = f"{100 * t.share:.1f} %"
        lines.append(f"    {t.value:<{width}.5g}{shown:<14}{share:>7}{t.wall_time:>7.1f}{enough}")
    lines += ["", f"  the limit      {_limit(largest, unit)}"]
    if largest.widens and largest.low is not None:
        lines.append("  proved for     every smaller value as well: its bounds lie within these")
    elif largest.low is not None:
        lines.append("  proved for     the values that were tried, each by itself")
    lines.append("  not certified  is not lost: other cells, inputs, coordinates may certify more")
    if largest.low is not None and files:
        lines.append(f"  the file       is the certificate of {largest.low:.6g}{unit}")
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
        if largest.found is not None:
            lines.append(f"  check it: holdfast-check {shlex.quote(str(files[0]))}")
    return "\n".join(lines)


def _limit(largest: LargestCertified, unit: str) -> str:
    low, high = largest.low, largest.high
    if low is None:
        return f"none found: {largest.trials[0].value:.4g}{unit} is not certified already"
    if high is None:
        return f"none found: all are certified up to {low:.4g}{unit}"
    wide = "" if largest.answered else f", wider than the tolerance {largest.tolerance:.2g}{unit}"
    return f"certified at {low:.4g}{unit}, not at {high:.4g}{unit}{wide}"


@checked
def certificate_figure(found: Certificate) -> Figure:
    """The certified cells over the first two states, in the middle of the others.

    found: a `Certificate`.

    >>> hf.certificate_figure(certificate).savefig("certificate.png")
    """
    marks = np.zeros(found.cells.total)
    marks[found.kept.region], marks[found.kept.members] = 1, 2
    says = {2: "certified", 1: "in the region, not certified"}
    return _cells_figure(found.cells, found.states, marks, says)


@checked
def outer_figure(outer: OuterSet) -> Figure:
    """The cells that the set may touch over the first two states, in the middle of the others."""
    marks = np.ones(outer.cells.total)
    marks[outer.members] = 2
    says = {2: "may be of the set", 1: "surely outside"}
    return _cells_figure(outer.cells, outer.states, marks, says)


def _cells_figure(
    cells: Cells, states: Sequence[tuple[str, str]], marks: Array, says: dict[int, str]
) -> Figure:
    """marks: 2 where a cell is blue, 1 where it is grey. states: with their units."""
    middle = tuple(n // 2 for n in cells.counts[2:])
    shown = marks.reshape(*cells.counts[:2], -1)[
        ..., np.ravel_multi_index(middle, cells.counts[2:]) if middle else 0
    ]
    colours = {2: style.BLUE, 1: "0.85"}
    with style.look():
        figure, axis = plt.subplots(figsize=(style.WIDTH / 1.6, style.WIDTH / 1.8))
        axis.pcolormesh(
            cells.edges[0], cells.edges[1], shown.T, vmin=0, vmax=2, rasterized=True,
            cmap=ListedColormap(["white", colours[1], colours[2]]),
        )  # fmt: skip
        (a, unit_a), (b, unit_b) = states[:2]
        axis.set(xlabel=f"{a} [{unit_a}]", xlim=_shown(cells.edges[0]))
        axis.set(ylabel=f"{b} [{unit_b}]", ylim=_shown(cells.edges[1]))
        handles = [Patch(color=colours[mark], label=text) for mark, text in says.items()]
        axis.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
        others = [
            f"{n} = {0.5 * (e[k] + e[k + 1]):.3g} {u}"
            for (n, u), e, k in zip(states[2:], cells.edges[2:], middle, strict=True)
        ]
        if others:
            axis.set_title(", ".join(others), fontsize="small", pad=24)
    return figure


def _shown(edges: Array) -> tuple[float, float]:
    """The range of a state that is drawn: without ends that go on far beyond a grid."""
    wide = np.diff(edges)
    far = wide > 100 * np.median(wide)
    return float(edges[int(far[0])]), float(edges[len(wide) - int(far[-1])])


def outer_text(outer: OuterSet, files: Sequence[Path] = ()) -> str:
    """How many cells the set may touch, how far they reach, and what is sure of the others."""
    ends = ", ".join(
        f"{n} {a:.4g} to {b:.4g} {unit}"
        for (n, unit), (a, b) in zip(outer.states, outer.extent().values(), strict=True)
    )
    why = ["  it is not reached, or does not reach, for any input and disturbance."]
    if outer.kind.endswith("kernel"):
        why = [
            "  it is outside of the region, or a disturbance, held, drives it out of that against",
            "  every input.",
        ]
    lines = [
        f"outer set of a {outer.kind.replace('-', ' ')}",
        "",
        f"  may be of it   {len(outer.members)} of {outer.cells.total} cells "
        f"({100 * len(outer.members) / outer.cells.total:.1f} %)",
        f"  reaches        {ends if len(outer.members) else 'nothing: the set is empty'}",
        f"  cells          {' x '.join(map(str, outer.cells.counts))}, "
        f"enclosures over {outer.hold:.4g} s",
        "",
        "  A state of no such cell is surely not of the set, if the model and the bounds hold:",
        *why,
    ]  # fmt: skip
    if files:
        lines += ["", f"  files in {files[0].parent}: {', '.join(f.name for f in files)}"]
        if outer.lost is not None:
            lines.append(f"  check it: holdfast-check {shlex.quote(str(files[0]))}")
    return "\n".join(lines)


def certificate_text(certificate: Certificate, files: Sequence[Path] = ()) -> str:
    """What is proved, of how many cells, and what is assumed."""
    cells = certificate.kept
    sizes = f", of up to {2**cells.depth} times that width, {len(cells.entries)} in all"
    seconds = f"{(cells.holds or 0) * certificate.hold:g} s"
    lasts = "for ever" if cells.holds is None else f"for {seconds}"
    if certificate.target:
        lasts = f"to the target within {seconds}"
    lines = [
        certificate.title,
        "",
        f"  certified      {len(cells.members)} of {cells.inside} cells in the region "
        f"({_percent(cells.share)}), {lasts}",
        _inputs(certificate),
        f"  cells          {' x '.join(map(str, certificate.cells.counts))}"
        f"{sizes if cells.depth else ''}, {cells.sweeps} sweeps",
    ]
    for name, unit in (*certificate.disturbances, *certificate.parameters):
        low, high = certificate.ranges[name]
        if low < high:
            lines.append(f"  any {name:<10} from {low:.4g} to {high:.4g} {unit}")
    for (name, unit), error in zip(certificate.states, certificate.sampling.errors, strict=True):
        if error:
            lines.append(f"  measured       {name} to {error:.4g} {unit}")
    if certificate.sampling.delay:
        lines.append(f"  late           inputs, by up to {certificate.sampling.delay:g} s")
    if len(cells.members):
        whose = "the law" if certificate.sampling.law is not None else "an input of the certificate"
        lines += [
            "",
            f"  From every state of these cells {whose}, held from sample to sample,",
            "  keeps every constraint at every instant, if the model and the bounds hold"
            + (", until the" if certificate.target else "."),
            *(["  target is reached."] if certificate.target else []),
        ]
    if files:
        names = ", ".join(f.name for f in files)
        lines += ["", f"  files in {files[0].parent}: {names}"]
        if len(cells.members):
            lines.append(f"  check it: holdfast-check {shlex.quote(str(files[0]))}")
    return "\n".join(lines)


def advice_text(advice: Advice) -> str:
    """Which numbers help, as they were tried one at a time."""
    lines = []
    for change in advice.changes:
        line = f"{change.option}: {_percent(change.share)}"
        if change.cells is not None:
            cells = " x ".join(map(str, change.cells))
            line += f", tried on {cells} cells, which have {_percent(change.before)} without it"
        lines.append(line)
    if not lines:
        lines = ["none of these alone, by 2 % or more:", *advice.tried]
    return "\n".join(f"  {'' if k else 'what helps':<15}{line}" for k, line in enumerate(lines))


def _percent(share: float) -> str:
    return f"{100 * (share if share == 1 else min(share, 0.999)):.1f} %"


def judgement_text(judgement: LawJudgement, files: list[Path]) -> str:
    """The verdict on a law, what is certified of it, and the trajectory that refutes it."""
    says = {
        "proved": "the law keeps the region from every cell that lies in it",
        "refuted": "a trajectory under the law surely leaves the region",
        "undecided": "of some cells in the region neither is known",
    }
    lines = [f"{judgement.verdict}: {says[judgement.verdict]}", ""]
    if (path := judgement.leaving) is not None:
        numbers = {**path.start, **path.held}
        lines += [
            f"  from {', '.join(f'{n} = {v:.4g}' for n, v in path.start.items())}"
            + (f", under {', '.join(f'{n} = {v:.4g}' for n, v in path.held.items())}:"
               if len(numbers) > len(path.start) else ":"),
            f"  after {path.time[-1]:g} s {path.constraint} is violated by at least {path.by:.3g}",
            "",
        ]  # fmt: skip
    return "\n".join([*lines, certificate_text(judgement.certificate, files)])


def _inputs(certificate: Certificate) -> str:
    whose = (
        f"{len(certificate.candidates)} tried"
        if certificate.sampling.law is None
        else "those of the law"
    )
    return f"  inputs         {whose}, each held for {certificate.hold:g} s"


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
