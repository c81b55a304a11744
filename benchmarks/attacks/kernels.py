"""Kernels, invariance kernels, capture basins and tubes, judged by the two brackets."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from attacks.oracle import COUNTS, brackets
from attacks.problems import Problem, problem, widened, words
from attacks.product import Built
from holdfast.errors import HoldfastError

TOLERANCE = 2.5
"""Cells of the product's grid by which a set may differ from the exact one."""
POCKET = 1.0
"""Cells by which the region is narrower within which a state has to be kept to be asked for: where
all ways end in a pocket beside a constraint that is less than a cell wide, no grid of these cells
has it, and a set of many cells is lost with it."""
VANISHED = 1.0
"""Cells by which the region is wider within which a node has to be lost, where nothing is left of a
set: just after it has vanished all states are lost, however little their value is above 0."""
FINER = 2.0
"""How much finer the oracle is where the coarse one leaves most of a set between its brackets, in
one and two states with one input."""


def judge(p: Problem, built: Built, value: Any, tolerance: float = TOLERANCE) -> dict[str, Any]:
    """Nodes that the product keeps and that are surely lost, and the reverse."""
    horizon = (
        math.inf if value.report.converged and p.kind in ("kernel", "invariance") else p.horizon
    )
    lines = [a.nodes / k for a, k in zip(value.grid.axes, p.scales, strict=True)]
    nodes = np.array([m.ravel() for m in np.meshgrid(*lines, indexing="ij")])
    kept = value.values().ravel() > 0
    wide = (tolerance * p.cells)[:, None]
    found: dict[str, Any] = {"kept": int(kept.sum()), "nodes": len(kept)}
    cheap = len(p.rates) < 3 and "u1" not in "".join(p.rates)
    for finer in (1.0, FINER) if cheap else (1.0,):
        cells = int(COUNTS[len(p.rates)] * finer)
        sure = brackets(p, cells, horizon, narrower=POCKET * p.cells)
        if sure is None:
            lost, held = np.ones(len(kept), bool), np.zeros(len(kept), bool)
        else:
            lost, held = (
                sure.none_outer(nodes - wide, nodes + wide),
                sure.all_inner(nodes - wide, nodes + wide),
            )
        if (kept & lost).any() and lost.all():
            of_wider = brackets(p, cells, horizon, wider=VANISHED * p.cells)
            lost &= of_wider is None or of_wider.none_outer(nodes - wide, nodes + wide)
        found |= {"lost": int(lost.sum()), "held": int(held.sum())}
        found["kept but lost"] = int((kept & lost).sum())
        lacks = ~kept & held & _open(p, nodes) & (not wears_away(p))
        found["lost but kept"] = int(lacks.sum())
        if found["kept but lost"] or found["lost but kept"] or _decided(kept, lost, held):
            break
    wrong = (kept & lost) if found["kept but lost"] else lacks
    if wrong.any():
        worst = np.argmax(np.where(wrong, np.abs(value.values().ravel()), -1))
        found["state"] = [float(v) for v in nodes[:, worst]]
    return found


def wears_away(p: Problem) -> bool:
    """Whether the page says of the dissipation that it makes sets smaller than they are."""
    return p.options.get("dissipation", "local-local") != "local-local"


def _open(p: Problem, nodes: np.ndarray) -> np.ndarray:
    """Nodes at which the product has to say something: away from the ends of its grid."""
    inside = np.ones(nodes.shape[1], bool)
    for i, turn in enumerate(p.angles):
        if not turn:
            inside &= (nodes[i] > p.low[i] + 2 * p.cells[i]) & (
                nodes[i] < p.high[i] - 2 * p.cells[i]
            )
    return inside


def _decided(kept: np.ndarray, lost: np.ndarray, held: np.ndarray) -> bool:
    """Whether the brackets decide about most of what is kept."""
    between = kept & ~held & ~lost
    return bool(between.sum() <= 0.5 * max(kept.sum(), 1))


VERDICTS = {
    "kept but lost": "a set has states that are surely lost",
    "lost but kept": "a set lacks states that are surely kept",
}


def verdict(p: Problem) -> dict[str, Any]:
    """What is wrong with the set of a problem: {} if nothing is."""
    built = Built(p)
    value = built.solve()
    found = judge(p, built, value)
    found["converged"] = bool(value.report.converged)
    return found


def wrong(p: Problem, what: str) -> bool:
    """Whether a problem has this fault."""
    try:
        return bool(verdict(p).get(what, 0))
    except HoldfastError:
        return False


def mechanism(p: Problem, has: Callable[[Problem], bool]) -> str:
    """What a fault goes away with, tried in order."""
    if p.ends == "on" and not has(widened(p)):
        return "goes with a wider grid"
    if p.scheme != "upwind" and not has(replace(p, scheme="upwind", options={})):
        return "goes with upwind"
    for name in p.options:
        if not has(replace(p, options={k: v for k, v in p.options.items() if k != name})):
            return f"goes without {name}={p.options[name]}"
    if not has(replace(p, nodes=tuple(2 * n - 1 for n in p.nodes))):
        return "goes with twice the nodes"
    return "stays"


