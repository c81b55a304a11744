"""Certificates and judged laws: honest ones, attacked by simulation and given to the checker."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from attacks.oracle import moved, points, rates_at, worst
from attacks.problems import ALIKE, Problem, drawn, problem, times
from attacks.product import Built
from holdfast_check.checker import NotValidError, check

CELLS = {1: 40, 2: 20, 3: 8}
"""Cells along an axis, by the number of states."""
RUNS = 60
HOLDS = 40
SUBSTEPS = 4
CHECKED = 500
"""Entries that the checker reads, of more a part."""


def certified_problem(seed: int, number: int) -> Problem:
    """A problem of the size that is certified in a second."""
    p = problem(seed, number, ("kernel",))
    p = replace(p, region=tuple(c for c in p.region if "*t" not in c), literal=False)
    if p.inputs and p.inputs[0] == "ball" and number // ALIKE % 10:  # most have boxes
        p = replace(p, inputs=["box", [-p.inputs[1]] * p.inputs[2], [p.inputs[1]] * p.inputs[2]])
    p = replace(p, disturbances=times(p.disturbances, 0.4))  # cells cost something too
    return replace(p, scales=tuple(1.0 for _ in p.scales), clock=1.0)


class Setting:
    """How a problem is certified."""

    def __init__(self, p: Problem, seed: int, number: int) -> None:
        g = np.random.default_rng([seed, number, 13])
        self.generator = g
        x = g.uniform(p.low, p.high, (500, len(p.low))).T
        ones = np.ones(500)
        u, d = points(p.inputs, 2)[-1], points(p.disturbances, 2)[-1]
        speed = np.abs(rates_at(p, x, [v * ones for v in u], [v * ones for v in d])).max(axis=1)
        cells = CELLS[len(p.low)]
        size = (np.array(p.high) - np.array(p.low)) / cells
        self.hold = float(
            f"{float(g.choice([0.5, 1, 2])) * np.min(size / np.maximum(speed, 1e-6)):.2g}"
        )
        self.options: dict[str, Any] = {
            "box": {
                n: (a, a + 2 * np.pi if t else b)
                for n, a, b, t in zip(p.states, p.low, p.high, p.angles, strict=True)
            },
            "cells": cells,
            "sample_time": self.hold,
            "inputs": 3 if "u1" in "".join(p.rates) else 5,
        }
        if g.random() < 0.25:
            self.options["delay"] = float(f"{self.hold * drawn(g, 0.1, 0.5):.2g}")
        if g.random() < 0.2:
            self.options["halvings"] = 1
        if g.random() < 0.2:
            self.options["horizon"] = 4 * self.hold


def certified(p: Problem, seed: int, number: int) -> tuple[Built, hf.Certificate, Setting]:
    built, setting = Built(p), Setting(p, seed, number)
    return built, hf.certify(built.system, built.region, **setting.options), setting


def trial(p: Problem, seed: int, number: int) -> dict[str, Any]:
    """What simulation and the checker say of a certificate."""
    built, found, setting = certified(p, seed, number)
    kept = found.kept
    if not len(kept.members):
        return {"runs": 0}
    told: dict[str, Any] = {"runs": RUNS, "cells": len(kept.members)} | simulated(
        p, built, found, setting
    )
    return told | checked(found)


def checked(found: hf.Certificate) -> dict[str, Any]:
    """Whether the checker agrees with an honest certificate."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "honest.holdfast"
        found.write(path)
        try:
            check(str(path), share=min(1.0, CHECKED / len(found.kept.entries)))
        except NotValidError as error:
            return {"checks": 1, "honest one refused": str(error)[:200]}
    return {"checks": 1}


def simulated(p: Problem, built: Built, found: hf.Certificate, setting: Setting) -> dict[str, Any]:
    """Runs of the filter of a certificate from its cells, against disturbances that switch."""
    g, kept = setting.generator, found.kept
    low, high = kept.cells.corners(kept.members)
    at = g.integers(len(low), size=RUNS)
    place = np.where(
        g.random((RUNS, 1)) < 0.3,
        g.integers(0, 2, (RUNS, len(p.low))),
        g.random((RUNS, len(p.low))),
    )
    place = 1e-9 + (1 - 2e-9) * place
    x = (low[at] + place * (high[at] - low[at])).T
    keep = hf.CertifiedFilter(found, built.system)
    members, pool = points(p.disturbances, 2), points(p.inputs, 3)
    delay = setting.options.get("delay", 0.0)
    pushed = members[g.integers(len(members), size=RUNS)]
    before = pool[g.integers(len(pool), size=RUNS)]
    before = np.clip(before, np.min(found.candidates, axis=0), np.max(found.candidates, axis=0))
    left, outside, reach = (
        np.full(RUNS, -math.inf),
        0,
        HOLDS if kept.holds is None else min(kept.holds, HOLDS),
    )
    for _ in range(reach):
        commands = pool[g.integers(len(pool), size=RUNS)]
        decisions = keep.step_many(np.ascontiguousarray(x.T), commands)
        if kept.holds is None:
            outside += sum(s.value == "outside the grid" for s in decisions.status)
        u = np.asarray(decisions.input)
        for length, held in ((delay, before), (setting.hold - delay, u)):
            for _ in range(SUBSTEPS if length else 0):
                fresh = members[g.integers(len(members), size=RUNS)]
                pushed = np.where((g.random(RUNS) < 0.2)[:, None], fresh, pushed)
                x = moved(p, x, held.T, pushed.T, length / SUBSTEPS)
                left = np.fmax(left, worst(p, x))
        before = u
        for i, turn in enumerate(p.angles):
            if turn:
                x[i] = (x[i] - p.low[i]) % (2 * np.pi) + p.low[i]
        x = np.clip(x, -1e6, 1e6)
    gone = left > 1e-7
    told: dict[str, Any] = {
        "left": int(gone.sum()),
        "in no cell": outside,
        "options": {k: v for k, v in setting.options.items() if k != "box"},
    }
    if gone.any():
        told["by"] = float(left.max())
    return told


