"""Sure sets of kernels, basins and tubes: outer sets and certified parts, against the brackets.

What the inner bracket keeps for sure has to be in `ValueFunction.outer`, and of a certified cell
not every state may be lost for sure. Neither claim has a tolerance.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from attacks.kernels import smaller
from attacks.oracle import Brackets, brackets
from attacks.problems import Problem, problem
from attacks.product import Built
from holdfast.errors import HoldfastError

PROBES = 4000
LOST, CERTIFIED = "an outer set lacks states", "a certified cell is lost"
SENTENCES = {
    LOST: "an outer set lacks states that are surely in the set",
    CERTIFIED: "a certified cell has no state that is not surely lost",
}
KINDS = ("kernel", "kernel", "kernel", "basin", "invariance", "tube")


def sure_problem(seed: int, number: int) -> Problem:
    """A problem that does not depend on time, by a scheme that is quick."""
    p = problem(seed, number, KINDS)
    still = tuple(c for c in p.region if "*t" not in c)
    horizon = 30.0 if p.moves else p.horizon
    return replace(p, region=still, horizon=horizon, scheme="upwind", options={})


def verdict(p: Problem) -> dict[str, Any]:
    """How many states, and how many cells, are not what the sets say."""
    built = Built(p)
    value = built.solve()
    forever = value.report.converged and p.kind in ("kernel", "invariance")
    sure = brackets(p, None, math.inf if forever else p.horizon)
    goal = {"target": built.goal} if p.kind == "basin" else {}
    told: dict[str, Any] = {"runs": 0, "cells": 0}
    whose = built.goal if p.kind == "tube" else built.region
    outer = value.outer(built.system, whose, **goal)
    if sure is not None:
        told |= lacking(p, built, outer, sure)
    if p.kind == "kernel" and p.inputs is not None and not value.report.empty:
        told |= certified(p, built, value, sure, forever)
    return told


def lacking(p: Problem, built: Built, outer: Any, sure: Brackets) -> dict[str, Any]:
    """States of inner cells that the outer set does not contain."""
    g = np.random.default_rng(1)
    inner = np.argwhere(sure.inner)
    if not len(inner):
        return {}
    at = inner[g.integers(len(inner), size=PROBES)]
    states = (sure.low + (at + g.random(at.shape)) * sure.size).T
    missing = ~outer.contains(built.scaled(states.T))
    told: dict[str, Any] = {"runs": PROBES, LOST: int(missing.sum())}
    if missing.any():
        told["state"] = states[:, int(np.argmax(missing))].tolist()
    return told


def certified(
    p: Problem, built: Built, value: Any, sure: Brackets | None, forever: bool
) -> dict[str, Any]:
    """Certified cells of which every state is surely lost."""
    hold = 2 * value.report.reached_s / max(value.report.steps, 1)
    horizon = None if forever else p.horizon * p.clock
    proved = value.certified(
        built.system, built.region, sample_time=hold, horizon=horizon, inputs=3
    )
    if not len(proved.kept.members):
        return {}
    low, high = proved.kept.cells.corners(proved.kept.members)
    scales = np.array(p.scales)
    gone = np.ones(len(low), bool)
    if sure is not None:
        gone = sure.none_outer((low / scales).T, (high / scales).T)
    told: dict[str, Any] = {"cells": len(low), CERTIFIED: int(gone.sum())}
    if gone.any():
        told["cell"] = (low[gone][0] / scales).tolist()
    return told


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, sure_problem(seed, number)))


def _attempt(p: Problem, outcome: Outcome) -> None:
    told = verdict(p)
    outcome.judged = int(told["runs"] > 0 or told["cells"] > 0)
    outcome.counts = {"states": told["runs"], "cells": told["cells"]}
    for what, sentence in SENTENCES.items():
        if told.get(what):
            outcome.faults.append(Fault(f"{sentence} ({p.kind})", f"{p.form}: {told}"))


def wrong(p: Problem, what: str) -> bool:
    """Whether a problem has this fault."""
    try:
        return bool(verdict(p).get(what, 0))
    except HoldfastError:
        return False


def shrink(seed: int, number: int, fault: Fault) -> None:
    p = sure_problem(seed, number)
    what = next((w for w, s in SENTENCES.items() if fault.signature.startswith(s)), None)
    if what is None:
        body = f"print(attempt({seed}, {number}).faults)\n"
    else:
        p = writing.shrunk(p, smaller, partial(wrong, what=what), seconds=40)
        body = f"print(verdict(problem_of({p.plain()!r})))\n"
    modules = ("case", "enclosures", "problems", "oracle", "product", "writing", "kernels")
    title = f"{fault.signature}.\n\n{fault.message}"
    fault.text = writing.alone(title, (*modules, "sure_sets"), body)


KIND = Kind("sure sets", attempt, shrink, share=1.0, seconds=90.0, shown=("states", "cells"))
