"""Certificates of scenarios: what `holdfast certify` proves, its files, which number would help.

What few cells were certified with is changed, one number at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from holdfast.analysis.certificates.advice import Advice, Change
from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.analysis.certificates.certify import certify
from holdfast.analysis.certificates.images import forget
from holdfast.analysis.certificates.outer_cells import OuterSet
from holdfast.analysis.certificates.outer_set import outer_set
from holdfast.analysis.certificates.problem import INPUTS, counts_of
from holdfast.analysis.load import load
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import HoldfastError, ScenarioError
from holdfast.host.writing import make_folder, saved, write_summary
from holdfast.scenario.kinds.kernel import KernelScenario
from holdfast.scenario.load import load_scenario
from holdfast.scenario.schema.kernel import CERTIFIED

FILE, LOST = "certificate.holdfast", "lost.holdfast"
REACHES = "capture-basin"


def certified(
    scenario: str,
    overrides: Iterable[str] = (),
    *,
    cells: int | Mapping[str, int] | None = None,
    sample_time: float | None = None,
    horizon: float | None = None,
    inputs: int | Mapping[str, int] | None = None,
    uncertain: Mapping[str, Range] | None = None,
    errors: Mapping[str, float] | None = None,
    delay: float | None = None,
    refine: int | None = None,
    store: Path | None = None,
    kernel: Path | None = None,
    margin: float = 0.0,
    progress: Callable[[str, float], None] | None = None,
) -> Certificate:
    """`hf.certify` for the system, the region, the grid's box and the disturbance of a kernel.

    The goal of a capture basin is the target. What is None is as [certificate] of the scenario
    says, else as `hf.certify` does by default; ranges in `uncertain` and `errors` replace those of
    the same name there. cells: as many as the grid has nodes, where neither says. horizon [s]:
    infinite is for ever. kernel: the file of a value function of this scenario: only the cells that
    its set V > `margin` touches are tried. Raises `ScenarioError` for a scenario of another kind.
    """
    loaded = check_kernel(load_scenario(scenario, overrides), scenario)
    if loaded.region is None:
        raise ScenarioError(f"'{scenario}' has no region", remedy="add a [region]")
    candidate = None if kernel is None else _value_in(kernel)
    if store is not None:
        make_folder(store)
    axes = loaded.grid.axes
    options = merged(
        loaded, cells=cells, sample_time=sample_time, horizon=horizon, inputs=inputs,
        uncertain=uncertain, errors=errors, delay=delay, refine=refine,
    )  # fmt: skip
    return certify(
        loaded.system,
        loaded.region,
        box={a.name: (a.low, a.high) for a in axes},
        **options,
        disturbance=loaded.options.get("disturbance"),
        target=loaded.goal if loaded.kind == REACHES else None,
        store=store,
        candidate=candidate,
        margin=margin,
        progress=progress,
    )


def merged(loaded: KernelScenario, **asked: Any) -> dict[str, Any]:
    """Arguments of `hf.certify`: those that are asked for, else what [certificate] says."""
    stated = loaded.certificate
    options = {**stated, **{name: value for name, value in asked.items() if value is not None}}
    for name in ("uncertain", "errors"):
        options[name] = {**stated.get(name, {}), **(asked.get(name) or {})}
    if not isinstance(options.get("cells"), int):
        options["cells"] = {a.name: a.count for a in loaded.grid.axes} | options.get("cells", {})
    if options.get("horizon") == math.inf:
        del options["horizon"]
    return options


def outside_of(
    scenario: str,
    overrides: Iterable[str] = (),
    *,
    outer: Path,
    cells: int | None = None,
    sample_time: float | None = None,
    inputs: int = INPUTS,
    refine: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> OuterSet:
    """`hf.outer_set` for the system and the regions of a scenario, and its set in the file `outer`.

    Raises `ScenarioError` for a scenario whose answer is no set on a grid.
    """
    loaded = load_scenario(scenario, overrides)
    if not isinstance(loaded, KernelScenario):
        raise ScenarioError(
            f"'{scenario}' is no set on a grid", expected="a kernel, a reachable set or a basin"
        )
    reaches = loaded.kind == REACHES
    region = loaded.region if reaches else loaded.about
    return outer_set(
        _value_in(outer), loaded.system, region, target=loaded.goal if reaches else None,
        cells=cells, sample_time=sample_time, inputs=inputs, refine=refine, progress=progress,
    )  # fmt: skip


def _value_in(path: Path) -> ValueFunction:
    """Raises `ScenarioError` for a file of anything else."""
    value = load(path)
    if not isinstance(value, ValueFunction):
        raise ScenarioError(f"{path} is no value function", expected="the result.nc of a kernel")
    return value


def check_kernel(loaded: object, scenario: str) -> KernelScenario:
    """Raises `ScenarioError` for a scenario that is no kernel of a region."""
    if not isinstance(loaded, KernelScenario) or loaded.kind not in CERTIFIED:
        raise ScenarioError(
            f"'{scenario}' is no kernel of a region", expected="a scenario that is one of "
            + ", ".join(CERTIFIED),
        )  # fmt: skip
    return loaded


def write_outer(found: OuterSet, folder: Path, *, figures: bool) -> list[Path]:
    """The cells, what they say in JSON, the certificate of the others of a kernel, the figure."""
    make_folder(folder)
    files = [
        saved(found, folder / "outer.nc"),
        write_summary(folder / "outer.json", found.summary()),
    ]
    if found.lost is not None:
        files = [found.lost.write(folder / LOST), *files]
    if figures and len(found.names) > 1:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.certificate import outer_figure

        files += style.write(outer_figure(found), folder, "outer")
    return files


def clear(folder: Path) -> None:
    """Remove what an earlier question left there: it would be taken for an answer to this one."""
    for name in (FILE, "certificate.json", "certificate.png", "certificate.svg"):
        (folder / name).unlink(missing_ok=True)


def write_certificate(found: Certificate, folder: Path, *, figures: bool) -> list[Path]:
    """The certificate, if it has a cell, what it says in JSON, and the figure."""
    make_folder(folder)
    clear(folder)
    files = [write_summary(folder / "certificate.json", found.summary())]
    if len(found.kept.members):
        files = [found.write(folder / FILE), *files]
    else:
        forget(folder)
    if figures and len(found.states) > 1:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.certificate import certificate_figure

        files += style.write(certificate_figure(found), folder, "certificate")
    return files


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