SENTENCES = {
    "left": "a run under a certified filter leaves the region",
    "in no cell": "a run from a certified cell, for ever, comes to no certified cell",
    "honest one refused": "the checker refuses an honest certificate",
}


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, seed, number))


def _attempt(seed: int, number: int, outcome: Outcome) -> None:
    p = certified_problem(seed, number)
    told = law_trial(p, seed, number) if number % 4 == 3 else trial(p, seed, number)
    outcome.judged = int(told["runs"] > 0)
    outcome.counts = {k: told[k] for k in ("runs", "checks") if k in told}
    outcome.counts["laws"] = int("verdict" in told)
    outcome.counts["no cell"] = int(told["runs"] == 0)
    for what, sentence in {**SENTENCES, **LAW_SENTENCES}.items():
        if told.get(what):
            late = ", with a delay" if told.get("options", {}).get("delay") else ""
            outcome.faults.append(Fault(sentence + late, f"{p.form} {told}"))


# -- laws -------------------------------------------------------------------------------------

LAW_SENTENCES = {
    "lost though proved": "a law that is proved to keep its region leaves it",
    "leaves not": "the trajectory of a refuted law does not leave the region",
}


def law_trial(p: Problem, seed: int, number: int) -> dict[str, Any]:
    """A law u = u0 - k x, and what simulation says of the verdict about it."""
    import sympy as sp

    built, setting = Built(p), Setting(p, seed, number)
    g = setting.generator
    middle = points(p.inputs, 2).mean(axis=0)
    gains = g.uniform(-2, 2, (len(middle), len(p.low))).round(1)
    law = hf.Law(
        "linear",
        built.system.states,
        {
            q: sp.Float(str(round(m, 3)))
            - sum(
                sp.Float(str(k)) * (sp.sin(s) if t else s)
                for k, s, t in zip(row, built.states, p.angles, strict=True)
            )
            for q, m, row in zip(built.system.input_names, middle, gains, strict=True)
        },
        empirical="numbers",
    )
    options = {
        k: v for k, v in setting.options.items() if k in ("box", "cells", "sample_time", "delay")
    }
    judged = hf.judge_law(built.system, built.region, law, **options)
    kept = judged.certificate.kept
    told: dict[str, Any] = {
        "runs": 0,
        "verdict": str(judged.verdict),
        "options": {k: v for k, v in options.items() if k != "box"},
    }
    if not len(kept.members) or p.inputs is None or p.inputs[0] != "box" or "delay" in options:
        return told
    low, high = kept.cells.corners(kept.members)
    at = g.integers(len(low), size=RUNS)
    x = (low[at] + g.random((RUNS, len(p.low))) * (high[at] - low[at])).T
    members = points(p.disturbances, 2)
    pushed, left = members[g.integers(len(members), size=RUNS)], np.full(RUNS, -math.inf)
    for _ in range(HOLDS):
        read = np.array([np.sin(v) if t else v for v, t in zip(x, p.angles, strict=True)])
        wanted = np.round(middle, 3)[:, None] - gains @ read
        u = np.clip(wanted, np.array(p.inputs[1])[:, None], np.array(p.inputs[2])[:, None])
        for _ in range(SUBSTEPS):
            fresh = members[g.integers(len(members), size=RUNS)]
            pushed = np.where((g.random(RUNS) < 0.2)[:, None], fresh, pushed)
            x = np.clip(moved(p, x, u, pushed.T, setting.hold / SUBSTEPS), -1e6, 1e6)
            left = np.fmax(left, worst(p, x))
    told |= {"runs": RUNS, "lost though proved": int((left > 1e-7).sum())}
    return told


def shrink(seed: int, number: int, fault: Fault) -> None:
    tried = "law_trial" if number % 4 == 3 else "trial"
    body = f"p = certified_problem({seed}, {number})\nprint(p)\n"
    body += f"print({tried}(p, {seed}, {number}))\n"
    modules = ("case", "enclosures", "problems", "oracle", "product", "writing", "certificates")
    fault.text = writing.alone(f"{fault.signature}.\n\n{fault.message}", modules, body)


KIND = Kind(
    "certificates", attempt, shrink, share=1.0, seconds=90.0, shown=("runs", "checks", "laws")
)
