"""Identification: random craft, inputs and noise; do intervals hold the truth as often as said?"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import holdfast as hf
from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from attacks.problems import drawn

LEVEL = 0.95
RARE = 1e-4
"""The chance, if intervals held what they say, below which a count is called a fault."""

Rates = Callable[[dict[str, float], np.ndarray, np.ndarray], np.ndarray]


def craft(number: int) -> tuple[hf.System, list[str], dict[str, tuple[float, float]], Rates]:
    """(system, what to estimate, ranges, the rates in NumPy) of one of four craft."""
    s = hf.symbol
    quantity, parameter = hf.Quantity, hf.Parameter
    form = number // 8 % 4
    if form == 0:  # surge with linear and quadratic drag
        ranges = {"a": (0.5, 3), "b": (0.5, 4)}
        system = hf.System(
            "surge",
            (quantity("v", "m/s"),),
            (quantity("X", "N"),),
            {"v": (s("X") - s("a") * s("v") - s("b") * s("v") * abs(s("v"))) / s("m")},
            input_bounds=hf.Box((-10,), (10,)),
            parameters=(
                parameter("a", "kg/s", value=1.0),
                parameter("b", "kg/m", value=1.0),
                parameter("m", "kg", value=4.0),
            ),
            empirical="numbers",
        )
        return (
            system,
            ["a", "b"],
            ranges,
            lambda p, q, u: np.array([(u[0] - p["a"] * q[0] - p["b"] * q[0] * abs(q[0])) / 4.0]),
        )
    if form == 1:  # a heading and its rate
        ranges = {"c": (0.3, 2), "k": (0.5, 3)}
        system = hf.System(
            "yaw",
            (quantity("psi", "rad"), quantity("r", "rad/s")),
            (quantity("n", "N m"),),
            {"psi": s("r"), "r": s("k") * s("n") - s("c") * s("r")},
            input_bounds=hf.Box((-10,), (10,)),
            parameters=(parameter("c", "1/s", value=1.0), parameter("k", "1/(kg m^2)", value=1.0)),
            empirical="numbers",
        )
        return (
            system,
            ["c", "k"],
            ranges,
            lambda p, q, u: np.array([q[1], p["k"] * u[0] - p["c"] * q[1]]),
        )
    if form == 2:  # a pendulum
        ranges = {"w": (1, 5), "z": (0.2, 1.5)}
        system = hf.System(
            "pendulum",
            (quantity("th", "rad"), quantity("r", "rad/s")),
            (quantity("n", "1/s^2"),),
            {
                "th": s("r"),
                "r": s("n")
                - s("w") * hf.parse_expression("sin(th)", {"th": s("th")})
                - s("z") * s("r"),
            },
            input_bounds=hf.Box((-10,), (10,)),
            parameters=(parameter("w", "1/s^2", value=2.0), parameter("z", "1/s", value=0.5)),
            empirical="numbers",
        )
        return (
            system,
            ["w", "z"],
            ranges,
            lambda p, q, u: np.array([q[1], u[0] - p["w"] * np.sin(q[0]) - p["z"] * q[1]]),
        )
    ranges = {
        "a": (0.3, 1.5),
        "c": (0.3, 1.5),
        "h": (0.3, 1.5),
    }  # surge and sway that feed each other
    system = hf.System(
        "coupled",
        (quantity("u", "m/s"), quantity("v", "m/s")),
        (quantity("X", "m/s^2"), quantity("Y", "m/s^2")),
        {"u": s("X") - s("a") * s("u") + s("h") * s("v"), "v": s("Y") - s("c") * s("v")},
        input_bounds=hf.Box((-10, -10), (10, 10)),
        parameters=tuple(parameter(n, "1/s", value=1.0) for n in ranges),
        empirical="numbers",
    )
    return (
        system,
        list(ranges),
        ranges,
        lambda p, q, u: np.array([u[0] - p["a"] * q[0] + p["h"] * q[1], u[1] - p["c"] * q[1]]),
    )


def trial(seed: int, number: int) -> list[dict[str, Any]]:
    """For each number: what it is, its interval, and what is said of it."""
    g = np.random.default_rng([seed, number, 15])
    system, names, ranges, rates = craft(number)
    truth = {n: drawn(g, *ranges[n]) for n in names}
    dt, count = float(g.choice([0.05, 0.1])), int(g.integers(400, 900))
    time = dt * np.arange(count)
    width, height = len(system.inputs), drawn(g, 0.5, 3)
    pieces = np.repeat(g.uniform(-height, height, (count // 8 + 1, width)), 8, axis=0)[:count]
    q, path = np.zeros(len(system.states)), []
    for k in range(count):
        path.append(q)
        for _ in range(4):
            h = dt / 4
            a = rates(truth, q, pieces[k])
            b = rates(truth, q + h / 2 * a, pieces[k])
            c = rates(truth, q + h / 2 * b, pieces[k])
            q = q + h / 6 * (a + 2 * b + 2 * c + rates(truth, q + h * c, pieces[k]))
    clean = np.array(path)
    noise = float(g.choice([0.003, 0.01, 0.03])) * np.std(clean, axis=0)
    measured = clean + noise * g.standard_normal(clean.shape)
    log = hf.Log(
        "drawn",
        {n: hf.Signal(time, v) for n, v in zip(system.state_names, measured.T, strict=True)},
        {n: hf.Signal(time, v) for n, v in zip(system.input_names, pieces.T, strict=True)},
        gap=10 * dt,
    )
    found = hf.identify(system, log, estimate=names, level=LEVEL)
    return [
        {
            "name": e.name,
            "truth": truth[e.name],
            "low": e.low,
            "high": e.high,
            "said": str(getattr(e.status, "value", e.status)),
        }
        for e in found.parameters
        if e.name in truth
    ]


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, seed, number))


def _attempt(seed: int, number: int, outcome: Outcome) -> None:
    for told in trial(seed, number):
        if not (math.isfinite(told["low"]) and math.isfinite(told["high"])):
            outcome.counts["without an interval"] = outcome.counts.get("without an interval", 0) + 1
            continue
        outcome.judged = 1
        outcome.counts["intervals"] = outcome.counts.get("intervals", 0) + 1
        holds = bool(told["low"] <= told["truth"] <= told["high"])
        outcome.counts["hold"] = outcome.counts.get("hold", 0) + int(holds)
        outcome.notes.append((number // 8 % 4, told["name"], holds))


def chance_of_at_most(held: int, count: int, level: float) -> float:
    """P(X <= held) of a binomial X."""
    logs = [
        math.lgamma(count + 1)
        - math.lgamma(k + 1)
        - math.lgamma(count - k + 1)
        + k * math.log(level)
        + (count - k) * math.log1p(-level)
        for k in range(held + 1)
    ]
    return min(1.0, sum(math.exp(v) for v in logs))


def conclude(notes: list[Any]) -> list[Fault]:
    """Intervals that hold the truth less often than they say: in all, and of each number."""
    groups: dict[str, list[bool]] = {"all numbers": [h for _, _, h in notes]}
    for form, name, holds in notes:
        groups.setdefault(f"{name} of craft {form}", []).append(holds)
    faults = []
    for name, held in groups.items():
        chance = chance_of_at_most(sum(held), len(held), LEVEL) if held else 1.0
        if chance < RARE:
            faults.append(
                Fault(
                    f"intervals of {LEVEL:.0%} hold the truth too seldom: {name}",
                    f"{sum(held)} of {len(held)}, a chance of {chance:.1g}",
                )
            )
    return faults


def shrink(seed: int, number: int, fault: Fault) -> None:
    fault.text = writing.alone(
        f"{fault.signature}.\n\n{fault.message}",
        ("case", "problems", "writing", "identification"),
        f"print(trial({seed}, {number}))\n",
    )


KIND = Kind(
    "identification",
    attempt,
    shrink,
    share=0.7,
    seconds=60.0,
    conclude=conclude,
    shown=("intervals", "hold"),
)
