"""Which number helps: what few cells were certified with is changed, one number at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.errors import HoldfastError
from holdfast.studies.certification import certified

ENOUGH, GAIN = 0.9, 0.02
"""Shares of the region: that needs no advice, and by how much more a change is worth a word."""

MOST_CELLS = 50_000
"""Cells of a trial: where more were asked for, each axis has fewer, so that trials are quick."""

TIMES = (0.5, 2, 0.2, 5, 0.1)
"""Sample times that are tried, as multiples of the one that was asked for, the nearest first."""


@dataclass(frozen=True)
class Change:
    """One number changed alone: the option of the command, and the share that is certified."""

    option: str
    share: float


@dataclass(frozen=True)
class Advice:
    """What changes of single numbers gain, on `cells` along each state.

    share: certified without a change. coarser: whether these are fewer cells than were asked for.
    changes: those that gain, the best of sample times, cells and inputs, the best one first.
    """

    share: float
    cells: tuple[int, ...]
    coarser: bool
    changes: tuple[Change, ...]


def what_helps(
    certificate: Certificate,
    scenario: str,
    overrides: Iterable[str],
    options: Mapping[str, Any],
    progress: Callable[[str, float], None] | None = None,
) -> Advice | None:
    """Trials of other sample times, of twice the cells and of more inputs.

    options: of `certified`, as they were asked for. None where enough is certified. A trial that is
    refused, such as of a sample time below the delay, gains nothing.
    """
    kept, names = certificate.kept, [name for name, _ in certificate.states]
    if kept.share >= ENOUGH:
        return None
    asked = tuple(count >> kept.depth for count in certificate.cells.counts)
    finer = max(1.0, (math.prod(asked) / MOST_CELLS) ** (1 / len(asked)))
    cells = tuple(max(3, round(count / finer)) for count in asked)
    periods = [float(f"{k * certificate.hold:.4g}") for k in TIMES]
    twice = {name: 2 * count for name, count in zip(names, cells, strict=True)}
    kinds: list[dict[str, dict[str, Any]]] = [
        {f"--sample-time {period:g}": {"sample_time": period} for period in periods},
        {_option("cells", names, [2 * count for count in asked]): {"cells": twice}},
    ]
    if certificate.inputs:
        each = [2 * len(np.unique(values)) - 1 for values in certificate.candidates.T]
        counts = {name: count for (name, _), count in zip(certificate.inputs, each, strict=True)}
        kinds.append({_option("inputs", list(counts), each): {"inputs": counts}})
    trials, done = 1 + sum(map(len, kinds)), 0
    base = {**options, "cells": dict(zip(names, cells, strict=True))}

    def share(change: Mapping[str, Any]) -> float:
        nonlocal done
        if progress is not None:
            progress("trying what helps", done / trials)
        done += 1
        try:
            return certified(scenario, overrides, **{**base, **change}).kept.share
        except HoldfastError:
            return 0.0

    before = share({}) if cells != asked else kept.share
    best = []
    for kind in kinds:
        tried = [Change(option, share(change)) for option, change in kind.items()]
        best.append(max(tried, key=lambda change: round(change.share, 3)))
    gains = [change for change in best if change.share >= before + GAIN]
    gains.sort(key=lambda change: -change.share)
    return Advice(before, cells, cells != asked, tuple(gains))


def _option(name: str, of: list[str], counts: list[int]) -> str:
    """The option of the command for as many along each, or along each its own."""
    if len({*counts}) == 1:
        return f"--{name} {counts[0]}"
    each = ", ".join(f"{n} = {count}" for n, count in zip(of, counts, strict=True))
    return f"--set 'certificate.{name}={{{each}}}'"
