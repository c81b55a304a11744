"""Disturbance margin: the largest current, or other number, with a nonempty viability kernel."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from holdfast.analysis.reachability.problem import Marching
from holdfast.analysis.reachability.solve import Answer, Kept, Margin, Tried, search, set_on_grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import ScenarioError, check_name
from holdfast.maths.definitions.quantity import TIME, to_si
from holdfast.maths.definitions.region import Region
from holdfast.maths.games.hamiltonian import hamiltonian, is_sharp
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds.kernel import KernelScenario, composed_kernel, is_kernel
from holdfast.scenario.load import check_overrides
from holdfast.scenario.schema.values import at
from holdfast.studies.scenario_parameter import CURRENT, Knob, check_number, find_knob

KERNELS = ("viability-kernel", "discriminating-kernel", "invariance-kernel")
UNUSED_TABLES = ("promise", "law")
"""The tables of the closed-loop validation, which a search does not use."""

UNUSED = ("checkpoint", "estimate_error", "check_outside")
"""Keys of [march] for a single march, which a search of many does not use."""


@checked
def disturbance_margin(
    scenario: str,
    of: str = CURRENT,
    *,
    between: tuple[float, float] | None = None,
    tolerance: float | None = None,
    keep: Sequence[Mapping[str, Any] | Region] = (),
    overrides: Iterable[str] = (),
    warm_start: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> Margin:
    """The largest number for which the kernel of a scenario is not empty, or contains `keep`.

    of: a key of the scenario, such as "system.current_limit", or "current.speed": the speed of the
    prescribed current, in its direction, or the largest speed of an unknown one. between: the
    interval of the search, by default from 0 to twice the value of the scenario; its upper end is
    doubled while all trials hold, up to the bounds of the system for a prescribed current.
    tolerance: the width of the final interval, by default a hundredth of the upper end. keep:
    states, by name (missing ones are 0), and regions that the kernel has to contain. The kernel is
    that of the scenario's horizon; with [march] forever = true the infinite-horizon kernel.
    warm_start: whether a march begins with a kernel that is there, as below.

    If a larger number only widens the bounds of the disturbances, it can only shrink the kernel,
    and the limit is bisected at once. Otherwise values all over the interval are tried first, to
    see whether there is one limit. In the first case, if the infinite-horizon kernel is requested
    and the steps are monotone (scheme "upwind"), every march begins with the kernel of a smaller
    bound (`solve.solve`). A finite-horizon kernel cannot be found that way, and schemes of higher
    order may converge above the kernel: they begin with the region.

    Raises `ScenarioError` for a scenario that is not a kernel, a key that is not a number, an
    override or a number that nothing depends on, and an invalid interval or tolerance.
    """
    changes = list(overrides)
    file, text, data = read_tables(scenario, changes)
    if not is_kernel(file, data) or data["scenario"]["kind"] not in KERNELS:
        raise ScenarioError(
            f"'{scenario}' does not compute a kernel", expected="a scenario that is one of "
            + ", ".join(KERNELS),
        )  # fmt: skip
    loaded = composed_kernel(file, text, data)
    for name in UNUSED:
        if name in loaded.options:
            raise ScenarioError(
                f"{file}: march.{name}: a search over many marches does not use it",
                remedy=f"remove it with --set march.{name}=",
            )
    knob = find_knob(loaded, data, of)
    _check_used(file, knob.key)
    value = check_number(loaded, data, knob)

    def of_changes(some: Sequence[str]) -> list[KernelScenario]:
        shown, its_text, tables = read_tables(scenario, some)
        used = {name: table for name, table in tables.items() if name not in UNUSED_TABLES}
        return [composed_kernel(shown, its_text, used)]

    def composed(value: float) -> KernelScenario:
        return of_changes([*changes, *knob.settings(value)])[0]

    for change in changes:
        _check_used(file, change)
    check_overrides(changes, [loaded], lambda s: [composed_kernel(*read_tables(scenario, s))])
    check_overrides(knob.settings(value), [composed(value)], lambda s: of_changes([*changes, *s]))
    low, high = _interval(knob, value, between)
    close = tolerance if tolerance is not None else 0.01 * max(abs(low), abs(high))
    if not 0 < close < high - low:
        raise ScenarioError(
            f"the tolerance is {close:g}", expected=f"above 0 and below {high - low:g}"
        )
    end = knob.limit if between is None else high
    required = _kept(loaded, keep)
    monotone = can_do_more(composed(low), composed(high))
    marching = {n: v for n, v in loaded.options.items() if n in Marching.__dataclass_fields__}
    orderly = Marching(**marching).monotone and is_sharp(hamiltonian(loaded.system))
    warm = warm_start and monotone and loaded.forever and orderly
    trials = _Trials(composed, required, warm, knob.name, progress)
    tried = search(trials.attempt, low, high, close, monotone=monotone, end=end)
    result = Margin(
        title=loaded.title,
        scenario=scenario if scenario.endswith(".toml") else loaded.name,
        key=knob.key,
        name=knob.name,
        unit=knob.unit,
        keeps=required.asked,
        horizon=loaded.horizon,
        forever=loaded.forever,
        tolerance=close,
        monotone=monotone,
        trials=tried,
        end=knob.limit,
    )
    if result.low is not None:
        result = replace(result, settings=(*changes, *knob.settings(result.low)))
    return result


class _Trials:
    """Kernels in turn; the last one that holds is stored for the next warm start."""

    def __init__(
        self,
        composed: Callable[[float], KernelScenario],
        required: Kept,
        warm: bool,
        name: str,
        progress: Callable[[str, float], None] | None,
    ) -> None:
        self.composed, self.kept, self.warm, self.name = composed, required, warm, name
        self.progress = progress
        self.before: tuple[float, KernelScenario, ValueFunction] | None = None

    def attempt(self, value: float, done: float, share: float) -> Tried:
        """The kernel with this value; done, share: of all work, before it and its own."""
        asked = self.composed(value)
        options = {n: v for n, v in asked.options.items() if n != "times"}
        if not _moves(asked):  # otherwise a kernel lost so far need not be lost in the end
            options["until"] = self.kept.lost
        before = self.before
        warm = before is not None and before[0] < value and can_do_more(before[1], asked)
        if before is not None and warm:
            options["begin"] = before[2]

        def tell(fraction: float) -> None:
            if self.progress is not None:
                self.progress(f"{self.name} {value:.4g}", done + share * fraction)

        kernel = replace(asked, options=options).solve(tell)
        report = kernel.report
        least, converged = self.kept.least(kernel), report.converged
        if not least > 0:
            answer = Answer.LOST
        else:
            answer = Answer.HELD if converged or not asked.forever else Answer.UNDECIDED
        if self.warm and answer is Answer.HELD and (before is None or value > before[0]):
            self.before = value, asked, kernel
        unknown = self.kept.asked and answer is Answer.LOST
        return Tried(
            value=value,
            answer=answer,
            least=least,
            fraction=math.nan if unknown else kernel.fraction(),
            converged=converged,
            warm=warm,
            steps=report.steps,
            reached=report.reached_s,
            wall_time=report.wall_time_s,
        )


def _check_used(file: str, key: str) -> None:
    """Refuse a key of a table that the search does not use."""
    if key.partition(".")[0].strip() in UNUSED_TABLES:
        raise ScenarioError(
            f"{file}: {key}: no kernel depends on it",
            expected="a number of the system, the region, the disturbance, the grid or the march",
        )


def _interval(knob: Knob, value: float, between: tuple[float, float] | None) -> tuple[float, float]:
    if between is None:
        if not value > 0:
            raise ScenarioError(
                f"{knob.key} is {value:g}", expected="a number above 0 to begin with",
                remedy="give the interval: --between LOW HIGH",
            )  # fmt: skip
        return 0.0, min(2.0 * value, knob.limit)
    low, high = (float(v) for v in between)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ScenarioError(f"between {low:g} and {high:g}", expected="LOW < HIGH")
    return low, high


def _kept(loaded: KernelScenario, keep: Sequence[Mapping[str, Any] | Region]) -> Kept:
    units = {q.name: q.unit for q in loaded.system.states}
    begun = set_on_grid(loaded.about, loaded.grid)
    states, regions = [], []
    for wanted in keep:
        if isinstance(wanted, Region):
            regions.append(wanted)
            continue
        for name in wanted:
            check_name(name, units, ScenarioError, f"--keep: unknown state '{name}'")
        with at("--keep", ", ".join(wanted)):
            states.append([to_si(wanted.get(n, 0.0), unit) for n, unit in units.items()])
        if not begun.at([states[-1]])[0] > 0:
            shown = ", ".join(f"{n} = {v:g}" for n, v in zip(units, states[-1], strict=True))
            raise ScenarioError(
                f"--keep: {shown} is not in region '{loaded.about.name}' and on the grid",
                expected="a state that the kernel could contain",
            )
    required = Kept(loaded.grid, states, regions)
    if regions and required.lost(begun):
        raise ScenarioError(
            f"--keep: a region is not within region '{loaded.about.name}'",
            expected="one that the kernel could contain",
        )
    return required


def _moves(scenario: KernelScenario) -> bool:
    rates = scenario.system.rates.values()
    return any(r.has(TIME) for r in rates) or scenario.about.moves


def can_do_more(one: KernelScenario, other: KernelScenario) -> bool:
    """Whether `other` differs from `one` only by larger bounds of its disturbances."""
    mine, theirs = one.system, other.system
    used = {s for r in mine.rates.values() for s in r.free_symbols} | one.about.margin.free_symbols
    if mine.input_bounds is not None:
        used |= mine.input_bounds.free_symbols
    values = [
        {q.symbol: q.value for q in (*s.system.parameters, *s.about.parameters)}
        for s in (one, other)
    ]
    same = (
        {s: v for s, v in values[0].items() if s in used}
        == {s: v for s, v in values[1].items() if s in used}
        and mine.rates == theirs.rates
        and mine.input_bounds == theirs.input_bounds
        and one.about.margin == other.about.margin
        and one.grid == other.grid
        and one.options == other.options
        and (one.horizon, one.forever) == (other.horizon, other.forever)
    )
    small, large = mine.disturbance_bounds, theirs.disturbance_bounds
    if not same or small is None or large is None:
        return False
    return small.at(values[0]).within(large.at(values[1]))
