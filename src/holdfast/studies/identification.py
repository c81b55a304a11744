"""From a log to a vehicle to a guarantee: the file of the vehicle, and its scenario redrawn."""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from holdfast.analysis.identification.fit import Identified
from holdfast.errors import HoldfastError, ScenarioError
from holdfast.host.files import make_folder, write_summary, write_text
from holdfast.maths.catalogue import systems
from holdfast.maths.control.unmodelled import PREFIX
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import is_vehicle, read_vehicle, vehicle_names
from holdfast.maths.expressions.parser import parse_formula
from holdfast.scenario.build.composer import REDUCTIONS
from holdfast.scenario.files import (
    Number,
    edited_text,
    is_scenario,
    load_system,
    numbered_vehicle,
    read_tables,
    scenario_names,
)
from holdfast.scenario.glossary import meant
from holdfast.scenario.kinds.closed_loop import resting_places
from holdfast.scenario.kinds.kernel import KernelResult
from holdfast.scenario.load import load_scenario
from holdfast.studies.disturbance_margin import disturbance_margin

VEHICLE, SCENARIO = "vehicle.toml", "identified.toml"
"""Files that are written."""

DRAWS = 36
"""Disturbances of drawn values in which a place at rest is sought."""

NOT_ASKED = "not asked for"

_DIGITS = 7


@dataclass(frozen=True)
class Subject:
    """What is identified: a vehicle, a system of the catalogue, or the system of a scenario.

    system: whole, without the reductions of a scenario. vehicle: its file or its name, "" without
    one. scenario: "" if there is none. overrides: of the scenario. asks: whether the scenario asks
    anything; a file with a system alone does not.
    """

    system: System
    vehicle: str
    scenario: str
    overrides: tuple[str, ...]
    asks: bool = False


def subject_of(name: str, overrides: Iterable[str] = ()) -> Subject:
    """The system of that name: a shipped vehicle or its file, a system, a scenario or its file.

    Raises `ScenarioError` for an unknown name.
    """
    changes = tuple(overrides)
    catalogue = [f.__name__ for f in systems.ALL]
    if is_vehicle(name):
        kind = str(read_vehicle(name)[1]["system"])
        if kind not in catalogue:
            raise ScenarioError(f"vehicle '{name}' is for system '{kind}', which is unknown")
        return Subject(load_system(kind, (f'vehicle="{name}"', *changes)), name, "", ())
    if name in catalogue:
        return Subject(load_system(name, changes), _vehicle_of(name, changes), "", ())
    if not is_scenario(name):
        names = [*vehicle_names(), *catalogue, *scenario_names()]
        raise ScenarioError(
            f"no vehicle, system, scenario or file is called '{name}'",
            remedy=meant(name, names),
        )
    tables = read_tables(name, changes)[2]
    table, header = tables.get("system"), tables.get("scenario", {})
    if not isinstance(table, Mapping):
        raise ScenarioError(f"{name}: no table [system]")
    dropped = [f"system.{key}=" for key in REDUCTIONS if key in table]
    whole = load_system(name, (*changes, *dropped))
    vehicle = str(table.get("vehicle", "")) or _vehicle_of(str(table.get("name", "")), ())
    asks = "law" in tables or (isinstance(header, Mapping) and "kind" in header)
    return Subject(whole, vehicle, name, changes, asks)


def _vehicle_of(name: str, changes: Iterable[str]) -> str:
    """The vehicle of a system of the catalogue, "" where it has none."""
    vehicles = [c.partition("=")[2].strip("\"' ") for c in changes if c.startswith("vehicle=")]
    function = next((f for f in systems.ALL if f.__name__ == name), None)
    taken = inspect.signature(function).parameters if function else {}
    if "vehicle" not in taken:
        return ""
    return vehicles[-1] if vehicles else str(taken["vehicle"].default)


