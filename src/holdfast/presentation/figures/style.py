"""The common style of all figures: sizes, colours, file formats, and shapes that stand still."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as CirclePatch
from matplotlib.textpath import TextPath

from holdfast.errors import OutputError
from holdfast.execution.simulation.settings import Outcome
from holdfast.host.files import atomic_file
from holdfast.maths.definitions.region import WALLS, Circle, Segment, Shape
from holdfast.maths.expressions.numeric import evaluated, parameter_values

# Okabe-Ito, distinguishable by colour-blind readers
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK, GREY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
    "#222222",
    "#999999",
)
LINES = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, BLACK)
MODES = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY)

OUTCOMES: dict[Outcome, str] = dict(
    zip(Outcome, (SKY, GREEN, RED, BLACK, PURPLE, ORANGE, BLUE), strict=False)
)
"""The colour of every outcome, in every figure: stayed, reached goal, left, diverged, chattered."""

DASHES: tuple[tuple[float, ...], ...] = (
    (), (4, 1.5), (1, 1.2), (6, 1.5, 1, 1.5), (9, 2), (3, 1.2, 1, 1.2, 1, 1.2), (2, 3),
    *((8, 1.2) + (1, 1.2) * dots for dots in range(2, 8)),
)  # fmt: skip
"""Dashes and gaps in widths of their line, so that lines differ without colours too; from the
eighth on, a dash and so many dots."""

OUTCOME_DASHES: dict[Outcome, tuple[float, ...]] = dict(
    zip(Outcome, (DASHES[4], DASHES[0], DASHES[1], DASHES[2], DASHES[3], *DASHES[5:]), strict=False)
)
"""The dashes of every outcome, in every figure."""

LIMIT = "#6b6258"
"""The zero level of a constraint."""

OVERRULED, INFEASIBLE = ORANGE, BLACK
"""Marks of samples at which a safety filter intervened, or found no admissible input."""

WIDTH = 7.2
"""Inches: the text width of a page."""

_SETTINGS: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.1,
    "figure.autolayout": False,
    "figure.constrained_layout.use": False,
    "figure.dpi": 100,
    "hatch.linewidth": 0.5,
    "savefig.dpi": 200,
    "svg.fonttype": "none",
    "svg.hashsalt": "holdfast",
    "mathtext.fontset": "dejavusans",
}


def dashes(number: int) -> Any:
    """The dashes of the line of that number, for Matplotlib."""
    return dashed(DASHES[number % len(DASHES)])


def dashed(pattern: Sequence[float]) -> Any:
    """Dashes and gaps, as Matplotlib takes them."""
    return (0, tuple(pattern)) if pattern else "-"


@contextmanager
def look() -> Iterator[None]:
    """Context manager: the settings of every figure while it is drawn.

    The backend is loaded before: the settings that it makes, in a notebook, stay as they are.
    """
    plt.draw_if_interactive()  # type: ignore[no-untyped-call]
    with matplotlib.rc_context(_SETTINGS):
        yield


def write(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write the figure as PNG and SVG, each atomically, and close it."""
    written = []
    try:
        with look():
            engine = figure.get_layout_engine()
            equal = any(axis.get_aspect() != "auto" for axis in figure.axes)
            if engine is not None:  # one layout for both formats
                engine.execute(figure)
            if equal:
                for axis in figure.axes:
                    axis.apply_aspect()
                if engine is not None:
                    engine.execute(figure)  # equal axes have moved their labels in between
            figure.set_layout_engine(None)  # each format would be laid out, and drawn, once more
            everything = None
            if equal:
                # equal axes can push a title over the page's edge: the page then grows
                box = figure.get_tightbbox()
                inside = box.x0 >= 0 and box.y0 >= 0 and (box.max <= figure.get_size_inches()).all()
                everything = None if inside else box.padded(0.05)
        for ending in ("png", "svg"):
            path = folder / f"{name}.{ending}"
            metadata = {"Date": None} if ending == "svg" else {}
            with look(), atomic_file(path) as partial:
                figure.savefig(partial, format=ending, metadata=metadata, bbox_inches=everything)
            written.append(path)
    finally:
        plt.close(figure)
    return written


def check_run(run: int, count: int) -> None:
    """Refuse the number of a run that a result of so many does not have."""
    if not 0 <= run < count:
        raise OutputError(f"the result has no run {run}", expected=f"0 to {count - 1}")


