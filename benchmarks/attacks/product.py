"""Problems as objects of holdfast, by its public names alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import sympy as sp

import holdfast as hf
from attacks.problems import TURN, Problem, words

FUNCTIONS: dict[str, Callable[..., sp.Expr]] = {
    "abs": sp.Abs,
    "max": sp.Max,
    "min": sp.Min,
    "sin": sp.sin,
    "cos": sp.cos,
    "sqrt": sp.sqrt,
}


class Built:
    """System, region, goal and grid of a problem, in the units of the product."""

    def __init__(self, p: Problem) -> None:
        self.problem = p
        self.states = [hf.symbol(n) for n in p.states]
        self._parameters: dict[str, hf.Parameter] = {}
        quantities = tuple(
            hf.Quantity(n, "rad" if t else "m", angle=t)
            for n, t in zip(p.states, p.angles, strict=True)
        )
        count, pushes = _size(p.inputs), _size(p.disturbances)
        named = {f"u{i}": hf.symbol(f"u{i}") for i in range(count)}
        named |= {f"d{i}": hf.symbol(f"d{i}") for i in range(pushes)}
        named["t"] = hf.TIME / self._number("clock", p.clock)
        scales = [self._number(f"s_{n}", k) for n, k in zip(p.states, p.scales, strict=True)]
        for symbol, scale in zip(self.states, scales, strict=True):
            named[str(symbol)] = symbol / scale
        for name, value in p.numbers.items():
            named[name] = self._number(name, value)
        self._named, clock = named, self._number("clock", p.clock)
        rates = {
            n: self._formula(r) * scale / clock
            for n, r, scale in zip(p.states, p.rates, scales, strict=True)
        }
        bounds = [self._bounds("u", p.inputs), self._bounds("d", p.disturbances)]
        self.system = hf.System(
            "attacked",
            quantities,
            tuple(hf.Quantity(f"u{i}") for i in range(count)),
            rates,
            disturbances=tuple(hf.Quantity(f"d{i}") for i in range(pushes)),
            input_bounds=bounds[0],
            disturbance_bounds=bounds[1],
            parameters=tuple(
                self._used({"clock", *self._bound_names, *map("s_{}".format, p.states)}, p.rates)
            ),
            empirical="numbers",
        )
        self.region, self.goal = (
            hf.Region(
                name,
                quantities,
                tuple(hf.Inequality(f"c{i}", self._formula(t)) for i, t in enumerate(texts)),
                parameters=tuple(self._used({"clock"} if p.moves else set(), texts, system=False)),
                empirical="numbers",
            )
            for name, texts in (("region", p.region), ("goal", p.goal))
        )
        box = {
            n: (a * k, a * k + TURN if t else b * k)
            for n, a, b, k, t in zip(p.states, p.low, p.high, p.scales, p.angles, strict=True)
        }
        self.grid = hf.grid(self.system, box, dict(zip(p.states, p.nodes, strict=True)))

    def _number(self, name: str, value: float) -> sp.Expr:
        """A number as a parameter, or as itself where the problem is literal."""
        if self.problem.literal:
            return sp.Float(value) if value != 1 else sp.Integer(1)
        self._parameters[name] = hf.Parameter(name, "1", value=value)
        return self._parameters[name].symbol

    def _formula(self, text: str) -> sp.Expr:
        return sp.sympify(eval(text, {"__builtins__": {}}, {**FUNCTIONS, **self._named}))

    _bound_names: tuple[str, ...] = ()

    def _bounds(self, of: str, bound: list[Any] | None) -> Any:
        if bound is None:
            return None

        def number(name: str, value: float) -> sp.Expr:
            self._bound_names = (*self._bound_names, name)
            return self._number(name, value)

        kind, *numbers = bound
        if kind == "ball":
            return hf.Ball(number(f"{of}_r", numbers[0]), numbers[1])
        low, high = (
            tuple(number(f"{of}_{side}{i}", v) for i, v in enumerate(values))
            for side, values in zip(("low", "high"), numbers[-2:], strict=True)
        )
        box = hf.Box(low, high)
        return box if kind == "box" else hf.LinearImage(sp.Matrix(numbers[0]), box)

    def _used(self, more: set[str], texts: Any, system: bool = True) -> list[hf.Parameter]:
        names = set().union(*(words(t) for t in texts)) | more
        if not system:
            names |= {f"s_{n}" for n in names & set(self.problem.states)}
            taken = {q.name for q in self.system.parameters}
            names |= {n for n in taken if n.startswith("s_")} & names
        return [q for n, q in self._parameters.items() if n in names]

    def scaled(self, states: np.ndarray) -> np.ndarray:
        """States of the oracle in the units of the product."""
        return np.ascontiguousarray(states * np.array(self.problem.scales))

    def solve(self, **more: Any) -> hf.ValueFunction:
        """The set of the problem."""
        p = self.problem
        options: dict[str, Any] = {"scheme": p.scheme, "threads": 1, **p.options, **more}
        end = p.horizon * p.clock
        if p.horizon < 10 and options.get("refine", 1) == 1 and not p.moves:
            options.setdefault("times", [end * i / 8 for i in range(1, 8)] + [end])
        if p.kind == "basin":
            options["times"] = [0.0, *options.get("times", [end])]
            if options.get("refine", 1) > 1:
                del options["times"]
            return hf.capture_basin(
                self.system, self.goal, self.region, self.grid, end, arrival_steps=0, **options
            )
        if p.kind == "tube":
            return hf.backward_reachable_tube(self.system, self.goal, self.grid, end, **options)
        if p.kind == "invariance":
            return hf.invariance_kernel(self.system, self.region, self.grid, end, **options)
        kernel = hf.discriminating_kernel if p.disturbances else hf.viability_kernel
        return kernel(self.system, self.region, self.grid, end, **options)


def _size(bound: list[Any] | None) -> int:
    if bound is None:
        return 0
    return int(bound[2]) if bound[0] == "ball" else len(bound[-1])
