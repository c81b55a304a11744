"""Random problems of viability: texts with named numbers, so that a structure compiles once.

The structure (formulas, shapes of sets, kind of problem) is that of `number // ALIKE`, the numbers
are those of `number`. Formulas know x, y, z, u0, u1, d0, d1, t, the numbers p0, p1, ..., and the
functions of `attacks.enclosures`. Rates are affine in u and d.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

ALIKE = 8
"""Problems in a row with one structure."""
TURN = 2 * np.pi
STATES = "xyz"


@dataclass(frozen=True)
class Problem:
    """A problem in plain numbers, in the units in which the oracle sees it.

    kind: "kernel", "invariance", "basin" or "tube". rates, region, goal: formulas. inputs and
    disturbances: ["box", low, high], ["ball", radius, dimension] or ["image", matrix, low, high].
    angles: which states are. low, high, nodes: of the grid. scales: what a state is multiplied with
    for the product, clock: the same for time. literal: whether numbers are written into formulas.
    """

    kind: str
    form: str
    rates: tuple[str, ...]
    region: tuple[str, ...]
    goal: tuple[str, ...]
    numbers: dict[str, float]
    inputs: list[Any] | None
    disturbances: list[Any] | None
    angles: tuple[bool, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    nodes: tuple[int, ...]
    horizon: float
    ends: str = "wide"
    scheme: str = "weno5"
    options: dict[str, Any] = field(default_factory=dict)
    scales: tuple[float, ...] = ()
    clock: float = 1.0
    literal: bool = False

    @property
    def states(self) -> str:
        return STATES[: len(self.rates)]

    @property
    def moves(self) -> bool:
        """Whether the region depends on time."""
        return any("t" in words(c) for c in self.region)

    @property
    def cells(self) -> np.ndarray:
        """Lengths of the cells of the product's grid."""
        steps = [n if a else n - 1 for n, a in zip(self.nodes, self.angles, strict=True)]
        return (np.array(self.high) - np.array(self.low)) / np.array(steps)

    def plain(self) -> dict[str, Any]:
        return asdict(self)


def problem_of(plain: dict[str, Any]) -> Problem:
    """The problem that `Problem.plain` wrote."""
    tuples = ("rates", "region", "goal", "angles", "low", "high", "nodes", "scales")
    return Problem(**{k: tuple(v) if k in tuples else v for k, v in plain.items()})


def words(formula: str) -> set[str]:
    """The names in a formula."""
    plain = "".join(c if c.isalnum() or c == "_" else " " for c in formula)
    return {w for w in plain.split() if not w[0].isdigit()}


