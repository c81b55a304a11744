"""[starts], [run], [noise] and [varied.draws]: where a closed loop begins, and how it is simulated.

What varies from run to run are parameters with ranges.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from holdfast.analysis.simulation.starts import Starts
from holdfast.errors import ScenarioError, suggestion
from holdfast.maths.definitions.quantity import Parameter, check_unit, to_si
from holdfast.maths.definitions.system import System
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.schema.closed_loop import FormationSpec, RunSpec, ScenarioSpec, VariedSpec
from holdfast.scenario.schema.values import at


def drawn_names(composer: Composer, system: System, spec: VariedSpec) -> dict[str, Parameter]:
    """The drawn names as parameters, for laws and goals whose expressions use them."""
    moving = {q.name for q in (*system.states, *system.inputs, *system.disturbances)}
    found = {}
    for name, draw in spec.ranges.items():
        with at(composer.file, f"varied.draws.{name}"):
            if name in moving:
                raise ScenarioError(
                    f"'{name}' is a state, an input or a disturbance", expected="a parameter"
                )
            check_unit(draw.unit or "1")
            found[name] = Parameter(name, draw.unit or "1", "drawn for every run", value=0.0)
    return found


def drawn_ranges(composer: Composer, spec: VariedSpec) -> dict[str, tuple[float, float]]:
    """The ranges in SI units; names that are not yet declared are declared."""
    ranges = {}
    for name, draw in spec.ranges.items():
        with at(composer.file, f"varied.draws.{name}"):
            unit = composer.known.get(name, composer.drawn[name]).unit
            if draw.unit is not None and draw.unit != unit:
                raise ScenarioError(f"'{name}' has the unit {unit}", expected=f"unit = '{unit}'")
            low, high = draw.range
            ranges[name] = (to_si(low, unit), to_si(high, unit))
            composer.declare((composer.drawn[name],))
    return ranges


def known_name(file: str, key: str, name: str, known: Iterable[str]) -> str:
    if name not in (choices := list(known)):
        raise ScenarioError(f"{file}: {key}: unknown name", remedy=suggestion(name, choices))
    return name


def in_si(file: str, key: str, value: object, units: Mapping[str, str], name: str) -> float:
    known_name(file, key, name, units)
    with at(file, key):
        return to_si(value, units[name])


def starts_of(spec: ScenarioSpec, units: Mapping[str, str], file: str) -> Starts:
    given = spec.starts
    box = dict(given.box)
    if given.every is not None:
        box = dict.fromkeys(units, given.every) | box
    return Starts(
        states=[
            {k: in_si(file, f"starts.states.{i}.{k}", v, units, k) for k, v in state.items()}
            for i, state in enumerate(given.states)
        ],
        random=given.random,
        active=[tuple(names) for names in given.active],
        box={
            k: (
                in_si(file, f"starts.box.{k}", low, units, k),
                in_si(file, f"starts.box.{k}", high, units, k),
            )
            for k, (low, high) in box.items()
        },
    )


def settings_of(
    spec: ScenarioSpec | FormationSpec, units: Mapping[str, str], file: str
) -> dict[str, Any]:
    run: RunSpec = spec.run
    times = dict.fromkeys(("horizon", "sample_time", "record_every", "delay"), "s")
    settings: dict[str, Any] = {
        n: in_si(file, f"run.{n}", getattr(run, n), times, n) for n in times
    }
    for name in (
        "substeps",
        "stepper",
        "absolute",
        "relative",
        "tolerance",
        "switch_limit",
        "until_goal",
        "device",
        "seed",
        "continuous",
    ):
        settings[name] = getattr(run, name)
    for kind in ("uniform", "normal"):
        settings[f"noise_{kind}"] = {
            k: in_si(file, f"noise.{kind}.{k}", v, units, k)
            for k, v in getattr(spec.noise, kind).items()
        }
    return settings
