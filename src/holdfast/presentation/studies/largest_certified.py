"""Text of a search for the largest number that is certified."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from holdfast.analysis.certificates.largest import LargestCertified
from holdfast.analysis.reachability.solve import Answer


def largest_text(found: LargestCertified, files: Sequence[Path] = ()) -> str:
    """One line for every trial, the limit, and what it means."""
    unit = "" if found.unit == "1" else f" {found.unit}"
    asked = "a cell" if found.share == 0 else f"{100 * found.share:g} % of the cells"
    head = f"{found.name} [{found.unit}]"
    width = max(len(head), 10) + 2
    lines = [found.title, "", f"  {found.key}: largest value for which {asked} in the region "
             "is certified", ""]  # fmt: skip
    lines.append(f"    {head:<{width}}certified            seconds")
    for t in found.trials:
        shown = f"{t.certified} of {t.inside}"
        enough = "" if t.answer is Answer.HELD else "  not enough"
        share = f"{100 * t.share:.1f} %"
        lines.append(f"    {t.value:<{width}.5g}{shown:<14}{share:>7}{t.wall_time:>7.1f}{enough}")
    lines += ["", f"  the limit      {_limit(found, unit)}"]
    if found.widens and found.low is not None:
        lines.append("  proved for     every smaller value as well: its bounds lie within these")
    elif found.low is not None:
        lines.append("  proved for     the values that were tried, each by itself")
    lines.append("  not certified  is not lost: other cells, inputs, coordinates may certify more")
    if found.low is not None and files:
        lines.append(f"  the file       is the certificate of {found.low:.6g}{unit}")
    if files:
        lines += ["", f"  files in {files[0].parent}: " + ", ".join(f.name for f in files)]
        if found.found is not None:
            lines.append(f"  check it: holdfast-check {shlex.quote(str(files[0]))}")
    return "\n".join(lines)


def _limit(found: LargestCertified, unit: str) -> str:
    low, high = found.low, found.high
    if low is None:
        return f"none found: {found.trials[0].value:.4g}{unit} is not certified already"
    if high is None:
        return f"none found: all are certified up to {low:.4g}{unit}"
    wide = "" if found.answered else f", wider than the tolerance {found.tolerance:.2g}{unit}"
    return f"certified at {low:.4g}{unit}, not at {high:.4g}{unit}{wide}"
