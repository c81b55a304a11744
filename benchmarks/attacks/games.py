"""Games of a keeper, whose basins have a closed form: may a lost start be won without a word?

A player at x, of speed 1, wins between the posts |x| <= 1 where the keeper at k, of speed c >= 1,
is more than r away; he does so from |k - x'| > r + c max(|x| - 1, 0), with x' the nearest place
between the posts, and from nowhere else. The states are x and k, or x and z = k - x.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

import holdfast as hf
from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from holdfast.errors import HoldfastError

TOLERANCE = 2.5
"""Cells by which a set may differ from the exact one."""
RESOLVED = 3.5
"""Cells to each side that a keeper covers: of three no scheme on a grid leaves anything."""
HORIZON = 4.0
SENTENCES = {
    "won but lost": "a basin has starts that are lost, and none is said to be disputed",
    "lost but won": "a basin lacks starts that are won",
}


@dataclass(frozen=True)
class Game:
    """over: "k" or "z", the other state. length, clock: units in metres and seconds."""

    over: str
    speed: float
    reach: float
    cells: int
    scheme: str
    length: float = 1.0
    clock: float = 1.0

    @property
    def side(self) -> float:
        """Half the width of the grid [m]."""
        return 1.3 + self.reach


def game(seed: int, number: int) -> Game:
    """A keeper who covers `RESOLVED` cells at least to each side."""
    g = np.random.default_rng([seed, number, 11])
    reach = float(g.uniform(0.2, 0.6))
    fewest = math.ceil(RESOLVED * 2 * (1.3 + reach) / reach)
    return Game(
        str(g.choice(["k", "z"])),
        float(np.exp(g.uniform(0, np.log(3))) if g.random() < 0.8 else 1.0),
        reach,
        fewest + int(g.integers(40)),
        str(g.choice(["upwind", "eno2", "eno3", "weno5"])),
        10.0 ** int(g.integers(-2, 3)),
        10.0 ** int(g.integers(-2, 3)),
    )


def basin(p: Game) -> hf.ValueFunction:
    m, pace = p.length, p.length / p.clock
    apart, rate = {"k": ("x - k", "d"), "z": ("z", "d - u")}[p.over]
    system = hf.System(
        "keeper", (hf.Quantity("x"), hf.Quantity(p.over)), (hf.Quantity("u"),),
        {"x": "u", p.over: rate}, input_bounds=hf.Box((-pace,), (pace,)),
        disturbances=(hf.Quantity("d"),),
        disturbance_bounds=hf.Box((-p.speed * pace,), (p.speed * pace,)),
    )  # fmt: skip
    rows = {
        "posts": f"abs(x) - {m}",
        "past": f"{p.reach * m} - abs({apart})",
        "near": f"abs({apart}) - {(p.side - 0.2) * m}",
    }
    goal = hf.Region("goal", system.states, tuple(hf.Inequality(n, e) for n, e in rows.items()))
    box = {q.name: (-p.side * m, p.side * m) for q in system.states}
    grid = hf.grid(system, box, p.cells + 1, dict.fromkeys(box, "limited"))
    return hf.capture_basin(
        system, goal, None, grid, HORIZON * p.clock, scheme=p.scheme, arrival_steps=0
    )


def verdict(p: Game) -> dict[str, Any]:
    """Nodes that are won though they are lost by some cells, without a dispute; and the reverse."""
    value = basin(p)
    x, y = np.meshgrid(*(a.nodes / p.length for a in value.grid.axes), indexing="ij")
    keeper = y + x if p.over == "z" else y
    beyond = np.maximum(np.abs(x) - 1, 0)
    apart = np.abs(keeper - np.clip(x, -1, 1))
    ahead = apart - p.reach - p.speed * beyond
    cell = 2 * p.side / p.cells
    changes = (1 + p.speed + (p.over == "z")) * cell
    won, sure = value.values() > 0, TOLERANCE * changes
    within = np.maximum(apart, np.abs(y)) < p.side - 0.2 - 3 * cell  # of what the goal has
    said = bool(value.report.disputed_share)
    return {
        "nodes": won.size,
        "lost": int((ahead < -sure).sum()),
        "disputed": int(said),
        "won but lost": 0 if said else int((won & (ahead < -sure)).sum()),
        "lost but won": int((~won & (ahead > sure) & within & (beyond == 0)).sum()),
    }


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, game(seed, number)))


def _attempt(p: Game, outcome: Outcome) -> None:
    told = verdict(p)
    outcome.judged = 1
    outcome.counts = {k: told[k] for k in ("nodes", "lost", "disputed")}
    for what, sentence in SENTENCES.items():
        if told[what]:
            outcome.faults.append(Fault(sentence, f"{p}: {told}"))


def wrong(p: Game, what: str) -> bool:
    """Whether a game has this fault."""
    try:
        return bool(verdict(p)[what])
    except HoldfastError:
        return False


def smaller(p: Game) -> Iterator[Game]:
    """Simpler games, the boldest changes first."""
    if (p.length, p.clock) != (1.0, 1.0):
        yield replace(p, length=1.0, clock=1.0)
    if p.scheme != "upwind":
        yield replace(p, scheme="upwind")
    fewer = max(math.ceil(RESOLVED * 2 * p.side / p.reach), p.cells * 3 // 4)
    if fewer < p.cells:
        yield replace(p, cells=fewer)
    for digits in (1, 2):
        short = replace(
            p, speed=float(f"{p.speed:.{digits}g}"), reach=float(f"{p.reach:.{digits}g}")
        )
        if short != p:
            yield short


def shrink(seed: int, number: int, fault: Fault) -> None:
    p = game(seed, number)
    what = next((w for w, s in SENTENCES.items() if fault.signature == s), None)
    if what is None:
        body = f"print(attempt({seed}, {number}).faults)\n"
    else:
        p = writing.shrunk(p, smaller, partial(wrong, what=what), seconds=40)
        body = f"print(verdict(Game(**{asdict(p)!r})))\n"
    title = f"{fault.signature}.\n\n{fault.message}"
    fault.text = writing.alone(title, ("case", "writing", "games"), body)


KIND = Kind("games", attempt, shrink, seconds=90.0, shown=("nodes", "lost", "disputed"))
