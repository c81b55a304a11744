"""Where a system can rest in its disturbances as a few lines of text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from holdfast.analysis.safety.equilibria import RestingState


def resting_text(
    title: str, found: Sequence[RestingState], units: Mapping[str, str], drawn: bool, file: Path
) -> str:
    """How many disturbances leave a place at rest, the least margin and that place, the file."""
    held = [f for f in found if f.exists]
    lines = [title, ""]
    if drawn:
        share = 100.0 * len(held) / len(found)
        lines.append(
            f"  at rest        in {len(held)} of {len(found)} drawn disturbances ({share:.1f} %)"
        )
    lost = [f for f in found if not f.exists]
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