def label(symbol: str) -> str:
    """A state or parameter name as mathematics: psi -> the Greek letter, tau_u, x1 -> subscript."""
    greek = {"psi", "theta", "phi", "alpha", "beta", "tau", "sigma", "mu", "lam", "delta"}
    head, _, tail = symbol.partition("_")
    if not tail and (numbered := re.fullmatch(r"([A-Za-z]+?)(\d+|[LF])", symbol)):
        head, tail = numbered.groups()
    shown = f"\\{'lambda' if head == 'lam' else head}" if head in greek else head
    if len(head) > 2 and head not in greek:
        return symbol.replace("_", " ")
    return f"${shown}_{{\\mathrm{{{tail.replace('_', ' ')}}}}}$" if tail else f"${shown}$"


def axis_label(symbol: str, unit: str) -> str:
    """The name with its unit, if it has one."""
    return label(symbol) if unit == "1" else f"{label(symbol)} [{unit}]"


def numbers(named: Iterable[tuple[str, float, str]]) -> str:
    """Names, values and units as text: x = 2 m, psi = 0.3 rad."""
    return ", ".join(
        f"{label(name)} = {value if abs(value) > 1e-12 else 0.0:.3g}"
        + ("" if unit == "1" else f" {unit}")
        for name, value, unit in named
    )


FIXED: Mapping[str, dict[str, Any]] = {
    "target": {"color": BLACK, "linewidth": 4.5, "zorder": 5},
    **{role: {"color": GREY, "linewidth": 1.5, "zorder": 2} for role in WALLS},
    "goals": {"color": PURPLE, "linewidth": 1.0, "linestyle": "--", "zorder": 2},
}
"""How shapes of these roles are drawn."""


def draw_fixed(axis: Axes, scene: Iterable[Shape], parameters: Mapping[str, float] | None) -> None:
    """The segments and circles of a scene, each role labelled; cones belong to a path."""
    values = parameter_values(parameters)
    for shape in scene:
        drawn = FIXED.get(shape.role, {"color": BLACK, "linewidth": 1.2, "zorder": 2})
        if isinstance(shape, Segment):
            (x0, y0), (x1, y1) = (evaluated(p, values) for p in (shape.start, shape.end))
            axis.plot([x0, x1], [y0, y1], label=shape.role, solid_capstyle="butt", **drawn)
        elif isinstance(shape, Circle):
            x, y, radius = evaluated((*shape.centre, shape.radius), values)
            axis.add_patch(CirclePatch((x, y), radius, fill=False, **drawn))
            axis.plot([], [], label=shape.role, **drawn)


def labelled(axis: Axes) -> list[Artist]:
    """The legend entries of a panel, without those outside its limits."""
    return [
        handle
        for handle in axis.get_legend_handles_labels()[0]
        if not (isinstance(handle, Line2D) and len(handle.get_path()))
        or handle.get_path().get_extents().overlaps(axis.viewLim)
    ]


HANDLE_WIDTH, ROW_HEIGHT, ROWS = 0.55, 0.16, 2
"""Inches of an entry of a legend beside its text, of a row, and the rows that figures have room
for."""


def text_width(text: str) -> float:
    """Inches of a text, which may be a formula, in a legend."""
    font = FontProperties(size=_SETTINGS["legend.fontsize"])
    width: float = TextPath((0, 0), text, prop=font).get_extents().width / 72
    return width


def rows_of(labels: Sequence[str], width: float) -> int:
    """The least number of rows of a legend, filled column after column, that is so wide."""
    widths = [HANDLE_WIDTH + text_width(text) for text in labels]
    for rows in range(1, len(widths)):
        columns = -(-len(widths) // rows)
        longer = len(widths) % columns or columns  # Matplotlib fills the first columns
        ends = [0]
        for k in range(columns):
            ends.append(ends[-1] + (-(-len(widths) // columns) - (k >= longer)))
        if sum(max(widths[i:j]) for i, j in pairwise(ends)) <= width:
            return rows
    return max(len(widths), 1)


def add_legend(figure: Figure, handles: list[Artist], note: str = "") -> None:
    """One legend below, every label once, in as many columns as fit; a note above it. The figure
    grows with it."""
    once: dict[str, Artist] = {}
    for handle in handles:
        once.setdefault(str(handle.get_label()), handle)
    if not once:
        return
    width, height = figure.get_size_inches()
    rows = rows_of(list(once), width - 0.2)
    figure.set_figheight(height + ROW_HEIGHT * max(rows + bool(note) - ROWS, 0))
    figure.legend(
        handles=list(once.values()),
        loc="outside lower center",
        ncols=-(-len(once) // rows),
        handlelength=2.2,
        columnspacing=1.4,
        title=note or None,
        title_fontsize=7,
    )


def seen_from(x: float, y: float, heading: float, corners: Any) -> Any:
    """The corners (ahead, left), shape (n, 2), of a view from a pose, in the plane."""
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    return (x, y) + corners[:, :1] * ahead + corners[:, 1:] * left
