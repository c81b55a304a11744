"""Figures of robot formations: map with fields, paths and views; constraints; animation."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon

from holdfast.analysis.simulation.result import Result
from holdfast.execution.arrays import Array
from holdfast.host.files import atomic_file
from holdfast.maths.definitions.region import Footprint
from holdfast.maths.expressions.numeric import evaluated, parameter_values
from holdfast.presentation.figures import style
from holdfast.presentation.figures.style import draw_fixed, seen_from

FRAMES_PER_SECOND = 12


@dataclass(frozen=True)
class Ground:
    """The background of the map: cells, and arrows (x, y, direction) of the fields."""

    cells: Sequence[Sequence[tuple[float, float]]]
    arrows: Array
    goal: tuple[float, float]


def formation_figure(result: Result, ground: Ground, instants: int = 5, run: int = 0) -> Figure:
    """Paths of all robots of a run, with robots and views at instants evenly spaced in time."""
    robots, bodies = robots_of(result, run), _bodies(result)
    with style.look():
        figure, axis = _map(ground, result)
        for number, (name, path) in enumerate(robots.items()):
            colour = style.LINES[number % len(style.LINES)]
            axis.plot(
                path[:, 0], path[:, 1], color=colour, linestyle=style.dashes(number),
                label=name, zorder=4,
            )  # fmt: skip
        count = len(next(iter(robots.values())))
        for number, k in enumerate(np.linspace(0, count - 1, instants).astype(int)):
            shade = 0.25 + 0.75 * (number + 1) / instants
            _draw_robots(axis, bodies, robots, int(k), shade)
        handles = [*axis.get_legend_handles_labels()[0]]
        handles.append(Line2D([], [], color=style.ORANGE, linewidth=5, alpha=0.35, label="view"))
        if ground.arrows.size:
            field = {"color": style.GREY, "marker": r"$\rightarrow$", "linestyle": ""}
            handles.append(Line2D([], [], markersize=8, label="field of the leader", **field))  # type: ignore[arg-type]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(6, len(handles)))
        seconds = result.arrays["time"].values
        axis.set_title(f"at {instants} instants, {seconds[count - 1] / (instants - 1):.3g} s apart")
    return figure


TITLES = {
    "bearing": "leader between the sides of the view",
    "range": "leader within range",
    "sight": "no wall in the line of sight",
    "clear": "clear of walls",
    "apart": "robots apart",
}


def constraints_figure(result: Result, run: int = 0) -> Figure:
    """Every constraint of a run over time, one panel for each kind; safe below zero.

    The colour is that of the robot; grey for pairs that do not follow each other.
    """
    data = result.arrays
    units = [str(u) for u in data["constraint_unit"].values]
    kinds: dict[str, list[tuple[int, str]]] = {}
    for i, name in enumerate(str(n) for n in data["constraint_name"].values):
        kind, of = re.fullmatch(r"([a-z]+)_?(.*)", name).groups()  # type: ignore[union-attr]
        kinds.setdefault(kind, []).append((i, of))
    robots = [name.removeprefix("follower ") for name in robots_of(result, run)]
    time, values = data["time"].values, data["constraint"].values[run]
    rows = -(-len(kinds) // 2)
    with style.look():
        figure, axes = plt.subplots(
            rows, 2, figsize=(style.WIDTH, 1.7 * rows + 0.7), sharex=True, layout="constrained"
        )
        flat = list(np.atleast_1d(axes).flat)
        lines: dict[str, Line2D] = {}
        for axis, (kind, members) in zip(flat, kinds.items(), strict=False):
            for i, of in members:
                label, drawn = _line_of(of, robots)
                lines.setdefault(label, axis.plot(time, values[:, i], **drawn)[0])
            axis.axhline(0.0, color=style.BLACK, linewidth=0.6)
            axis.set_title(TITLES.get(kind, kind), loc="left", fontsize=8, pad=3)
            axis.set_ylabel(f"[{units[members[0][0]]}]")
            axis.margins(x=0.0, y=0.1)
        for axis in flat[len(kinds) :]:
            axis.set_visible(False)
        for axis in flat[max(len(kinds) - 2, 0) : len(kinds)]:
            axis.set_xlabel("time [s]")
            axis.tick_params(labelbottom=True)
        shown = sorted(lines, key=lambda n: (n == OTHERS, n != "leader", n))
        figure.legend(
            handles=[lines[n] for n in shown], labels=shown, loc="outside lower center",
            ncols=min(6, len(shown)),
        )  # fmt: skip
        figure.suptitle("constraints, safe below 0", fontsize=9)
    return figure


OTHERS = "other pairs"


def _line_of(of: str, robots: list[str]) -> tuple[str, dict[str, Any]]:
    """Label and style of a constraint's line, for one robot or a pair."""
    *before, last = ["leader" if n == "L" else n for n in of.split("_")]
    if before and robots.index(last) - robots.index(before[0]) > 1:
        return OTHERS, {"color": style.GREY, "linewidth": 0.7}
    number = robots.index(last)
    name = "leader" if last == "leader" else f"follower {last}"
    return name, {
        "color": style.LINES[number % len(style.LINES)],
        "linestyle": style.dashes(number),
    }


