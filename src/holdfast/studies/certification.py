"""Certificates of scenarios: what `holdfast certify` proves, its files, which number would help.

What few cells were certified with is changed, one number at a time.

And the largest current, or other number, for which the region of a scenario is certified.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.analysis.certificates.certify import certify
from holdfast.analysis.certificates.images import forget
from holdfast.analysis.certificates.largest import Advice, CertifiedTrial, Change, LargestCertified
from holdfast.analysis.certificates.outer_set import OuterSet, outer_set
from holdfast.analysis.certificates.problem import INPUTS, counts_of
from holdfast.analysis.load import load
from holdfast.analysis.reachability.solve import Answer, search
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked, renamed
from holdfast.errors import HoldfastError, ScenarioError, check_name
from holdfast.host.files import make_folder, saved, write_summary
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds.kernel import KernelScenario, composed_kernel
from holdfast.scenario.load import check_overrides, load_scenario
from holdfast.scenario.schema.kernel import CERTIFIED
from holdfast.studies.disturbance_margin import can_do_more
from holdfast.studies.scenario_parameter import check_number, find_knob

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
    halvings: int | None = None,
    enclosure: str | None = None,
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
        uncertain=uncertain, errors=errors, delay=delay, halvings=halvings, enclosure=enclosure,
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
    halvings: int = 0,
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
        cells=cells, sample_time=sample_time, inputs=inputs, halvings=halvings, progress=progress,
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


def write_outer(outer: OuterSet, folder: Path, *, figures: bool) -> list[Path]:
    """The cells, what they say in JSON, the certificate of the others of a kernel, the figure."""
    make_folder(folder)
    files = [
        saved(outer, folder / "outer.nc"),
        write_summary(folder / "outer.json", outer.summary()),
    ]
    if outer.lost is not None:
        files = [outer.lost.write(folder / LOST), *files]
    if figures and len(outer.names) > 1:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.certificate import outer_figure

        files += style.write(outer_figure(outer), folder, "outer")
    return files


def clear(folder: Path) -> None:
    """Remove what an earlier question left there: it would be taken for an answer to this one."""
    for name in (FILE, "certificate.json", "certificate.png", "certificate.svg"):
        (folder / name).unlink(missing_ok=True)


def write_certificate(certificate: Certificate, folder: Path, *, figures: bool) -> list[Path]:
    """The certificate, if it has a cell, what it says in JSON, and the figure."""
    make_folder(folder)
    clear(folder)
    files = [write_summary(folder / "certificate.json", certificate.summary())]
    if len(certificate.kept.members):
        files = [certificate.write(folder / FILE), *files]
    else:
        forget(folder)
    if figures and len(certificate.states) > 1:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.certificate import certificate_figure

        files += style.write(certificate_figure(certificate), folder, "certificate")
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
    coarse = cells != asked
    on_cells = {"cells": dict(zip(names, cells, strict=True))} if coarse else {}
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


UNCERTAIN = "uncertain."
"""Before the name of a parameter: how far it may be off its value, either way, is searched."""

TABLES = ("system", "region", "disturbance")
"""Of which a number can be searched."""


@dataclass(frozen=True)
class Searched:
    """The number that is varied: its own value, and what it changes for a certificate."""

    key: str
    name: str
    unit: str
    own: float
    settings: Callable[[float], tuple[str, ...]]
    uncertain: Callable[[float], dict[str, Range]]
    widens: bool


@renamed(refine="halvings")
@checked
def largest_certified(
    scenario: str,
    of: str,
    *,
    between: tuple[float, float] | None = None,
    tolerance: float | None = None,
    share: float = 0.0,
    cells: int | Mapping[str, int] | None = None,
    sample_time: float | None = None,
    horizon: float | None = None,
    inputs: int | Mapping[str, int] | None = None,
    uncertain: Mapping[str, Range] | None = None,
    errors: Mapping[str, float] | None = None,
    delay: float | None = None,
    halvings: int | None = None,
    enclosure: str | None = None,
    overrides: Iterable[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> LargestCertified:
    """The largest number for which a share of a kernel's region is certified, by bisection.

    of: a number of the scenario, such as "current", a bound of its disturbances; or
    "uncertain.mass": how far the parameter `mass` may be off its value, either way, in its unit.
    between: the interval of the search, by default from 0 to twice the value (of how far: to half
    of it); its upper end is doubled while all trials hold. tolerance: the width of the final
    interval, by default a hundredth of the upper end. share: of the cells in the region that has to
    be certified, 0 to 1; 0 asks for one cell. cells, sample_time, horizon, inputs, uncertain,
    errors, delay, halvings, enclosure: as of `certify`; by default as [certificate] of the scenario
    says, with as many cells as the grid has nodes.

    Where a larger number only widens what disturbances or parameters may be, the certificate that
    is found proves all smaller numbers as well. Otherwise values all over the interval are tried
    first, and no more is said than that those were certified which were tried. A number that is not
    certified may be harmless: a certificate says nothing of it.

    Raises `ScenarioError` for a scenario that is no kernel of a region, a key that is not a number
    or that nothing depends on, and an invalid interval, tolerance or share.
    """
    changes = list(overrides)
    if not (math.isfinite(share) and 0 <= share <= 1):
        raise ScenarioError(f"share is {share:g}", expected="0 to 1, of the cells in the region")
    loaded = check_kernel(load_scenario(scenario, changes), scenario)
    requested = dict(uncertain or {})
    off = of.startswith(UNCERTAIN)
    ranges = {**loaded.certificate.get("uncertain", {}), **requested}
    searched = _off(loaded, of, requested) if off else _number(scenario, changes, loaded, of)
    if not off and ranges.keys() & {*searched.key.split(".")}:
        raise ScenarioError(
            f"{loaded.file}: '{of}' is searched, and has a range in uncertain as well"
        )
    low, high = between or (0.0, (0.5 if off else 2.0) * abs(searched.own))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ScenarioError(
            f"{searched.key}: between {low:g} and {high:g}",
            expected="LOW < HIGH", remedy="give the interval: --between LOW HIGH",
        )  # fmt: skip
    if off and low < 0:
        raise ScenarioError(f"{of}: between {low:g} and {high:g}", expected="LOW at or above 0")
    width = tolerance if tolerance is not None else 0.01 * max(abs(low), abs(high))
    if not 0 < width < high - low:
        raise ScenarioError(
            f"the tolerance is {width:g}", expected=f"above 0 and below {high - low:g}"
        )
    if not off:
        ends = [_at(scenario, changes, searched, v) for v in (low, high)]
        searched = replace(searched, widens=can_do_more(*ends))
    best: dict[float, Certificate] = {}

    def attempt(value: float, done: float, part: float) -> CertifiedTrial:
        def tell(_: str, fraction: float) -> None:
            if progress is not None:
                progress(f"{searched.name} {value:.4g}", done + part * fraction)

        begun = time.perf_counter()
        certificate = certified(
            scenario,
            [*changes, *searched.settings(value)],
            cells=cells,
            sample_time=sample_time,
            horizon=horizon,
            inputs=inputs,
            uncertain={**requested, **searched.uncertain(value)},
            errors=errors,
            delay=delay,
            halvings=halvings,
            enclosure=enclosure,
            progress=tell,
        )
        proved = certificate.kept
        holds = len(proved.members) > 0 and proved.share >= share
        if holds:
            best[value] = certificate
        return CertifiedTrial(
            value=value,
            answer=Answer.HELD if holds else Answer.LOST,
            certified=len(proved.members),
            inside=proved.inside,
            wall_time=time.perf_counter() - begun,
        )

    end = high if between is not None else math.inf
    trials = search(attempt, low, high, width, monotone=searched.widens, end=end)
    result = LargestCertified(
        title=loaded.title,
        scenario=scenario if scenario.endswith(".toml") else loaded.name,
        key=searched.key,
        name=searched.name,
        unit=searched.unit,
        share=share,
        widens=searched.widens,
        tolerance=width,
        trials=trials,
        found=None,
    )
    return result if result.low is None else replace(result, found=best[result.low])


def write_largest(largest: LargestCertified, folder: Path, *, figures: bool) -> list[Path]:
    """largest.json, and the certificate of the largest number that is certified."""
    make_folder(folder)
    clear(folder)
    files = (
        [] if largest.found is None else write_certificate(largest.found, folder, figures=figures)
    )
    return [*files, write_summary(folder / "largest.json", largest.summary())]


def _off(loaded: KernelScenario, of: str, requested: Mapping[str, Range]) -> Searched:
    """How far a parameter may be off its value."""
    name = of.removeprefix(UNCERTAIN)
    assert loaded.region is not None
    parameters = {p.name: p for p in (*loaded.system.parameters, *loaded.region.parameters)}
    check_name(name, parameters, ScenarioError, f"{loaded.file}: '{of}': no parameter '{name}'")
    if name in requested:
        raise ScenarioError(
            f"{loaded.file}: '{of}' is searched, and has a range in uncertain as well"
        )
    value = parameters[name].value
    return Searched(
        key=of,
        name=f"{name.replace('_', ' ')} off {value:g}",
        unit=parameters[name].unit,
        own=value,
        settings=lambda v: (),
        uncertain=lambda v: {name: (value - v, value + v)},
        widens=True,
    )


def _number(scenario: str, changes: list[str], loaded: KernelScenario, of: str) -> Searched:
    """A number of the scenario's tables."""
    file, _, data = read_tables(scenario, changes)
    knob = find_knob(loaded, data, of)
    value = check_number(loaded, data, knob)
    if knob.key.partition(".")[0] not in TABLES and not knob.key.startswith("current."):
        raise ScenarioError(
            f"{file}: {knob.key}: no certificate depends on it",
            expected="a number of " + ", ".join(TABLES),
        )
    check_overrides(
        knob.settings(value),
        [composed_kernel(*read_tables(scenario, [*changes, *knob.settings(value)]))],
        lambda some: [composed_kernel(*read_tables(scenario, [*changes, *some]))],
    )
    return Searched(
        knob.key, knob.name, knob.unit, value, knob.settings, lambda v: {}, widens=False
    )


def _at(scenario: str, changes: list[str], searched: Searched, value: float) -> KernelScenario:
    return composed_kernel(*read_tables(scenario, [*changes, *searched.settings(value)]))
