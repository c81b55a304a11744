"""From which starts some admissible trajectory comes to rest in a current, where the law does not.

python benchmarks/current_reach.py [--only NAME] [--limit 25] [--guesses 5]

It needs casadi. The starts are those that a scenario leaves on the way (`inspection-swift-current`,
`otter-current`) in currents 7 degrees or more off the wall. First the same law with other numbers:
where it comes to rest, its run is a trajectory. Then optimal control with the whole model: six
states, the limits of each thruster, c(q) <= 0 at every node and between them, from rest at the
start to rest at the goal, the duration of every interval free within limits. Hermite-Simpson
collocation, inputs held in an interval, IPOPT. Initial guesses: the runs of the law from the same
start in slower currents, the runs from the nearest starts that come to rest in the same current
(and mirrored), the run that fails.

A trajectory counts only where `hf.Plant` follows it by a linear-quadratic regulator (inputs held
for 0.02 s, limited as the thrusters are) in view to 1e-3 all the way, arrives, and stays at the
goal for 10 s more. Where none is found nothing is proven. `current_reach.json` is the record.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import sympy as sp
from scipy.linalg import solve_discrete_are

import holdfast as hf
from holdfast.execution.leaf import Evaluator

try:
    import casadi as ca
except ImportError:
    raise SystemExit("this benchmark needs casadi: python -m pip install casadi") from None

RECORD = Path(__file__).with_suffix(".json")
HALF = math.radians(83)  # of the directions that the scenarios go to: `bearing_max`
SAMPLE, STAY, TOLERANCE = 0.02, 10.0, 1e-3  # s, s, rad or m
MARGIN = 0.006  # rad or m, of the constraints at the nodes, lengths times that of the VideoRay
SHORT, LONG = 0.3, 1.6  # the duration of an interval by that of the guess
STATES = ("x", "y", "psi", "u", "v", "r")
MIRROR = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Case:
    """A scenario at one speed; `length`: its lengths are multiples of those of the VideoRay."""

    scenario: str
    speed: float  # m/s
    length: float
    horizon: float  # s
    interval: float  # s
    slower: tuple[float, ...]  # m/s
    numbers: tuple[tuple[str, ...], ...]

    @property
    def name(self) -> str:
        return f"{self.scenario} {self.speed:g} m/s"


CASES = (
    Case(
        "inspection-swift-current", 0.2, 1.0, 150.0, 0.12, (0.15, 0.1),
        (
            ("law.leg_speed=0.78",),
            ("law.near_margin=0.38",),
            ("law.near_margin=0.48",),
            ("law.kv=8", "tracking.r=20", "safeguard.gains=[4.0, 8.0]"),
            ("law.exponent=1.5", "law.mu=1.8"),
        ),
    ),
    Case(
        "otter-current", 0.3, 5.0, 300.0, 0.3, (0.2, 0.1),
        (
            ("law.near_margin=0.8",),
            ("law.leg_speed=1.4",),
            ("law.k1=0.3",),
            ("law.kv=2.6", "tracking.u=2.6", "tracking.r=11"),
            ("law.far_share=-0.4",),
        ),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Runs:
    """What became of the starts: rows are runs. `along`: the heading of the place at rest."""

    time: np.ndarray
    state: np.ndarray
    actuator: np.ndarray
    direction: np.ndarray
    rest: np.ndarray

    @cached_property
    def along(self) -> np.ndarray:
        return np.arctan(np.tan(self.direction))


def runs_of(case: Case, speed: float, *changes: str, every: float = 0.2) -> Runs:
    draws = f"varied.draws.speed.range=[{speed}, {speed}]"
    overrides = [draws, f"run.record_every={every}", *changes]
    data = hf.load_scenario(case.scenario, overrides).run().dataset
    return Runs(
        data["time"].values,
        data["state"].values,
        data["actuator"].values,
        data["varied"].sel(varied_name="direction").values,
        data["outcome"].values == hf.Outcome.REACHED,
    )


@dataclass(frozen=True)
class Course:
    """A guess or a solution: states at the nodes, inputs and durations of the intervals."""

    states: np.ndarray
    inputs: np.ndarray
    durations: np.ndarray


@dataclass
class Problem:
    """The model, the view and the goal of a case, for CasADi and for the check."""

    case: Case
    solvers: dict[int, tuple[object, object]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        scenario = hf.load_scenario(self.case.scenario)
        self.system, self.region = scenario.system, scenario.region
        numbers = {p.symbol: p.value for p in self.system.parameters}
        bounds = self.system.input_bounds
        self.matrix = np.array(bounds.matrix.xreplace(numbers), dtype=float)
        self.low, self.high = (
            np.array([float(sp.sympify(b).xreplace(numbers)) for b in side])
            for side in (bounds.of.lower, bounds.of.upper)
        )
        smooth = {
            "magnitude": lambda a: ca.sqrt(a * a + 1e-8),
            "wrap": lambda a: a,
            "angle": lambda b, a, guard: ca.atan2(b, a),
            "cos": ca.cos,
            "sin": ca.sin,
        }
        names = (*STATES, "tau_u", "tau_r", "Vx", "Vy")
        rates = sp.lambdify(
            [hf.symbol(n) for n in names],
            [self.system.rates[n].xreplace(numbers) for n in STATES],
            [smooth],
        )
        seen = {p.symbol: p.value for p in self.region.parameters}
        view = sp.lambdify(
            [hf.symbol(n) for n in STATES[:3]],
            [c.expression.xreplace(seen) for c in self.region.inequalities],
            [smooth],
        )
        q, w, current = ca.SX.sym("q", 6), ca.SX.sym("w", 2), ca.SX.sym("V", 2)
        force = ca.DM(self.matrix) @ w
        parts = [*ca.vertsplit(q), *ca.vertsplit(force), *ca.vertsplit(current)]
        rate = ca.vertcat(*rates(*parts))
        self.rate = ca.Function("rate", [q, w, current], [rate])
        self.slopes = ca.Function(
            "slopes", [q, w, current], [ca.jacobian(rate, q), ca.jacobian(rate, w)]
        )
        self.view = ca.Function("view", [q], [ca.vertcat(*view(*parts[:3]))])
        self.judge = Evaluator(
            [c.expression for c in self.region.inequalities],
            [hf.symbol(n) for n in STATES],
            self.region.parameters,
        )
        after, h = ca.SX.sym("after", 6), ca.SX.sym("h")
        f0, f1 = self.rate(q, w, current), self.rate(after, w, current)
        middle = (q + after) / 2 + h / 8 * (f0 - f1)
        defect = after - q - h / 6 * (f0 + 4 * self.rate(middle, w, current) + f1)
        self.defect = ca.Function("defect", [q, after, w, h, current], [defect])
        self.between = ca.Function("between", [q, after, w, h, current], [self.view(middle)])
        self.scale = np.array([*[self.case.length] * 2, 1.0, 1.0, 1.0, 1.0])

    def goal(self, along: float) -> np.ndarray:
        ahead = 1.2 * self.case.length
        return np.array([-ahead * math.cos(along), -ahead * math.sin(along), along])

    def rest(self, direction: float, along: float) -> tuple[np.ndarray, np.ndarray]:
        """States and thrusts of the place at rest."""
        current = self.current(direction)
        surge = -self.case.speed * math.cos(direction - along)
        state = np.array([*self.goal(along), surge, 0.0, 0.0])
        inertia = np.array(self.slopes(state, [0, 0], current)[1])
        push = -np.linalg.lstsq(
            inertia, np.array(self.rate(state, [0, 0], current))[:, 0], rcond=None
        )[0]
        return state, push

    def current(self, direction: float) -> np.ndarray:
        return self.case.speed * np.array([math.cos(direction), math.sin(direction)])

    def solver(self, n: int, limit: float) -> object:
        """IPOPT for n intervals; parameters: the current. It stops at a feasible point."""
        if n not in self.solvers:
            q, w = ca.MX.sym("q", 6, n + 1), ca.MX.sym("w", 2, n)
            h, current = ca.MX.sym("h", 1, n), ca.MX.sym("V", 2)
            pieces = q[:, :-1], q[:, 1:], w, h, ca.repmat(current, 1, n)
            defects, between = self.defect.map(n)(*pieces), self.between.map(n)(*pieces)
            seen = ca.horzcat(self.view.map(n + 1)(q), between)
            span = ca.DM(self.high - self.low)
            effort = w / ca.repmat(span, 1, n)
            cost = 0.05 * ca.sum2(h * ca.sum1(effort**2)) + 0.01 * ca.sum2(h)
            cost += 0.02 * ca.sumsqr(effort[:, 1:] - effort[:, :-1])
            program = {
                "x": ca.veccat(q, w, h),
                "p": current,
                "f": cost,
                "g": ca.veccat(defects, seen),
            }
            options = {
                "print_time": False,
                "ipopt": {
                    "print_level": 0, "sb": "yes", "max_iter": 1500, "max_wall_time": limit,
                    "mu_init": 1e-2, "bound_push": 1e-3, "bound_frac": 1e-3,
                    "acceptable_tol": 1e8, "acceptable_dual_inf_tol": 1e10,
                    "acceptable_compl_inf_tol": 1e10, "acceptable_constr_viol_tol": 1e-6,
                    "acceptable_iter": 3, "acceptable_obj_change_tol": 1e20,
                },
            }  # fmt: skip
            self.solvers[n] = ca.nlpsol("reach", "ipopt", program, options)
        return self.solvers[n]

    def solved(
        self, start: np.ndarray, direction: float, along: float, guess: Course, limit: float
    ) -> Course | None:
        """A trajectory from the start to rest at the goal, near the guess."""
        n, m = len(guess.durations), MARGIN * self.case.length
        rest, _ = self.rest(direction, along)
        side = np.array([np.inf, np.inf, 1.55, np.inf, np.inf, np.inf])
        low, high = np.tile(-side, (n + 1, 1)), np.tile(side, (n + 1, 1))
        near = 0.004 * self.scale
        low[0] = high[0] = start
        low[-1], high[-1] = rest - near, rest + near
        room = 0.02 * (self.high - self.low)
        ends = [
            np.concatenate([a.ravel(), np.tile(b, n), c * guess.durations])
            for a, b, c in (
                (low, self.low + room, SHORT), (high, self.high - room, LONG),
            )
        ]  # fmt: skip
        early = np.concatenate([[0.0], np.cumsum(guess.durations)]) < 1.0 * self.case.length**0.5
        seen = np.where(early[:, None], 0.0, -m) * np.ones((1, 4))
        seen[0] = 1.0  # the start is as it is
        seen = np.concatenate([seen, seen[1:]])
        solver = self.solver(n, limit)
        found = solver(
            x0=np.concatenate([guess.states.ravel(), guess.inputs.ravel(), guess.durations]),
            p=self.current(direction),
            lbx=ends[0],
            ubx=ends[1],
            lbg=np.concatenate([np.zeros(6 * n), np.full(4 * (2 * n + 1), -np.inf)]),
            ubg=np.concatenate([np.zeros(6 * n), seen.ravel()]),
        )
        if not solver.stats()["success"]:
            return None
        x = np.array(found["x"])[:, 0]
        return Course(
            x[: 6 * (n + 1)].reshape(-1, 6),
            x[6 * (n + 1) : 8 * n + 6].reshape(-1, 2),
            x[8 * n + 6 :],
        )

    def followed(self, path: Course, start: np.ndarray, direction: float, along: float) -> bool:
        """`hf.Plant` follows the path in view and stays at its end."""
        current = self.current(direction)
        nodes = np.concatenate([[0.0], np.cumsum(path.durations)])
        t = np.arange(0.0, nodes[-1], SAMPLE)
        k = np.clip(np.searchsorted(nodes, t, "right") - 1, 0, len(path.inputs) - 1)
        share, h = (t - nodes[k]) / path.durations[k], path.durations[k]
        f0 = np.array(self.rate.map(len(t))(path.states[k].T, path.inputs[k].T, current)).T
        f1 = np.array(self.rate.map(len(t))(path.states[k + 1].T, path.inputs[k].T, current)).T
        s, hh = share[:, None], h[:, None]
        wanted = (
            (1 + 2 * s) * (1 - s) ** 2 * path.states[k] + s * (1 - s) ** 2 * hh * f0
            + s**2 * (3 - 2 * s) * path.states[k + 1] + s**2 * (s - 1) * hh * f1
        )  # fmt: skip
        rest, push = self.rest(direction, along)
        weight = np.diag(1 / (0.01 * self.scale * [1, 1, 1, 3, 3, 3]) ** 2)
        cost = np.diag(1 / (0.3 * (self.high - self.low)) ** 2)

        def sampled(q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            a, b = (np.array(m) * SAMPLE for m in self.slopes(q, w, current))
            grown = np.eye(6) + a / 2 + a @ a / 6 + a @ a @ a / 24
            return np.eye(6) + a @ grown, grown @ b

        a, b = sampled(rest, push)
        value = solve_discrete_are(a, b, weight, cost)
        last = np.linalg.solve(cost + b.T @ value @ b, b.T @ value @ a)
        gains = np.empty((len(t), 2, 6))
        for i in range(len(t) - 1, -1, -1):
            a, b = sampled(wanted[i], path.inputs[k[i]])
            gains[i] = np.linalg.solve(cost + b.T @ value @ b, b.T @ value @ a)
            value = weight + a.T @ value @ (a - b @ gains[i])
        plant = hf.Plant(self.system, start, sample_time=SAMPLE, substeps=2)
        states = [plant.state]
        felt = {"Vx": current[0], "Vy": current[1]}
        for i in range(len(t) + round(STAY / SAMPLE)):
            under_way = i < len(t)
            aim, push_there = (wanted[i], path.inputs[k[i]]) if under_way else (rest, push)
            gain = gains[i] if under_way else last
            thrust = push_there - gain @ (plant.state - aim)
            states.append(plant.step(self.matrix @ np.clip(thrust, self.low, self.high), felt))
            if not np.isfinite(states[-1]).all():
                return False
        flown = np.array(states)
        off = flown[-round(STAY / SAMPLE) :, :3] - self.goal(along)
        at = (np.hypot(off[:, 0], off[:, 1]) < 0.03 * self.case.length) & (np.abs(off[:, 2]) < 0.05)
        return bool(self.judge.values(flown).max() <= TOLERANCE and at[-1] and at[0])


def guess_of(case: Case, problem: Problem, runs: Runs, run: int, mirror: bool = False) -> Course:
    """A recorded run up to where it is at the goal, on intervals of the case's length."""
    states, thrust = runs.state[run], runs.actuator[run]
    off = states[:, :2] - problem.goal(runs.along[run])[:2]
    far = np.flatnonzero(np.hypot(off[:, 0], off[:, 1]) > 0.05 * case.length)
    end = runs.time[min(far[-1] + 1 if len(far) else 1, len(runs.time) - 1)] + 2.0 * case.length
    end = min(end, runs.time[-1])
    n = int(np.ceil(end / case.interval / 20)) * 20
    nodes = np.linspace(0, end, n + 1)
    q = np.stack([np.interp(nodes, runs.time, states[:, j]) for j in range(6)], 1)
    w = np.stack([np.interp(nodes[:-1], runs.time, thrust[:, j]) for j in range(2)], 1)
    if mirror:
        q, w = q * MIRROR, w[:, ::-1]
    return Course(q, np.clip(w, problem.low, problem.high), np.full(n, end / n))