def write_animation(
    result: Result,
    ground: Ground,
    path: Path,
    speed: float = 8.0,
    run: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """A GIF of one run, `speed` seconds of it in a second."""
    robots, bodies = robots_of(result, run), _bodies(result)
    time = result.arrays["time"].values
    count = len(next(iter(robots.values())))
    end = time[count - 1]
    shown = np.append(np.arange(0.0, end, speed / FRAMES_PER_SECOND), end)
    frames = np.searchsorted(time, shown).clip(0, count - 1)
    with style.look():
        figure, axis = _map(ground, result, scale=0.8)
        trails = [
            axis.plot([], [], color=style.LINES[n % len(style.LINES)], label=name, zorder=4)[0]
            for n, name in enumerate(robots)
        ]
        figure.legend(loc="outside lower center", ncols=min(6, len(trails) + 1))
        moving: list[Any] = []

        def draw(number: int) -> list[Any]:
            while moving:
                moving.pop().remove()
            k = int(frames[number])
            for line, trail in zip(trails, robots.values(), strict=True):
                line.set_data(trail[: k + 1, 0], trail[: k + 1, 1])
            moving.extend(_draw_robots(axis, bodies, robots, k, 1.0))
            axis.set_title(f"{time[k]:.1f} s")
            return moving

        animation = FuncAnimation(figure, draw, frames=len(frames), blit=False)
        tell = None
        if progress is not None:
            tell = lambda n, total: progress((n + 1) / total)  # noqa: E731
        with atomic_file(path) as partial:
            writer = _GifWriter(fps=FRAMES_PER_SECOND)
            animation.save(str(partial), writer=writer, dpi=100, progress_callback=tell)
        plt.close(figure)
    return path


class _GifWriter(PillowWriter):
    """Matplotlib's writer, with the format GIF for any suffix of the file's name."""

    def finish(self) -> None:
        first, *others = self._frames  # type: ignore[attr-defined]
        duration = int(1000 / self.fps)
        first.save(
            self.outfile,
            format="gif",
            save_all=True,
            append_images=others,
            duration=duration,
            loop=0,
        )


def robots_of(result: Result, run: int) -> dict[str, Array]:
    """{ leader, follower 1, ...: (x, y, theta) against time }, up to where the record ends."""
    data = result.arrays
    names = [str(n) for n in data["state_name"].values]
    states = data["state"].values[run]
    states = states[np.isfinite(states).all(axis=1)]
    paths = {}
    for name in names:
        if name.startswith("theta"):
            of = name.removeprefix("theta")
            columns = [names.index(f"{n}{of}") for n in ("x", "y", "theta")]
            paths["leader" if of == "L" else f"follower {of}"] = states[:, columns]
    return paths


def _map(ground: Ground, result: Result, scale: float = 1.0) -> tuple[Figure, Axes]:
    corners = np.array([p for cell in ground.cells for p in cell])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = high - low
    pad = 0.04 * float(size.max())
    width = scale * style.WIDTH * min(1.0, 1.1 * float(size[0] / size[1]))
    height = min(width * float(size[1] / size[0]), 1.1 * style.WIDTH) + 0.9
    figure, axis = plt.subplots(figsize=(max(width, 3.6), height), layout="constrained")
    for cell in ground.cells:
        axis.add_patch(
            Polygon(cell, fill=False, linestyle=":", linewidth=0.6, edgecolor=style.GREY)
        )
    draw_fixed(axis, result.scene, result.parameters)
    if ground.arrows.size:
        x, y, direction = ground.arrows.T
        axis.quiver(
            x, y, np.cos(direction), np.sin(direction), color=style.GREY, alpha=0.6,
            scale=45, width=0.002, headwidth=5, zorder=1,
        )  # fmt: skip
    axis.plot(*ground.goal, "*", color=style.PURPLE, markersize=8, label="goal", zorder=7)
    axis.set_aspect("equal")
    axis.set_xlim(low[0] - pad, high[0] + pad)
    axis.set_ylim(low[1] - pad, high[1] + pad)
    axis.set_xlabel("$x$ [m]")
    axis.set_ylabel("$y$ [m]")
    for line in axis.get_lines():
        if line.get_label() == "wall":
            line.set(color=style.BLACK, linewidth=1.4, label="_wall")
    return figure, axis


def _bodies(result: Result) -> tuple[float, list[Array]]:
    """The radius of a robot, and the corners (ahead, left) of every follower's view."""
    parameters = result.parameters or {}
    values = parameter_values(parameters)
    views = [shape for shape in result.scene if isinstance(shape, Footprint)]
    corners = [np.array([evaluated(c, values) for c in view.corners]) for view in views]
    return parameters["robot_radius"], corners


def _draw_robots(
    axis: Axes,
    bodies: tuple[float, list[Array]],
    robots: dict[str, Array],
    k: int,
    shade: float,
) -> list[Any]:
    """Discs with their headings, and the views of the followers, at one instant."""
    radius, views = bodies
    drawn: list[Any] = []
    for number, path in enumerate(robots.values()):
        x, y, theta = path[k]
        colour = style.LINES[number % len(style.LINES)]
        disc = Circle((x, y), radius, facecolor="white", edgecolor=colour, alpha=shade, zorder=5)
        drawn.append(axis.add_patch(disc))
        nose = x + radius * np.cos(theta), y + radius * np.sin(theta)
        drawn += axis.plot([x, nose[0]], [y, nose[1]], color=colour, alpha=shade, zorder=6)
        if number:
            seen = seen_from(x, y, theta, views[number - 1])
            patch = Polygon(seen, facecolor=style.ORANGE, alpha=0.14 * shade, zorder=2)
            drawn.append(axis.add_patch(patch))
    return drawn
