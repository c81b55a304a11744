"""Text and figure of a certificate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.law_keeps import LawJudgement
from holdfast.arguments import checked
from holdfast.presentation.figures import style


@checked
def certificate_figure(found: Certificate) -> Figure:
    """The certified cells over the first two states, in the middle of the others."""
    cells, kept = found.cells, found.kept
    state = np.zeros(cells.counts)
    state.reshape(-1)[kept.region] = 1
    state.reshape(-1)[kept.members] = 2
    middle = tuple(n // 2 for n in cells.counts[2:])
    shown = state.reshape(*cells.counts[:2], -1)[
        ..., np.ravel_multi_index(middle, cells.counts[2:]) if middle else 0
    ]
    colours = ListedColormap(["white", "0.85", style.BLUE])
    with style.look():
        figure, axis = plt.subplots(figsize=(style.WIDTH / 1.6, style.WIDTH / 1.8))
        axis.pcolormesh(
            cells.edges[0], cells.edges[1], shown.T, cmap=colours, vmin=0, vmax=2, rasterized=True
        )
        (a, unit_a), (b, unit_b) = found.states[:2]
        axis.set_xlabel(f"{a} [{unit_a}]")
        axis.set_ylabel(f"{b} [{unit_b}]")
        handles = [
            Patch(color=style.BLUE, label="certified"),
            Patch(color="0.85", label="in the region, not certified"),
        ]
        axis.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
        others = [
            f"{n} = {0.5 * (e[k] + e[k + 1]):.3g} {u}"
            for (n, u), e, k in zip(found.states[2:], cells.edges[2:], middle, strict=True)
        ]
        if others:
            axis.set_title(", ".join(others), fontsize="small", pad=24)
    return figure


def certificate_text(found: Certificate, files: Sequence[Path] = ()) -> str:
    """What is proved, of how many cells, and what is assumed."""
    kept = found.kept
    sizes = f", of up to {2**kept.depth} times that width, {len(kept.entries)} in all"
    share = kept.share if kept.share == 1 else min(kept.share, 0.999)  # all are certified, or not
    seconds = f"{(kept.holds or 0) * found.hold:g} s"
    lasts = "for ever" if kept.holds is None else f"for {seconds}"
    if found.target:
        lasts = f"to the target within {seconds}"
    lines = [
        found.title,
        "",
        f"  certified      {len(kept.members)} of {kept.inside} cells in the region "
        f"({100 * share:.1f} %), {lasts}",
        _inputs(found),
        f"  cells          {' x '.join(map(str, found.cells.counts))}"
        f"{sizes if kept.depth else ''}, {kept.sweeps} sweeps",
    ]
    for name, unit in (*found.disturbances, *found.parameters):
        low, high = found.ranges[name]
        if low < high:
            lines.append(f"  any {name:<10} from {low:.4g} to {high:.4g} {unit}")
    for (name, unit), error in zip(found.states, found.sampling.errors, strict=True):
        if error:
            lines.append(f"  measured       {name} to {error:.4g} {unit}")
    if found.sampling.delay:
        lines.append(f"  late           inputs, by up to {found.sampling.delay:g} s")
    whose = "the law" if found.sampling.law is not None else "an input of the certificate"
    lines += [
        "",
        f"  From every state of these cells {whose}, held from sample to sample,",
        "  keeps every constraint at every instant, if the model and the bounds hold"
        + (", until the" if found.target else "."),
    ]
    if found.target:
        lines.append("  target is reached.")
    if files:
        names = ", ".join(f.name for f in files)
        lines += ["", f"  files in {files[0].parent}: {names}",
                  f"  check it: holdfast-check {files[0]}"]  # fmt: skip
    return "\n".join(lines)


def judgement_text(found: LawJudgement, files: list[Path]) -> str:
    """The verdict on a law, what is certified of it, and the trajectory that refutes it."""
    says = {
        "proved": "the law keeps the region from every cell that lies in it",
        "refuted": "a trajectory under the law surely leaves the region",
        "undecided": "of some cells in the region neither is known",
    }
    lines = [f"{found.verdict}: {says[found.verdict]}", ""]
    if (path := found.leaving) is not None:
        numbers = {**path.start, **path.held}
        lines += [
            f"  from {', '.join(f'{n} = {v:.4g}' for n, v in path.start.items())}"
            + (f", under {', '.join(f'{n} = {v:.4g}' for n, v in path.held.items())}:"
               if len(numbers) > len(path.start) else ":"),
            f"  after {path.time[-1]:g} s {path.constraint} is violated by at least {path.by:.3g}",
            "",
        ]  # fmt: skip
    return "\n".join([*lines, certificate_text(found.certificate, files)])


def _inputs(found: Certificate) -> str:
    whose = f"{len(found.candidates)} tried" if found.sampling.law is None else "those of the law"
    return f"  inputs         {whose}, each held for {found.hold:g} s"