def vehicle_with(identified: Identified, subject: Subject) -> str:
    """The text of the vehicle's file with the numbers of the log; "" without such a file."""
    if not subject.vehicle:
        return ""
    numbers = {
        e.name: Number(
            _rounded(e.value),
            e.unit,
            f"identified from {identified.log}: {100 * identified.level:g} % from "
            f"{e.low:.4g} to {e.high:.4g}" + (f", {e.status}" if e.status != "identified" else ""),
        )
        for e in identified.parameters
        if e.name in identified.values
    }
    filed = {p.name: p.value for p in load_system_of(subject).parameters}
    for p in identified.system.parameters:  # with which the others were found
        if p.name not in numbers and p.value != filed.get(p.name, p.value):
            source = f"given, when others were identified from {identified.log}"
            numbers[p.name] = Number(_rounded(p.value), p.unit, source)
    return numbered_vehicle(
        subject.vehicle,
        numbers,
        f"Numbers identified from {identified.log}: see identification.json.",
    )


def load_system_of(subject: Subject) -> System:
    """The system of the vehicle's file as it is."""
    kind = str(read_vehicle(subject.vehicle)[1]["system"])
    return load_system(kind, (f'vehicle="{subject.vehicle}"',))


def scenario_with(identified: Identified, subject: Subject) -> tuple[str, tuple[str, ...]]:
    """The text of the scenario with the numbers and the bound of the log; what it cannot count.

    The names are of states that the scenario has no rate of, such as those that are promoted to
    inputs. Raises `ScenarioError` where the scenario refuses the numbers.
    """
    reduced = load_system(subject.scenario, (*subject.overrides, "system.unmodelled="))
    left = identified.unexplained
    counted = {
        n: [_rounded(a), _rounded(b)]
        for n, a, b in zip(left.names, left.low, left.high, strict=True)
        if n in reduced.state_names
    }
    changes = list(subject.overrides)
    if not subject.vehicle:
        table = read_tables(subject.scenario, subject.overrides)[2]["system"]
        declared = table.get("parameters", {})
        for name, value in identified.values.items():
            key = f"parameters.{name}.value" if name in declared else name
            changes.append(f"system.{key}={_rounded(value)!r}")
    changes.append("system.unmodelled=")
    document: Any = tomlkit.parse(edited_text(subject.scenario, changes))
    if subject.vehicle:
        document["system"]["vehicle"] = VEHICLE
    if counted:
        box = tomlkit.inline_table()
        box.update(counted)
        document["system"]["unmodelled"] = box
        if "safeguard" in document:
            document["safeguard"]["worst"] = [PREFIX + n for n in counted]
    if "safeguard" in document:
        document["safeguard"].pop("uncertain", None)  # ranges about the former numbers
    missing = tuple(n for n in left.names if n not in counted)
    return tomlkit.dumps(document), missing


def write_identified(
    identified: Identified, subject: Subject, folder: Path, *, figures: bool
) -> list[Path]:
    """identification.json and its page, and where there are such the vehicle and the scenario."""
    make_folder(folder)
    files = [write_summary(folder / "identification.json", identified.summary())]
    if text := vehicle_with(identified, subject):
        files.append(write_text(folder / VEHICLE, text))
    if subject.scenario:
        files.append(write_text(folder / SCENARIO, scenario_with(identified, subject)[0]))
    if figures:
        from holdfast.presentation.figures import style
        from holdfast.presentation.studies.identification import identification_figure

        files += style.write(identification_figure(identified), folder, "identification")
    return files


def measured_expressions(system: System, texts: Mapping[str, str]) -> dict[str, Any]:
    """What signals measure, from texts of states, disturbances and parameters."""
    symbols = {q.name: q.symbol for q in (*system.states, *system.disturbances, *system.parameters)}
    return {name: parse_formula(text, symbols) for name, text in texts.items()}


Row = tuple[str, float, float, float]


@dataclass(frozen=True)
class Redrawn:
    """What a scenario answers with its own numbers and with those of the log.

    rows: (what, before, after, of how many, NaN for none). missing: states of the bound that the
    scenario has no rate of. no_margin: why no margin was computed, "" if one was.
    """

    rows: tuple[Row, ...]
    missing: tuple[str, ...]
    no_margin: str = ""

    def summary(self) -> dict[str, Any]:
        """Plain data."""
        rows = [
            {"what": w, "before": a, "after": b, "of": None if n != n else n}
            for w, a, b, n in self.rows
        ]
        return {
            "answers": rows,
            "not_counted": list(self.missing),
            "no_margin": self.no_margin,
        }


