"""Which number helps: what few cells were certified with is changed, one number at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from holdfast.analysis.certificates.advice import Advice, Change
from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.problem import INPUTS, counts_of
from holdfast.errors import HoldfastError
from holdfast.scenario.load import load_scenario
from holdfast.studies.certification import certified, check_kernel, merged

ENOUGH, GAIN = 0.9, 0.02
"""Shares of the region: that needs no advice, and by how much more a change is worth a word."""

MOST_CELLS, MOST_TWICE = 20_000, 110_000
"""Cells of a trial: where more were asked for, each axis has fewer, so that trials are quick; and
of the trial of twice the cells, which is left out where they are more."""

TIMES = (0.5, 2, 0.2, 5, 0.1)
"""Sample times that are tried, as multiples of the one that was asked for, the nearest first."""


def what_helps(
    certificate: Certificate,
    scenario: str,
    overrides: Iterable[str],
    options: Mapping[str, Any],
    progress: Callable[[str, float], None] | None = None,
) -> Advice | None:
    """Trials of other sample times, of twice the cells and of more inputs.

    options: of `certified`, as they were asked for. None where enough is certified. A trial that is
    refused, such as of a sample time below the delay, counts as none.
    """
    certified_share, names = certificate.kept.share, [name for name, _ in certificate.states]
    if certified_share >= ENOUGH:
        return None
    loaded = check_kernel(load_scenario(scenario, overrides), scenario)
    asked = tuple(count >> certificate.kept.depth for count in certificate.cells.counts)
    total = math.prod(asked)
    coarser = max(1.0, (total / MOST_CELLS) ** (1 / len(asked)))
    cells = tuple(min(count, max(3, round(count / coarser))) for count in asked)
    on_cells = {"cells": dict(zip(names, cells, strict=True))}
    periods = [float(f"{k * certificate.hold:.4g}") for k in TIMES]
    kinds: list[dict[str, dict[str, Any]]] = [
        {f"--sample-time {period:g}": {**on_cells, "sample_time": period} for period in periods}
    ]
    tried = merged(loaded, **options).get("inputs", INPUTS)
    if certificate.inputs:
        each = {n: 2 * count - 1 for n, count in zip(
            loaded.system.input_names, counts_of(loaded.system, tried), strict=True
        )}  # fmt: skip
        more = 2 * tried - 1 if isinstance(tried, int) else each
        kinds.append({_option("inputs", each): {**on_cells, "inputs": more}})
    if total << len(asked) <= MOST_TWICE:
        twice = {name: 2 * count for name, count in zip(names, asked, strict=True)}
        kinds.append({_option("cells", twice): {"cells": twice}})
    trials, done = 1 + sum(map(len, kinds)), 0

    def share(change: Mapping[str, Any]) -> float | None:
        nonlocal done
        if progress is not None:
            progress("trying what helps", done / trials)
        done += 1
        try:
            return certified(scenario, overrides, **{**options, **change}).kept.share
        except HoldfastError:
            return None

    coarse = cells != asked
    before = (share(on_cells) or 0.0) if coarse else certified_share
    ran, best = list[str](), list[Change]()
    for kind in kinds:
        shares = {option: share(change) for option, change in kind.items()}
        done_ones = {option: value for option, value in shares.items() if value is not None}
        ran += done_ones
        if done_ones:
            option = max(done_ones, key=lambda name: round(done_ones[name], 3))
            value, on_asked = done_ones[option], not coarse or kind[option].keys() == {"cells"}
            best.append(
                Change(option, value, certified_share)
                if on_asked
                else Change(option, value, before, cells)
            )
    gains = [change for change in best if change.share >= change.before + GAIN]
    return Advice(tuple(ran), tuple(sorted(gains, key=lambda change: -change.share)))


def _option(name: str, counts: Mapping[str, int]) -> str:
    """The option of the command for as many along each, or along each its own."""
    if len({*counts.values()}) == 1:
        return f"--{name} {next(iter(counts.values()))}"
    each = ", ".join(f"{n} = {count}" for n, count in counts.items())
    return f"--set 'certificate.{name}={{{each}}}'"
