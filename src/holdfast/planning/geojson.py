"""Reading cells from a GeoJSON file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from holdfast.errors import DefinitionError, ScenarioError
from holdfast.host.reading import read_small_text
from holdfast.planning.environment import Point

MOST = 100 * 2**20
"""The largest size of a map in bytes."""


def geojson_cells(path: str | Path) -> dict[str, list[Point]]:
    """{ name: corners } of the polygons of a GeoJSON file, named by their `name`, or id, or number.

    Coordinates are metres in a plane. Raises `DefinitionError` for a file that cannot be read, is
    not GeoJSON, or has anything but polygons without holes.
    """
    try:
        data = json.loads(read_small_text(path, MOST))
    except ScenarioError as error:
        raise DefinitionError(error.cause, expected=error.expected) from None
    except (ValueError, RecursionError):
        raise DefinitionError(f"{path} is not a JSON file") from None
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(features, list) or not features:
        raise DefinitionError(
            f"{path} is not a GeoJSON file of cells",
            expected='{"type": "FeatureCollection", "features": [...]}',
        )
    found: dict[str, list[Point]] = {}
    for number, feature in enumerate(features, start=1):
        name, corners = _geojson_cell(feature, number, path)
        if name in found:
            raise DefinitionError(f"{path}: two cells are called '{name}'")
        found[name] = corners
    return found


def _geojson_cell(feature: Any, number: int, path: str | Path) -> tuple[str, list[Point]]:
    if not isinstance(feature, dict):
        raise DefinitionError(f"{path}: feature {number} is {feature!r}")
    about = feature.get("properties")
    named = about.get("name") if isinstance(about, dict) else None
    name = str(named or feature.get("id", f"cell_{number}"))
    shape = feature.get("geometry")
    shape = shape if isinstance(shape, dict) else {}
    kind = shape.get("type")
    rings = shape.get("coordinates") if kind == "Polygon" else None
    if not isinstance(rings, list) or len(rings) != 1 or not isinstance(rings[0], list):
        raise DefinitionError(
            f"{path}: '{name}' is a {kind or 'feature without geometry'}",
            expected="a Polygon without holes",
        )
    ring = rings[0]
    if len(ring) > 1 and ring[0] == ring[-1]:
        ring = ring[:-1]
    return name, [tuple(c[:2]) if isinstance(c, list) else c for c in ring]