def redrawn(
    identified: Identified,
    subject: Subject,
    folder: Path,
    *,
    runs: int | None = None,
    seed: int | None = None,
    figures: bool = True,
    margins: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Redrawn, list[Path]]:
    """The scenario with its own numbers and with those of the log, and the files of the second.

    A kernel: the shares of its box. A closed loop: how many runs stay in the region and reach the
    goal; with a safeguard also against the bound at all its corners, held constant, the filter
    without and with the bound. margins: also what `holdfast margin` answers, before and after.
    `write_identified` has written the scenario to `folder`.
    """
    tell = progress or (lambda what, share: None)
    missing = scenario_with(identified, subject)[1]
    path = str(folder / SCENARIO)
    tell("scenario with its own numbers", 0.0)
    before = load_scenario(subject.scenario, subject.overrides, runs, seed)
    old = before.run(lambda share: tell("scenario with its own numbers", 0.3 * share))
    after = load_scenario(path, (), runs, seed)
    new = after.run(lambda share: tell("scenario with those of the log", 0.3 + 0.3 * share))
    files = after.write(new, folder / "scenario", figures=figures)
    nothing = float("nan")
    if isinstance(old, KernelResult):
        pair = [answer.value.summary()["fraction_of_box"] for answer in (old, new)]
        kept_share: Row = ("share of the grid's box kept", *pair, nothing)
        more, why = _margins(subject, path, _largest_current, tell) if margins else ([], NOT_ASKED)
        return Redrawn((kept_share, *more), missing, why), files
    count = float(new.arrays.sizes["run"])
    stay = "runs that stay in the region"
    rows: list[Row] = [(stay, old.viable, new.viable, count)]
    first, second = (float(a.outcomes.get("reached goal", 0)) for a in (old, new))
    if first or second:
        rows.append(("runs that reach the goal", first, second, count))
    worst = read_tables(path)[2].get("safeguard", {}).get("worst", [])
    if worst:
        counts = [0, 0]
        corners = list(_corners(path, worst))
        for k, corner in enumerate(corners):
            for which, less in enumerate((("safeguard.worst=",), ())):
                loaded = load_scenario(path, (*corner, *less), runs, seed)
                counts[which] += int(loaded.run().viable)
                tell("corners of the bound", 0.6 + 0.4 * (k + 1) / len(corners))
        what = "the same, the bound at its corners; before: the filter does not count it"
        rows.append((what, counts[0], counts[1], count * len(corners)))
    more, why = _margins(subject, path, _place_at_rest, tell) if margins else ([], NOT_ASKED)
    return Redrawn((*rows, *more), missing, why), files


def _margins(
    subject: Subject,
    path: str,
    answer: Callable[[str, Iterable[str]], dict[str, tuple[float, float]]],
    tell: Callable[[str, float], None],
) -> tuple[list[Row], str]:
    """What `holdfast margin` answers before and after, or why it answers nothing."""
    try:
        tell("margin with its own numbers", 0.8)
        before = answer(subject.scenario, subject.overrides)
        tell("margin with those of the log", 0.9)
        after = answer(path, ())
    except HoldfastError as error:
        return [], error.cause
    return [(what, value, after[what][0], of) for what, (value, of) in before.items()], ""


def _largest_current(scenario: str, overrides: Iterable[str]) -> dict[str, tuple[float, float]]:
    """The largest current that leaves a kernel, NaN where none does."""
    margin = disturbance_margin(scenario, overrides=overrides)
    low = math.nan if margin.low is None else margin.low
    return {f"largest {margin.name} that leaves a kernel [{margin.unit}]": (low, math.nan)}


def _place_at_rest(scenario: str, overrides: Iterable[str]) -> dict[str, tuple[float, float]]:
    """In how many of the disturbances there is a place at rest, and the least margin of one."""
    resting = resting_places(load_scenario(scenario, overrides), DRAWS)
    margins = [f.margin for f in resting.found if f.exists]
    return {
        "disturbances that leave a place at rest": (len(margins), len(resting.found)),
        "the least margin of such a place": (min(margins, default=math.nan), math.nan),
    }


def _corners(path: str, worst: Iterable[str]) -> Iterable[tuple[str, ...]]:
    """The disturbances at each corner of the bound, as overrides."""
    box = read_tables(path)[2]["system"]["unmodelled"]
    sides = [[f"disturbance.{n}={end!r}" for end in box[n.removeprefix(PREFIX)]] for n in worst]
    return itertools.product(*sides)


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