def guesses(
    case: Case, problem: Problem, base: Runs, slow: dict[float, Runs], run: int
) -> Iterator[tuple[str, Callable[[], Course]]]:
    """Where a guess comes from, and how to make it; the likeliest first."""
    for speed, runs in slow.items():
        if runs.rest[run]:
            yield f"its run in {speed:g} m/s", lambda r=runs: guess_of(case, problem, r, run)
    size = np.array([1.0, 1.0, 0.6 * case.length])
    away = np.cos(base.direction)
    near = []
    for sign in (1.0, -1.0):
        flip = np.array([1.0, sign, sign])
        apart = np.linalg.norm(
            (base.state[:, 0, :3] * flip - base.state[run, 0, :3]) * size, axis=1
        )
        apart = apart + case.length * np.abs(sign * base.along - base.along[run])
        apart[~base.rest | (away * away[run] < 0)] = np.inf
        near += [(apart[i], int(i), sign < 0) for i in np.argsort(apart)[:2]]
    for _, i, mirror in sorted(near)[:2]:
        yield f"the run of start {i}", lambda i=i, m=mirror: guess_of(case, problem, base, i, m)
    yield "its own run", lambda: guess_of(case, problem, base, run)


def reach(case: Case, limit: float, most: int) -> dict[str, object]:
    """Tries every start that does not come to rest."""
    problem, every = Problem(case), 0.2 * case.length**0.5
    every = 0.2 if case.length == 1 else 0.5
    base = runs_of(case, case.speed, every=every)
    place = np.abs(base.along) < HALF
    missing = np.flatnonzero(place & ~base.rest)
    rows = {int(i): {"start": int(i), "direction": round(math.degrees(base.direction[i]), 1),
                     "found": None, "by": None} for i in missing}  # fmt: skip
    for changes in case.numbers:
        other = runs_of(case, case.speed, *changes, every=case.horizon)
        for i in missing[other.rest[missing]]:
            if not rows[int(i)]["found"]:
                rows[int(i)] |= {"found": "the law", "by": ", ".join(changes)}
    print(
        case.name, sum(r["found"] is not None for r in rows.values()), "of", len(rows), flush=True
    )
    slow = {speed: runs_of(case, speed, every=every) for speed in case.slower}
    result = {"place": int(place.sum()), "rest": int((place & base.rest).sum()), "limit": limit}
    for i, row in rows.items():
        begun = time.monotonic()
        if row["found"]:
            continue
        start, direction, along = base.state[i, 0], base.direction[i], base.along[i]
        tried = []
        for origin, make in list(guesses(case, problem, base, slow, i))[:most]:
            path = problem.solved(start, direction, along, make(), limit)
            followed = path is not None and problem.followed(path, start, direction, along)
            tried.append((origin, path is not None, followed))
            if followed:
                row |= {"found": "optimisation", "by": origin}
                row["duration"] = round(float(path.durations.sum()), 1)
                break
        row["guesses"] = len(tried)
        row["seconds"] = round(time.monotonic() - begun, 1)
        print(row, tried, flush=True)
        problem.solvers.clear()
        keep(case.name, result, rows)
    keep(case.name, result, rows)
    return result


def keep(name: str, result: dict[str, object], rows: dict[int, dict[str, object]]) -> None:
    """Writes what is known so far."""
    by_law = sum(r["found"] == "the law" for r in rows.values())
    by_optimisation = sum(r["found"] == "optimisation" for r in rows.values())
    result |= {
        "missing": len(rows),
        "by_law": by_law,
        "by_optimisation": by_optimisation,
        "optimised": sum("guesses" in r for r in rows.values()),
        "starts": list(rows.values()),
    }
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    record[name] = result
    text = json.dumps(record, indent=1)
    RECORD.write_text(text + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=[c.name for c in CASES])
    parser.add_argument("--limit", type=float, default=25.0, help="seconds of IPOPT for a guess")
    parser.add_argument("--guesses", type=int, default=5, help="most guesses of a start")
    given = parser.parse_args()
    for case in CASES:
        if given.only in (None, case.name):
            reach(case, given.limit, given.guesses)


if __name__ == "__main__":
    main()