class Structure:
    """Draws formulas; every number in them becomes a name with a range."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator
        self.ranges: list[tuple[float, float, bool]] = []

    def number(self, low: float, high: float, signed: bool = False) -> str:
        """The name of a number between `low` and `high`, or of either sign."""
        self.ranges.append((low, high, signed))
        return f"p{len(self.ranges) - 1}"

    def one_of(self, *options: Any, weights: Sequence[float] | None = None) -> Any:
        if weights is None:
            return options[int(self.generator.integers(len(options)))]
        share = np.array(weights) / np.sum(weights)
        return options[int(self.generator.choice(len(options), p=share))]

    def chance(self, share: float) -> bool:
        return bool(self.generator.random() < share)


def rounded(value: float) -> float:
    """Three digits: numbers that a person would write."""
    return float(f"{value:.3g}")


def drawn(generator: np.random.Generator, low: float, high: float, signed: bool = False) -> float:
    sign = float(generator.choice([-1.0, 1.0])) if signed else 1.0
    return rounded(sign * float(generator.uniform(low, high)))


def rates_of(s: Structure, d: str, d1: str) -> tuple[str, list[str], list[bool]]:
    """(form, rates, which states are angles): 25 forms in one to three states."""
    n = s.number

    def a() -> str:
        return n(0.1, 1.5, True)

    def b() -> str:
        return n(0.4, 1.5)

    def c() -> str:
        return n(0.1, 0.8, True)

    forms: dict[str, Callable[[], list[str]]] = {
        # one state
        "line": lambda: [f"{a()}*x + {b()}*u0{d}"],
        "wave": lambda: [f"{a()}*sin({n(1, 3)}*x) + {b()}*u0{d}"],
        "gain": lambda: [f"({n(0.3, 1.5)} + {c()}*x)*u0 + {a()}*x{d}"],
        "drag": lambda: [f"{a()}*x*abs(x) + {b()}*u0{d}"],
        "kink": lambda: [
            s.one_of(
                f"max({a()}*x, {c()}) + {b()}*u0{d}",
                f"min({a()}*x, {n(0, 0.5)}) + {b()}*u0{d}",
                f"{a()}*abs(x) + {b()}*u0{d}",
            )
        ],
        "ring": lambda: [f"{a()}*sin(x) + {c()}*cos(2*x) + {b()}*u0{d}"],
        "fast": lambda: [f"{n(2, 6)}*x + {n(0.5, 2)}*u0{d}"],
        # two states
        "cart": lambda: [
            "y",
            s.one_of(
                f"{a()}*x + {b()}*u0{d}",
                f"{a()}*y*abs(y) + {b()}*u0{d}",
                f"{a()}*sin(2*x) + {c()}*y + {b()}*u0{d}",
                f"{b()}*u0{d}",
            ),
        ],
        "plane": lambda: [f"{a()}*x + {c()}*y + {c()}*u0", f"{c()}*x + {a()}*y + {b()}*u0{d}"],
        "turned": lambda: [f"y*u0 + {c()}*x", f"-x*u0 + {a()}*y + {b()}*u1{d}"],
        "lane": lambda: [f"{b()}*sin(y) + {c()}*cos(y){d}", f"{n(0.5, 2)}*u0"],
        "free": lambda: [f"u0 + {a()}*y{d}", f"u1 + {c()}*x*abs(y){d1}"],
        "pendulum": lambda: ["y", f"{a()}*sin(x) + {b()}*u0{d}"],
        "bent": lambda: [f"max(y, {c()}) + {c()}*x", f"min({a()}*x, {n(0, 1)}) + {b()}*u0{d}"],
        "still": lambda: [f"{a()}*x*y + {b()}*u0{d}", "0*x"],
        "stiff": lambda: ["y", f"{n(4, 9)}*u0 - {n(5, 15)}*y{d}"],
        "traded": lambda: [f"{b()}*u0 + {n(0.1, 0.6)}*y{d}", f"{b()}*u0 + {c()}*x + {a()}"],
        "boat": lambda: [f"u0*cos(y) + {c()}{d}", f"{b()}*u1"],
        "modes": lambda: [f"{a()} + u0*{n(0.8, 2, True)}{d}", f"{c()} + u0*{n(0.3, 1.5, True)}"],
        "converter": lambda: [
            f"{n(0.1, 0.5)} - {n(0.01, 0.1)}*x - u0*({n(0.01, 0.1)}*x + {n(0.1, 0.5)}*y)",
            f"u0*{n(0.1, 0.5)}*x - {n(0.01, 0.2)}*y + {c()}{d}",
        ],
        "saddle": lambda: [f"{b()}*x + u0{d}", f"{b()}*y + u1{d1}"],
        # three states
        "car": lambda: [f"{b()}*cos(z) + {c()}{d}", f"{b()}*sin(z)", f"{n(0.5, 2)}*u0"],
        "chain": lambda: ["y", "z", f"{a()}*x + {b()}*u0{d}"],
        "craft": lambda: [f"u0*cos(z){d}", "u0*sin(z)", f"{b()}*u1"],
        "lagged": lambda: ["y", f"z{d}", f"{n(2, 8)}*(u0 - z)"],
    }
    sizes = {"line": 1, "wave": 1, "gain": 1, "drag": 1, "kink": 1, "ring": 1, "fast": 1}
    sizes |= {"car": 3, "chain": 3, "craft": 3, "lagged": 3}
    count = s.one_of(1, 2, 3, weights=(0.3, 0.62, 0.08))
    form = s.one_of(*(f for f in forms if sizes.get(f, 2) == count))
    rates = forms[form]()
    turning = {
        "ring": [True],
        "lane": [False, True],
        "boat": [False, True],
        "pendulum": [True, False],
        "car": [False, False, True],
        "craft": [False, False, True],
    }
    return form, rates, turning.get(form, [False] * count)


def region_of(
    s: Structure, names: str, angles: Sequence[bool], half: list[str], moving: bool
) -> list[str]:
    """Inequalities c <= 0 that bound every state which is no angle, and some more."""
    n = s.number
    line = [i for i in range(len(names)) if not angles[i]]
    q, w = [names[i] for i in line], [half[i] for i in line]
    region: list[str] = []
    shape = s.one_of("bands", "walls", "disc", "sum", "max", "skew") if len(q) > 1 else "walls"
    if not line:
        region.append(f"cos(x - {n(0, 6)}) - {n(0.3, 0.9)}")
    elif shape == "bands":
        region += [f"abs({m}) - {v}" for m, v in zip(q, w, strict=True)]
    elif shape == "walls":
        region += [t for m, v in zip(q, w, strict=True) for t in (f"{m} - {v}", f"0 - {v} - {m}")]
    elif shape == "disc":
        terms = " + ".join(f"({m}/{v})**2" for m, v in zip(q, w, strict=True))
        region.append(s.one_of(f"{terms} - 1", f"sqrt({terms}) - 1"))
    elif shape == "sum":
        region.append(" + ".join(f"abs({m})/{v}" for m, v in zip(q, w, strict=True)) + " - 1")
    elif shape == "max":
        region.append(f"max(abs({q[0]}) - {w[0]}, abs({q[1]}) - {w[1]})")
        region += [f"abs({m}) - {v}" for m, v in zip(q[2:], w[2:], strict=True)]
    else:  # |x - k y| <= w: every way inward may cost first
        lean = n(0.05, 0.4, True)
        region += [f"{q[0]} - {lean}*{q[1]} - {w[0]}", f"{lean}*{q[1]} - {w[0]} - {q[0]}"]
        region += [f"abs({m}) - {v}" for m, v in zip(q, w, strict=True)]
    for _ in range(int(s.generator.integers(0, 3))):
        m, k = s.one_of(*names), s.one_of(*names)
        if angles[names.index(m)]:
            region.append(
                s.one_of(
                    f"cos({m} - {n(0, 6)}) - {n(0.5, 0.9)}",
                    f"abs(sin({m} - {n(0, 6)})) - {n(0.6, 0.95)}",
                )
            )
        elif m == k or angles[names.index(k)]:
            region.append(
                s.one_of(f"{m} - {n(0.3, 0.7)}", f"{n(0.02, 0.1)} - ({m} - {n(0.4, 0.6, True)})**2")
            )
        else:
            region.append(
                s.one_of(
                    f"{n(0.5, 1, True)}*{m} + {n(0.5, 1, True)}*{k} - {n(0.4, 0.9)}",
                    f"{n(0.03, 0.15)} - ({m} - {n(0.2, 0.6, True)})**2"
                    f" - ({k} - {n(0.2, 0.6, True)})**2",
                    f"abs({m} + {n(0.5, 1, True)}*{k}) - {n(0.15, 0.6)}",
                    f"{m}*{k} - {n(0.1, 0.4)}",
                    f"min({m} - {n(0, 0.3, True)}, {k} - {n(0, 0.3, True)})",
                )
            )
    if moving and line:
        region.append(f"{q[0]} - {n(0.3, 0.6)} - {n(0.05, 0.4, True)}*t")
    return region


KINDS = ("kernel", "kernel", "kernel", "kernel", "basin", "basin", "invariance", "tube")
OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {},
    {},
    {"refine": 2},
    {"band": 0.25},
    {"precision": "float32"},
    {"dissipation": "global"},
    {"dissipation": "local"},
    {"cfl": 0.95},
    {"order": 1},
    {"order": 3},
    {"tolerance": 0.1},
)


def problem(seed: int, number: int, kinds: Sequence[str] = KINDS) -> Problem:
    """The problem of a number."""
    s = Structure(np.random.default_rng([seed, number // ALIKE, 7]))
    g = np.random.default_rng([seed, number, 8])
    kind = s.one_of(*kinds)
    pushed = s.chance(0.5)
    second = pushed and s.chance(0.5)
    form, rates, angles = rates_of(s, " + d0" if pushed else "", " + d1" if second else "")
    second = second and "d1" in "".join(rates)
    pushed = pushed and "d0" in "".join(rates)
    names = STATES[: len(rates)]
    half = [s.number(0.6, 1.4) for _ in names]
    moving = kind == "kernel" and s.chance(0.08)
    region = region_of(s, names, angles, half, moving)
    centre = [s.number(0, 6) if t else s.number(0, 0.4, True) for t in angles]
    goal = " + ".join(
        f"(sin(({m} - {c})/2)/0.35)**2" if t else f"(({m} - {c})/(0.4*{h}))**2"
        for m, c, h, t in zip(names, centre, half, angles, strict=True)
    )
    two = "u1" in "".join(rates)
    blended = form in ("modes", "converter")
    bound = (
        "unit"
        if blended
        else s.one_of("box", "box", "image", "ball")
        if two
        else s.one_of("box", "box", "ball")
    )
    rim = second and s.chance(0.5)
    # what follows are the numbers of this problem
    numbers = {f"p{i}": drawn(g, *r) for i, r in enumerate(s.ranges)}
    low, high = [], []
    ends = str(g.choice(["on", "slightly", "slightly", "wide", "wide", "wide"]))
    for t, h in zip(angles, half, strict=True):
        beyond = {"on": 0.0, "slightly": drawn(g, 0.01, 0.05), "wide": drawn(g, 0.2, 0.6)}[ends]
        if t:
            low.append(float(g.choice([-np.pi, 0.0, drawn(g, 0, 3, True)])))
            high.append(low[-1] + TURN)
        else:
            size = numbers[h] * (1 + beyond)
            low.append(-size if ends == "on" else -rounded(size))
            high.append(-low[-1])
    horizon = (
        drawn(g, 0.3, 2.0) if kind in ("basin", "tube") or moving or g.random() < 0.3 else 30.0
    )
    many = {1: (21, 102), 2: (19, 42), 3: (13, 20)}[len(names)]
    units = g.random() < 0.3
    return Problem(
        kind=kind,
        form=form,
        rates=tuple(rates),
        region=tuple(region),
        goal=(goal + " - 1",),
        numbers=numbers,
        inputs=_inputs(g, bound, 2 if two else 1),
        disturbances=_disturbances(g, pushed, second, rim),
        angles=tuple(angles),
        low=tuple(low),
        high=tuple(high),
        nodes=tuple(int(g.integers(*many)) for _ in names),
        horizon=horizon,
        ends=ends,
        scheme=str(g.choice(["upwind", "eno2", "eno3", "weno5", "weno5"])),
        options={} if moving else dict(OPTIONS[int(g.integers(len(OPTIONS)))]),
        scales=tuple(
            1.0 if t or not units else float(10.0 ** int(g.integers(-4, 5))) for t in angles
        ),
        clock=float(10.0 ** int(g.integers(-2, 3))) if units else 1.0,
        literal=bool(g.random() < 0.03),
    )


def _inputs(g: np.random.Generator, bound: str, size: int) -> list[Any]:
    if bound == "unit":
        return ["box", [0.0], [1.0]]
    if bound == "ball":
        return ["ball", drawn(g, 0.4, 1), size]
    if bound == "image":
        skew = drawn(g, 0.3, 1, True)
        return ["image", [[0.5, 0.5], [skew, -skew]], [-1.0, -1.0], [1.0, 1.0]]
    one_sided = g.random() < 0.15
    low = [drawn(g, 0, 0.3) if one_sided and i == 0 else -drawn(g, 0.3, 1) for i in range(size)]
    return ["box", low, [drawn(g, 0.4, 1) for _ in range(size)]]


def _disturbances(
    g: np.random.Generator, pushed: bool, second: bool, rim: bool
) -> list[Any] | None:
    if not pushed:
        return None
    most = drawn(g, 0.4, 0.8) if g.random() < 0.2 else drawn(g, 0.05, 0.4)
    if rim:
        return ["ball", most, 2]
    size = 2 if second else 1
    return ["box", [-most] * size, [rounded(most * float(g.uniform(0.5, 1))) for _ in range(size)]]


def times(bound: list[Any] | None, factor: float) -> list[Any] | None:
    """A bound so many times as large; the box of an image."""
    if bound is None:
        return None
    if bound[0] == "ball":
        return ["ball", rounded(factor * bound[1]), bound[2]]
    return [*bound[:-2], *([rounded(factor * v) for v in side] for side in bound[-2:])]


def widened(p: Problem) -> Problem:
    """The same on a grid that ends farther from the constraints, with cells of about that size."""
    low, high, nodes = [], [], []
    for a, b, n, t in zip(p.low, p.high, p.nodes, p.angles, strict=True):
        beyond = 0.0 if t else 0.3 * (b - a)
        low.append(a - beyond)
        high.append(b + beyond)
        nodes.append(n if t else int(n * 1.6))
    return replace(p, low=tuple(low), high=tuple(high), nodes=tuple(nodes), ends="wide")
