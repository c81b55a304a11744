"""The largest current, or other number, for which a scenario's region is certified."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.analysis.certificates.largest import CertifiedTrial, LargestCertified
from holdfast.analysis.reachability.solve import Answer, search
from holdfast.arguments import checked
from holdfast.errors import ScenarioError, suggestion
from holdfast.host.writing import make_folder, write_summary
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds.kernel import KernelScenario, composed_kernel
from holdfast.scenario.load import check_overrides, load_scenario
from holdfast.studies.certification import certified, check_kernel, clear, write_certificate
from holdfast.studies.disturbance_margin import can_do_more
from holdfast.studies.scenario_parameter import check_number, find_knob

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
    refine: int | None = None,
    overrides: Iterable[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> LargestCertified:
    """The largest number for which a share of a kernel's region is certified, by bisection.

    of: a number of the scenario, such as "current", a bound of its disturbances; or
    "uncertain.mass": how far the parameter `mass` may be off its value, either way, in its unit.
    between: the interval of the search, by default from 0 to twice the value (of how far: to half
    of it); its upper end is doubled while all trials hold. tolerance: the width of the final
    interval, by default a hundredth of the upper end. share: of the cells in the region that has to
    be certified, 0 to 1; 0 asks for one cell. The others: as of `certify`, and by default as
    [certificate] of the scenario says; as many cells as the grid has nodes.

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
    own = check_kernel(load_scenario(scenario, changes), scenario)
    given = dict(uncertain or {})
    off = of.startswith(UNCERTAIN)
    ranges = {**own.certificate.get("uncertain", {}), **given}
    searched = _off(own, of, given) if off else _number(scenario, changes, own, of)
    if not off and ranges.keys() & {*searched.key.split(".")}:
        raise ScenarioError(f"{own.file}: '{of}' is searched, and has a range in uncertain as well")
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
        found = certified(
            scenario,
            [*changes, *searched.settings(value)],
            cells=cells,
            sample_time=sample_time,
            horizon=horizon,
            inputs=inputs,
            uncertain={**given, **searched.uncertain(value)},
            errors=errors,
            delay=delay,
            refine=refine,
            progress=tell,
        )
        kept = found.kept
        holds = len(kept.members) > 0 and kept.share >= share
        if holds:
            best[value] = found
        return CertifiedTrial(
            value=value,
            answer=Answer.HELD if holds else Answer.LOST,
            certified=len(kept.members),
            inside=kept.inside,
            wall_time=time.perf_counter() - begun,
        )

    end = high if between is not None else math.inf
    trials = search(attempt, low, high, width, monotone=searched.widens, end=end)
    result = LargestCertified(
        title=own.title,
        scenario=scenario if scenario.endswith(".toml") else own.name,
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


def write_largest(found: LargestCertified, folder: Path, *, figures: bool) -> list[Path]:
    """largest.json, and the certificate of the largest number that is certified."""
    make_folder(folder)
    clear(folder)
    files = [] if found.found is None else write_certificate(found.found, folder, figures=figures)
    return [*files, write_summary(folder / "largest.json", found.summary())]


def _off(own: KernelScenario, of: str, given: Mapping[str, Range]) -> Searched:
    """How far a parameter may be off its value."""
    name = of.removeprefix(UNCERTAIN)
    assert own.region is not None
    known = {p.name: p for p in (*own.system.parameters, *own.region.parameters)}
    if name not in known:
        raise ScenarioError(
            f"{own.file}: '{of}': no parameter '{name}'", remedy=suggestion(name, known)
        )
    if name in given:
        raise ScenarioError(f"{own.file}: '{of}' is searched, and has a range in uncertain as well")
    value = known[name].value
    return Searched(
        key=of,
        name=f"{name.replace('_', ' ')} off {value:g}",
        unit=known[name].unit,
        own=value,
        settings=lambda v: (),
        uncertain=lambda v: {name: (value - v, value + v)},
        widens=True,
    )


def _number(scenario: str, changes: list[str], own: KernelScenario, of: str) -> Searched:
    """A number of the scenario's tables."""
    file, _, data = read_tables(scenario, changes)
    knob = find_knob(own, data, of)
    value = check_number(own, data, knob)
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
