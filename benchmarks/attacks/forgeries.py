"""Certificates that are forged by mutation: one that says what is not so must not pass the checker.

Whether a forged statement is false is found by simulation of the statement in the file: from some
state of an entry's cell, under its held input and a constant disturbance at a corner, the vehicle
leaves the region or arrives in no cell of the file. What simulation does not show is not judged.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import struct
import tempfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from attacks import writing
from attacks.case import Fault, Kind, Outcome, attacked
from attacks.certificates import certified, certified_problem
from attacks.enclosures import NUMBERS
from holdfast_check.checker import check

EACH = 10
"""Forgeries of one honest certificate."""
MOST_ENTRIES = 250
Entries = list[tuple[int, int, int]]


def opened(path: Path) -> tuple[dict[str, Any], Entries]:
    """Header and entries (cell, input, level) of a file."""
    _, _, rest = path.read_bytes().partition(b"\n")
    text, _, packed = rest.partition(b"\n")
    return json.loads(text), list(struct.iter_unpack("<IHI", zlib.decompress(packed)))  # type: ignore[arg-type]


def sealed(path: Path, header: dict[str, Any], entries: Entries) -> None:
    """A file with the right digest."""
    packed = zlib.compress(b"".join(struct.pack("<IHI", *e) for e in entries))
    content = json.dumps(header, separators=(",", ":"), sort_keys=True).encode() + b"\n" + packed
    path.write_bytes(
        b"holdfast-certificate 1 %s\n" % hashlib.sha256(content).hexdigest().encode() + content
    )


def numbers(row: list[str]) -> np.ndarray:
    return np.array([float.fromhex(v) for v in row])


def forged(
    header: dict[str, Any], entries: Entries, g: np.random.Generator
) -> tuple[str, dict[str, Any], Entries]:
    """(what was done, header, entries)."""
    h, e = copy.deepcopy(header), list(entries)
    total = int(np.prod([len(v) - 1 for v in h["edges"]]))
    ways: dict[str, Callable[[], None]] = {}

    def other_inputs() -> None:
        for k in g.integers(len(e), size=max(len(e) // 10, 1)):
            e[k] = (e[k][0], int(g.integers(len(h["candidates"]))), e[k][2])

    def more_cells() -> None:
        kept = {c for c, _, _ in e}
        fresh = [c for c in range(total) if c not in kept][: int(g.integers(1, 6))]
        e.extend((c, int(g.integers(len(h["candidates"]))), h["holds"] or 0) for c in fresh)
        h["entries"] = len(e)
        h["cells_kept"] += len(fresh)
        h["cells_in_region"] = max(h["cells_in_region"], h["cells_kept"])
        e.sort()

    def fewer_cells() -> None:
        del e[int(g.integers(len(e)))]
        h["entries"], h["cells_kept"] = len(e), h["cells_kept"] - 1

    def stronger_push() -> None:
        for row in h["disturbances"]:
            a, b = numbers(row["range"])
            row["range"] = [float(a - 0.5 * (b - a)).hex(), float(b + 0.5 * (b - a)).hex()]

    def longer_hold() -> None:
        h["hold"] = float(float.fromhex(h["hold"]) * float(g.choice([1.5, 3]))).hex()

    def tighter() -> None:
        row = h["constraints"][int(g.integers(len(h["constraints"])))]
        row["expression"] = f"({row['expression']}) + {float(g.choice([0.05, 0.3]))!r}".replace(
            "0.05", "1/20"
        ).replace("0.3", "3/10")

    def weaker_inputs() -> None:
        h["candidates"] = [[float(0.6 * v).hex() for v in numbers(row)] for row in h["candidates"]]

    def other_rate() -> None:
        k = int(g.integers(len(h["rates"])))
        h["rates"][k] = f"({h['rates'][k]}) + 1/10"

    ways |= {
        "inputs of entries exchanged": other_inputs,
        "cells added": more_cells,
        "a cell taken away": fewer_cells,
        "a longer hold": longer_hold,
        "a tighter constraint": tighter,
        "weaker inputs": weaker_inputs,
        "another rate": other_rate,
    }
    if h["disturbances"]:
        ways["a stronger disturbance"] = stronger_push
    name = list(ways)[int(g.integers(len(ways)))]
    ways[name]()
    return name, h, e


def shown_false(h: dict[str, Any], entries: Entries, g: np.random.Generator) -> str:
    """Why a statement is false, by simulation; nothing where none was found."""
    if h.get("depth", 0) or h.get("law") or h["holds"] is not None or float.fromhex(h["delay"]):
        return ""
    edges = [numbers(v) for v in h["edges"]]
    shape = tuple(len(v) - 1 for v in edges)
    members = np.zeros(shape, bool).ravel()
    cells = np.array([c for c, _, _ in entries])
    members[cells] = True
    index = np.array(np.unravel_index(cells, shape))
    low = np.array([v[i] for v, i in zip(edges, index, strict=True)])
    high = np.array([v[i + 1] for v, i in zip(edges, index, strict=True)])
    held = np.array([numbers(h["candidates"][k]) for _, k, _ in entries]).T
    ranged = [*h["disturbances"], *h["parameters"]]
    pushes = [np.unique(numbers(d["range"])) for d in ranged]  # a number has one end, not two
    names = [d["name"] for d in (*h["states"], *h["inputs"], *h["disturbances"], *h["parameters"])]
    functions = {
        **NUMBERS,
        "Abs": np.abs,
        "magnitude": np.abs,
        "least": np.minimum,
        "greatest": np.maximum,
        "pi": np.pi,
    }
    code = [compile(r, "<rate>", "eval") for r in h["rates"]]
    kept = [compile(c["expression"], "<constraint>", "eval") for c in h["constraints"]]
    hold = float.fromhex(h["hold"])

    def at(codes: list[Any], x: np.ndarray, d: Any) -> np.ndarray:
        env = {"__builtins__": {}, **functions, **dict(zip(names, (*x, *held, *d), strict=True))}
        return np.array([np.broadcast_to(eval(c, env), x[0].shape) for c in codes])

    for corner in itertools.product(*pushes) if pushes else [()]:
        for trial in range(3):
            inside = g.integers(0, 2, low.shape) if trial else g.random(low.shape)
            x = low + (0.001 + 0.998 * inside) * (high - low)
            step = hold / 8
            for _ in range(8):
                a = at(code, x, corner)
                b = at(code, x + step / 2 * a, corner)
                c = at(code, x + step / 2 * b, corner)
                x = x + step / 6 * (a + 2 * b + 2 * c + at(code, x + step * c, corner))
                if (at(kept, x, corner).max(axis=0) > 1e-6).any():
                    return "a state leaves the region"
            flat, clear = np.zeros(x.shape[1], int), np.zeros(x.shape[1], bool)
            place, ok = [], np.ones(x.shape[1], bool)
            for i, v in enumerate(edges):
                y = x[i]
                if h["periodic"][i]:
                    y = (y - v[0]) % (v[-1] - v[0]) + v[0]
                k = np.searchsorted(v, y, side="right") - 1
                ok &= (k >= 0) & (k < shape[i])
                k = np.clip(k, 0, shape[i] - 1)
                place.append(k)
                width = v[k + 1] - v[k]
                clear |= (y - v[k] < 1e-3 * width) | (v[k + 1] - y < 1e-3 * width)
            flat = np.ravel_multi_index(tuple(place), shape)
            if (~(ok & members[flat]) & ~clear).any():
                return "a state comes to no cell of the file"
    return ""


def attempt(seed: int, number: int) -> Outcome:
    return attacked(partial(_attempt, seed, number))


def passes(header: dict[str, Any], entries: Entries) -> str | None:
    """What the checker says of a file that it accepts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "forged.holdfast"
        sealed(path, header, entries)
        try:
            return check(str(path))
        except Exception:  # whatever it is, the command refuses the file
            return None