def rescaled(p: Problem, generator: np.random.Generator) -> Problem:
    """The same in other units."""
    scales = tuple(
        k if t else k * 10.0 ** int(generator.integers(-3, 4))
        for k, t in zip(p.scales, p.angles, strict=True)
    )
    return replace(p, scales=scales, clock=p.clock * 10.0 ** int(generator.integers(-2, 3)))


def compare_units(p: Problem, built: Built, value: Any, twin: Problem) -> str:
    """How the answer in other units differs; nothing if it does not."""
    other = Built(twin).solve()
    a, b = value.report, other.report
    if (a.converged, a.empty) != (b.converged, b.empty):
        return f"converged, empty: {a.converged, a.empty} and {b.converged, b.empty}"
    slack = 0.01 if p.options.get("precision") == "float32" else 1e-3
    near = slack * max(_change(value.values()), 1e-300)
    first, second = value.values(), other.values()
    apart = ((first > 0) != (second > 0)) & (np.maximum(np.abs(first), np.abs(second)) > near)
    if apart.any():
        return f"other sets: {int(apart.sum())} nodes"
    first, second = (v.dataset.attrs.get("steps") for v in (value, other))
    if first != second and slack == 1e-3:
        return f"{first} steps and {second} steps"
    return ""


def _change(v: np.ndarray) -> float:
    return max(float(np.max(np.abs(np.diff(v, axis=i)))) for i in range(v.ndim))


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, problem(seed, number), number))


def _attempt(p: Problem, number: int, outcome: Outcome) -> None:
    built = Built(p)
    value = built.solve()
    found = judge(p, built, value)
    outcome.judged = 1
    outcome.counts = {k: found[k] for k in ("nodes", "lost", "held")}
    outcome.counts["converged"] = int(value.report.converged)
    for what, sentence in VERDICTS.items():
        if found[what]:
            told = mechanism(p, partial(wrong, what=what))
            outcome.faults.append(
                Fault(f"{sentence}; {told}", f"{p.kind} {p.form} {p.scheme} {p.options}: {found}")
            )
    if number % 6 == 0:
        twin = rescaled(p, np.random.default_rng([number, 9]))
        if told := compare_units(p, built, value, twin):
            outcome.faults.append(
                Fault(
                    f"other units, another answer: {told.split(':')[0].split(' by ')[0]}",
                    f"{told} {twin.scales} {twin.clock}",
                )
            )


# -- smaller problems with the same fault -----------------------------------------------------


def smaller(p: Problem) -> Iterator[Problem]:
    """Simpler problems, the boldest changes first."""
    for i in range(len(p.region)):
        rest = p.region[:i] + p.region[i + 1 :]
        if rest:
            yield _tidy(replace(p, region=rest))
    plain = tuple(1.0 for _ in p.scales)
    if p.scales != plain or p.clock != 1:
        yield replace(p, scales=plain, clock=1.0)
    if p.disturbances:
        bare = tuple(r.replace(" + d0", "").replace(" + d1", "") for r in p.rates)
        yield replace(p, disturbances=None, rates=bare)
    for i, rate in enumerate(p.rates):
        terms = rate.split(" + ")
        for k in range(len(terms)):
            rest = " + ".join(terms[:k] + terms[k + 1 :])
            if len(terms) > 1 and rest.count("(") == rest.count(")") and "d" not in terms[k]:
                yield _tidy(replace(p, rates=(*p.rates[:i], rest, *p.rates[i + 1 :])))
    for name in p.options:
        yield replace(p, options={k: v for k, v in p.options.items() if k != name})
    if p.scheme != "upwind":
        yield replace(p, scheme="upwind")
    fewer = tuple(max(n * 3 // 4, 13) for n in p.nodes)
    if fewer != p.nodes:
        yield replace(p, nodes=fewer)
    for digits, name in itertools.product((1, 2), p.numbers):
        short = float(f"{p.numbers[name]:.{digits}g}")
        if short != p.numbers[name]:
            yield replace(p, numbers={**p.numbers, name: short})


def _tidy(p: Problem) -> Problem:
    """Without numbers and inputs that no formula reads."""
    named = set().union(*(words(t) for t in (*p.rates, *p.region, *p.goal)))
    return replace(p, numbers={k: v for k, v in p.numbers.items() if k in named})


def shrink(seed: int, number: int, fault: Fault) -> None:
    p = problem(seed, number)
    what = next((w for w, s in VERDICTS.items() if fault.signature.startswith(s)), None)
    if what is not None:
        p = writing.shrunk(p, smaller, partial(wrong, what=what), seconds=40)
        body = f"found = verdict(problem_of({p.plain()!r}))\nprint(found)\n"
        body += f"print(found[{what!r}], 'nodes:', {VERDICTS[what]!r})\n"
    else:
        body = f"print(attempt({seed}, {number}).faults)\n"
    fault.text = writing.alone(
        f"{fault.signature}.\n\n{fault.message}",
        ("case", "enclosures", "problems", "oracle", "product", "writing", "kernels"),
        body,
    )


KIND = Kind("kernels", attempt, shrink, share=3.0, seconds=90.0, shown=("nodes", "lost", "held"))
