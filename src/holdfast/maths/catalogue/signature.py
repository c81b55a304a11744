"""Signatures of the catalogue's functions: their leading arguments and their parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from holdfast.errors import DefinitionError, HoldfastError
from holdfast.maths.catalogue import fields, laws, regions, systems
from holdfast.maths.control.velocity_tracking import track_velocity
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.vehicle_file import declared_parameters

CATALOGUES: dict[str, tuple[Callable[..., Any], ...]] = {
    "system": systems.ALL,
    "law": laws.ALL,
    "region": regions.ALL,
    "field": fields.ALL,
}
FULLY_ACTUATED = "cybership_ii_full"
"""A vehicle for laws that choose the sway force."""


def example(function: Callable[..., Any]) -> Any:
    """The catalogue entry with its standard parameters.

    A law is built on the first system of the catalogue that fits it, or on a craft with a sway
    force.
    """
    if leading_argument(function) == "law":
        return function(laws.steer_marine(systems.marine_vehicle()))
    if leading_argument(function) != "system":
        return function()
    refusal: HoldfastError | None = None
    for system in (*systems.ALL, partial(systems.marine_craft, FULLY_ACTUATED)):
        try:
            return function(system())
        except DefinitionError as error:
            refusal = refusal or error
    raise refusal or DefinitionError(f"'{function.__name__}' fits no system of the catalogue")


def leading_argument(function: Callable[..., Any]) -> str:
    """The leading arguments of a catalogue function: "system", "law", or a parameter's name."""
    return next(iter(inspect.signature(function).parameters), "")


def wants_law(function: Callable[..., Any]) -> bool:
    """Whether a catalogue law is built on a convergent law, not on the system alone."""
    return leading_argument(function) == "law"


def arguments(function: Callable[..., Any], leading: int) -> tuple[list[str], list[str]]:
    """The arguments after the first `leading` ones: those that are not numbers, and the numbers."""
    named = list(inspect.signature(function).parameters.values())[leading:]
    named = [a for a in named if a.kind is not a.VAR_KEYWORD]
    numeric = [a.name for a in named if a.annotation in ("float", "float | None")]
    structural = [a.name for a in named if a.name not in numeric]
    return structural, [*numeric, *(declared_parameters(function) or ())]


def accepted_parameters(function: Callable[..., Any], parameters: Mapping[str, Any]) -> list[str]:
    """The names of the parameters a catalogue function takes.

    Its numeric keyword arguments; if it takes any keyword, all `parameters` of its result.
    """
    signature = inspect.signature(function).parameters.values()
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in signature):
        return list(parameters)
    return [p.name for p in signature if p.name in parameters]


def is_made_for(function: Callable[..., Any], system: System) -> bool:
    """Whether the law can be built and gives inputs, or velocities for the inputs to track."""
    if leading_argument(function) != "system":
        return False
    try:
        law = function(system)
        outputs = set(law.output_names)
        if outputs == set(system.input_names):
            return True
        if not (outputs <= set(system.state_names) and len(outputs) <= len(system.inputs)):
            return False
        track_velocity(system, law, dict.fromkeys(outputs, 1.0))
    except DefinitionError:
        return False
    return True
