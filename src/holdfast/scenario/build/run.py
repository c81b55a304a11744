"""[starts], [run] and [noise]: where a closed loop begins and how it is simulated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from holdfast.analysis.simulation.starts import Starts
from holdfast.errors import ScenarioError, suggestion
from holdfast.maths.definitions.units import to_si
from holdfast.scenario.schema.closed_loop import ScenarioSpec
from holdfast.scenario.schema.formation import FormationSpec
from holdfast.scenario.schema.run import RunSpec
from holdfast.scenario.validation import at


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
