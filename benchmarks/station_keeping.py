"""Station keeping of chapter 3: every direction of the current, gains, radii and sample times.

Part 1: the laws for a known and an unknown current, from random starts in currents of all
directions and four speeds: a table. Part 2: what gains, exit radius and sample time do to the
tail, `station_tail.png`. Part 3: the switching law beside weathervaning on the full vehicle,
`station_weathervane.png`. `python benchmarks/station_keeping.py --help` lists the options.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import sympy as sp
import xarray as xr
from matplotlib.lines import Line2D
from tqdm import tqdm

import holdfast as hf
from holdfast.presentation.figures import style

LIMITS = {"speed_limit": 0.65, "turn_limit": 1.2}
TRACKING = {"u": 5.8, "r": 9.0}
# the switching law on the full vehicle, as in ch3-dynamic but without r2; a larger ball for it
HOLD = {"r0": 0.1, "r1": 0.15, "k1": 0.25, "k2": 2.0, "k3": 1.6, "k4": 1.75, "k5": 0.9, **LIMITS}
WIDE = {"r0": 0.3, "r1": 0.45}
# its opponent: from k1 = 0.2 and k2 = 0.5 1/s on, no gains hold tighter or with less thrust
VANE = {"k1": 0.3, "k2": 1.0, **LIMITS}

R0, R1, SPEEDS, FAST = 0.1, 0.13, (0.05, 0.1, 0.15, 0.2236), 0.2236
GAINS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0)
RADII = (0.1, 0.105, 0.11, 0.115, 0.12, 0.13, 0.15, 0.2, 0.25, 0.3)
TIMES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.06, 0.1)
MARINE_SPEEDS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6)
NOISE = {"x": 0.01, "y": 0.01, "psi": 0.02}
ANY = (-math.pi, math.pi)
BAND = (0.5, 50.0, 99.5)  # per cent
TOP = 0.33  # of the axis of the tail [m]

SPEED, DIRECTION = hf.symbol("speed"), hf.symbol("direction")
CURRENT = {"Vx": SPEED * sp.cos(DIRECTION), "Vy": SPEED * sp.sin(DIRECTION)}
TOLD = {"current_x": CURRENT["Vx"], "current_y": CURRENT["Vy"]}

Point = dict[str, Any]


@dataclass(frozen=True)
class Counts:
    """Directions and starts for each of part 1, directions of its other laws, runs per point."""

    directions: int = 300
    starts: int = 500
    fewer_directions: int = 100
    tail: int = 400
    marine: int = 200

    @property
    def runs(self) -> int:
        """All of them."""
        first = len(SPEEDS) * (self.directions + 2 * self.fewer_directions) * self.starts
        points = 3 * len(GAINS) + 2 * len(RADII) + 4 * len(TIMES)
        return first + points * self.tail + 3 * len(MARINE_SPEEDS) * self.marine


QUICK = Counts(30, 100, 10, 8, 4)


def simulate(
    bar: Any, system: hf.System, law: hf.Law | hf.Switching, speed: float,
    direction: tuple[float, float], runs: int, *, box: float, told: bool = True,
    fixed: dict[str, float], **settings: Any,
) -> hf.Result:  # fmt: skip
    """Runs from random poses of a box in a current, which the law is told or not.

    All numbers, `fixed` parameters too, go in as draws from [a, a]: one program serves all calls.
    """
    draws = {n: (v, v) for n, v in {"speed": speed, **fixed}.items()} | {"direction": direction}
    result = hf.simulate(
        system, law,
        starts=hf.Starts(random=runs, box={"x": (-box, box), "y": (-box, box), "psi": ANY}),
        disturbance=CURRENT,
        varied=hf.Varied(draws, TOLD if told else {}, units={"speed": "m/s", "direction": "rad"}),
        **settings,
    )  # fmt: skip
    bar.update(runs)
    return result


def unconditional(law: hf.Switching) -> hf.Switching:
    """The law without its conditions on the gains, which would be evaluated for every run.

    They hold in part 1; part 2 marks where they do not.
    """
    return law.map_laws(lambda mode: replace(mode, conditions=()), law.name)


# -- part 1: every direction


def kinematic(bar: Any, counts: Counts) -> Iterator[Point]:
    """One row for each law and speed."""
    system = hf.systems.drifting_unicycle()
    known = unconditional(hf.laws.hold_station(system))
    unknown = unconditional(hf.laws.hold_station_unknown(system, current_bound=0.25))
    for name, law, r1, directions in (
        ("known current, r1 = 0.13", known, R1, counts.directions),
        ("known current, r1 = r0", known, R0, counts.fewer_directions),
        ("unknown current, r1 = 0.15", unknown, 0.15, counts.fewer_directions),
    ):
        for speed in SPEEDS:
            parts, began = [], time.perf_counter()
            for i in range(directions):
                angle = 2 * math.pi * i / directions - math.pi
                result = simulate(
                    bar, system, law, speed, (angle, angle), counts.starts, box=2.0,
                    told=law is known, fixed={"r1": r1}, seed=i, horizon=60.0, sample_time=0.005,
                    substeps=1, record_every=0.05,
                )  # fmt: skip
                own = hf.station_statistics(result, R0, settled=30.0)
                own["degrees"] = "run", np.full(counts.starts, round(math.degrees(angle), 2))
                own["chattered"] = "run", result.dataset["outcome"].values == hf.Outcome.CHATTERED
                parts.append(own)
            row = {"law": name, "speed": speed, "directions": directions, "starts": counts.starts}
            row |= summary(xr.concat(parts, "run"), r1)
            row["wall_s"] = time.perf_counter() - began
            yield {k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}


def summary(data: xr.Dataset, r1: float) -> Point:
    """The numbers of one row of the table."""
    own = {name: variable.values for name, variable in data.items()}
    tail, switches, entry = (own[n] for n in ("tail_radius", "switches_per_minute", "entry_time"))
    lost = ~own["entered"] | (tail > 1.5 * r1)
    return {
        "runs": len(tail), "entered": int(own["entered"].sum()),
        "stayed": int((tail <= 1.5 * r1).sum()), "tail": float(np.median(tail)),
        "tail_99": float(np.percentile(tail, 99)), "tail_max": float(tail.max()),
        "heading_share": float(np.median(own["heading_share"])),
        "switches": float(np.median(switches)), "switches_max": float(switches.max()),
        "dwell": float(np.median(own["mean_dwell"])), "dwell_min": own["shortest_dwell"].min(),
        "entry": float(np.nanmedian(entry)), "entry_max": float(np.nanmax(entry)),
        "chattered": int(own["chattered"].sum()),
        "direction_of_tail_max": own["degrees"][tail.argmax()],
        "directions_lost": sorted(set(own["degrees"][lost])),
        "directions_chattered": sorted(set(own["degrees"][own["chattered"]])),
    }  # fmt: skip


COLUMNS = {
    "law": ("law", "", "26"), "speed": ("speed", "m/s", "7.4g"), "runs": ("runs", "", "7d"),
    "entered": ("entered", "", "8d"), "stayed": ("stayed", "", "7d"),
    "tail": ("tail", "median", "7.4f"), "tail_99": ("[m]", "99 %", "7.4f"),
    "tail_max": ("", "max", "7.4f"), "heading_share": ("|psi|", "< 0.1", "6.3f"),
    "switches": ("switches", "/min", "9.1f"), "switches_max": ("", "max", "4.0f"),
    "dwell": ("dwell", "mean s", "7.2f"), "dwell_min": ("", "min s", "6.3f"),
    "entry": ("entry", "s", "6.2f"), "entry_max": ("", "max s", "6.2f"),
    "chattered": ("chattered", "", "9d"),
}  # fmt: skip
"""Of the table: heading, second heading, format."""


def show(rows: Iterable[Point]) -> None:
    """Print the table."""
    for line in (0, 1):
        print(*(f"{c[line]:>{c[2].rstrip('dfg').split('.')[0]}}" for c in COLUMNS.values()))
    for row in rows:
        print(*(f"{row[name]:{column[2]}}" for name, column in COLUMNS.items()))


# -- part 2: gain, exit radius and sample time


def tails(bar: Any, counts: Counts) -> dict[str, list[list[Point]]]:
    """The lines of the three panels."""
    system = hf.systems.drifting_unicycle()
    law = unconditional(hf.laws.hold_station(system))
    nominal = {"r1": R0, "k2": 5.0, "sample_time": 0.01, "noise": False}

    def point(r1: float, k2: float, sample_time: float, noise: bool) -> Point:
        result = simulate(
            bar, system, law, FAST, ANY, counts.tail, box=2.0, seed=1, horizon=60.0, substeps=1,
            fixed={"r1": r1, "k2": k2, "k4": k2, "k5": k2}, sample_time=sample_time,
            record_every=max(0.01, sample_time), noise_uniform=NOISE if noise else {},
        )  # fmt: skip
        tail = hf.station_statistics(result, R0, settled=30.0)["tail_radius"].values
        share = result.outcomes["chattered"] / counts.tail
        return {"tail": np.percentile(tail, BAND).round(5).tolist(), "chattered": share}

    def line(name: str, values: Iterable[float], **at: Any) -> list[Point]:
        chosen = [nominal | at | {name: value} for value in values]
        return [c | point(**c) for c in chosen]

    return {
        "k2": [line("k2", GAINS, sample_time=ts) for ts in (0.001, 0.01, 0.05)],
        "r1": [line("r1", RADII, noise=noise) for noise in (False, True)],
        "sample_time": [line("sample_time", TIMES, k2=k2) for k2 in (2.0, 5.0, 10.0, 20.0)],
    }


def draw_tails(panels: dict[str, list[list[Point]]], folder: Path) -> None:
    """Three panels side by side: the median, the 99 % band, what chatters and what is lost."""
    with style.look():
        size = (style.WIDTH, 3.2)
        figure, axes = plt.subplots(1, 3, sharey=True, layout="constrained", figsize=size)
        for axis, (name, lines) in zip(axes, panels.items(), strict=True):
            for colour, line in zip(style.LINES, lines, strict=False):
                draw_line(axis, line, name, colour)
            axis.axhline(R0, color=style.GREY, linewidth=0.8, zorder=0)
        gain, radius, sampling = axes
        gain.set(xscale="log", xticks=[1, 2, 5, 10, 20], xlabel="gains $k_2 = k_4 = k_5$ [1/s]")
        gain.set(yscale="log", ylim=(0.096, TOP), ylabel="largest distance after 30 s [m]")
        gain.set_yticks([0.1, 0.12, 0.15, 0.2, 0.25, 0.3])
        gain.yaxis.set_major_formatter("{x:g}")
        radius.set(xscale="log", xticks=[0.1, 0.15, 0.2, 0.3], xlabel="exit radius $r_1$ [m]")
        sampling.set(xscale="log", xticks=[1, 10, 100], xlabel="sample time $T_s$ [ms]")
        for axis in axes:
            axis.xaxis.set_major_formatter("{x:g}")
            axis.minorticks_off()
        titles = ("$r_1 = r_0$", "$k_2$ = 5 1/s, $T_s$ = 10 ms", "$r_1 = r_0$")
        for axis, title in zip(axes, titles, strict=True):
            axis.legend(title=title, loc="upper left", alignment="left")
        shares = [(100 * p["chattered"], p["r1"]) for p in panels["r1"][1] if p["chattered"] > 0]
        text = ["chattering with noise:", *(f"{s:.2g} % at $r_1$ = {r:g}" for s, r in shares)]
        radius.text(0.31, 0.103, "\n".join(text), ha="right", fontsize=7)
        dot = {"color": style.BLACK, "linestyle": "", "markersize": 4}
        key = {
            "median and 99 % band": Line2D([], [], color=style.BLACK),
            "$k_2 T_s$ > 0.5": Line2D([], [], marker="o", markerfacecolor="white", **dot),
            "some runs chatter": Line2D([], [], marker="x", **dot),
            "beyond the axis: lost": Line2D([], [], marker="^", **dot),
            "$r_0$": Line2D([], [], color=style.GREY, linewidth=0.8),
        }
        figure.legend(key.values(), key.keys(), loc="outside lower center", ncols=5)
    style.write(figure, folder, "station_tail")[1].unlink()  # the SVG


def draw_line(axis: Any, line: list[Point], name: str, colour: str) -> None:
    """One line with its band; open where k2 Ts > 0.5, crossed where runs chatter."""
    label = {
        "k2": f"$T_s$ = {1e3 * line[0]['sample_time']:g} ms",
        "r1": "noise 1 cm, 0.02 rad" if line[0]["noise"] else "no noise",
        "sample_time": f"$k_2$ = {line[0]['k2']:g} 1/s",
    }[name]
    x = np.array([p[name] for p in line]) * (1e3 if name == "sample_time" else 1.0)
    low, middle, high = np.transpose([p["tail"] for p in line])
    kept = middle < TOP
    y = np.where(kept, middle, np.nan)
    axis.fill_between(x, low, high, where=kept, color=colour, alpha=0.15, linewidth=0)
    axis.plot(x, y, color=colour, label=label)
    axis.plot(x[~kept], np.full((~kept).sum(), 0.97 * TOP), "^", color=colour)
    coarse = np.array([p["k2"] * p["sample_time"] > 0.5 + 1e-9 for p in line])
    for these, face in ((coarse, "white"), (~coarse, colour)):
        axis.plot(x[these], y[these], "o", color=colour, markerfacecolor=face, markersize=3.5)
    crossed = np.array([p["chattered"] > 0 for p in line])
    axis.plot(x[crossed], y[crossed], "x", color=style.BLACK, markersize=5, zorder=4)


# -- part 3: beside weathervaning


def marine(bar: Any, counts: Counts) -> Iterator[Point]:
    """One row for each law and speed of the current, on the full vehicle."""
    system = hf.systems.marine_vehicle("videoray_pro_iii", thrust_limit=5.0, current_limit=1.5)
    hold = unconditional(hf.laws.hold_station(system, **HOLD))
    switching = hf.track_velocity(system, hold, TRACKING)
    vane = hf.track_velocity(system, hf.laws.weathervane(system, **VANE), TRACKING)
    small = {name: HOLD[name] for name in WIDE}
    for name, law, fixed in (
        (f"switching, $r_0$ = {small['r0']:g} m", switching, small),
        (f"switching, $r_0$ = {WIDE['r0']:g} m", switching, WIDE),
        ("weathervane", vane, {}),
    ):
        for speed in MARINE_SPEEDS:
            result = simulate(
                bar, system, law, speed, ANY, counts.marine, box=0.7, fixed=fixed, seed=1,
                horizon=120.0, sample_time=0.02, record_every=0.1,
            )  # fmt: skip
            own = hf.station_statistics(result, fixed.get("r0", R0), settled=60.0)
            late = result.dataset.sel(time=slice(60.0, None))
            thrust = np.abs(late["actuator"].values).sum(axis=2).mean(axis=1)
            share = own["heading_share"].values
            yield {
                "law": name, "speed": speed, "runs": counts.marine,
                "entered": int(own["entered"].sum()),
                "tail": np.percentile(own["tail_radius"], BAND).round(5).tolist(),
                "heading_share": np.round([np.median(share), share.mean()], 5).tolist(),
                "thrust": np.percentile(thrust, BAND).round(5).tolist(),
                "switches": float(own["switches_per_minute"].median()),
            }  # fmt: skip


def draw_marine(rows: list[Point], folder: Path) -> None:
    """Tail, share of time with the wanted heading, and thrust, against the current's speed."""
    panels = {
        "tail": ("largest distance after 60 s [m]", "median, 99 % of runs"),
        "heading_share": ("share of time with |ψ| < 0.1 rad", "solid: mean, dashed: median"),
        "thrust": ("mean thrust $|F_p| + |F_s|$ [N]", "median, 99 % of runs"),
    }
    with style.look():
        figure, axes = plt.subplots(1, 3, layout="constrained", figsize=(style.WIDTH, 2.8))
        names = dict.fromkeys(row["law"] for row in rows)
        for name, colour in zip(names, (style.RED, style.ORANGE, style.BLUE), strict=True):
            own = [row for row in rows if row["law"] == name]
            x = [row["speed"] for row in own]
            for axis, key in zip(axes, panels, strict=True):
                low, middle, *high = np.transpose([row[key] for row in own])
                if high:
                    axis.fill_between(x, low, *high, color=colour, alpha=0.15, linewidth=0)
                else:
                    axis.plot(x, low, "--", color=colour)
                axis.plot(x, middle, "o-", color=colour, markersize=3, label=name)
        for axis, (label, shown) in zip(axes, panels.values(), strict=True):
            axis.set(xlabel="speed of the current [m/s]", ylabel=label, xlim=(0, 0.62))
            axis.set_ylim(bottom=0)
            axis.set_title(shown, fontsize=8)
        lines, labels = axes[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", ncols=3)
    style.write(figure, folder, "station_weathervane")[1].unlink()


def main() -> int:
    """Simulate, print the table, write figures and numbers; 130 when interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--quick", action="store_true", help="a fiftieth of the runs")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="for the figures")
    parser.add_argument("--json", type=Path, default=Path("benchmarks/station_keeping.json"))
    options = parser.parse_args()
    counts, began = QUICK if options.quick else Counts(), time.perf_counter()
    try:
        with tqdm(total=counts.runs, unit=" runs", unit_scale=True, smoothing=0.05) as bar:
            rows, panels = list(kinematic(bar, counts)), tails(bar, counts)
            beside = list(marine(bar, counts))
    except KeyboardInterrupt:
        print("interrupted: nothing was written", file=sys.stderr)
        return 130
    show(rows)
    draw_tails(panels, options.out)
    draw_marine(beside, options.out)
    numbers = {
        "version": hf.__version__, "cores": len(os.sched_getaffinity(0)),
        "wall_time_s": round(time.perf_counter() - began), "counts": asdict(counts), "hold": HOLD,
        "wide": WIDE, "weathervane": VANE, "tracking": TRACKING,
        "kinematic": rows, "tail": panels, "marine": beside,
    }  # fmt: skip
    options.json.write_text(json.dumps(numbers, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
