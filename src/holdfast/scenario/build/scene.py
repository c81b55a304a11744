"""[[region.scene]]: the shapes that figures draw, from tables."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from typing import Any

import sympy as sp

from holdfast.errors import ScenarioError
from holdfast.maths.definitions import scene
from holdfast.maths.expressions.parser import parse_expression
from holdfast.scenario.schema.closed_loop import ShapeSpec
from holdfast.scenario.validation import at

SHAPES: dict[str, tuple[Callable[..., scene.Shape], tuple[str, ...]]] = {
    "segment": (scene.Segment, ("start", "end")),
    "circle": (scene.Circle, ("centre", "radius")),
    "cone": (scene.Cone, ("apex", "heading", "half_angle", "range")),
    "footprint": (scene.Footprint, ("apex", "heading", "corners")),
}
MOVING = ("cone", "footprint")
"""Shapes that move with a vehicle; all others are stationary and depend on no state."""


def composed_shape(
    file: str, key: str, spec: ShapeSpec, names: Mapping[str, sp.Expr], known: Container[str]
) -> scene.Shape:
    """The shape of one table; `known` are the names that are constant during a run."""
    if spec.kind not in MOVING:
        names = {n: e for n, e in names.items() if n in known or n == "pi"}

    def parsed(given: Any) -> Any:
        if isinstance(given, tuple | list):
            return tuple(parsed(g) for g in given)
        return parse_expression(given, names)

    shape, parts = SHAPES[spec.kind]
    values = []
    for part in parts:
        given = getattr(spec, part)
        if given is None:
            raise ScenarioError(f"{file}: {key}: a {spec.kind} needs '{part}'")
        with at(file, f"{key}.{part}"):
            values.append(parsed(given))
    return shape(spec.role, *values)