def _attempt(seed: int, number: int, outcome: Outcome) -> None:
    p = certified_problem(seed, number)
    _, found, _ = certified(p, seed, number)
    if not 0 < len(found.kept.entries) <= MOST_ENTRIES:
        return
    g = np.random.default_rng([seed, number, 14])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "honest.holdfast"
        found.write(path)
        header, entries = opened(path)
    outcome.judged = 1
    if why := shown_false(header, entries, g):
        outcome.faults.append(Fault("an honest certificate is shown false by simulation", why))
    for _ in range(EACH):
        name, h, e = forged(header, entries, g)
        why = shown_false(h, e, g)
        outcome.counts["forgeries"] = outcome.counts.get("forgeries", 0) + 1
        if not why:
            continue
        outcome.counts["false"] = outcome.counts.get("false", 0) + 1
        if (said := passes(h, e)) is not None:
            outcome.faults.append(Fault(f"a forged certificate passes: {name}", f"{why}; {said}"))


def shrink(seed: int, number: int, fault: Fault) -> None:
    modules = (
        "case",
        "enclosures",
        "problems",
        "oracle",
        "product",
        "writing",
        "certificates",
        "forgeries",
    )
    fault.text = writing.alone(
        f"{fault.signature}.\n\n{fault.message}",
        modules,
        f"print(attempt({seed}, {number}).faults)\n",
    )


KIND = Kind(
    "forged certificates", attempt, shrink, share=0.7, seconds=90.0, shown=("forgeries", "false")
)
