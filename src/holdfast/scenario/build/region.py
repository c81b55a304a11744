"""[region]: its polygons; the amount of each inequality of a catalogue region that counts as 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from holdfast.errors import ScenarioError
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import to_si
from holdfast.scenario.schema.obstacles import ObstaclesSpec
from holdfast.scenario.validation import at, validated

if TYPE_CHECKING:
    from holdfast.scenario.build.composer import Composer


def scaled_region(file: str, region: Region, scales: object, key: str) -> Region:
    """The region with the scales of the table; `ScenarioError` for an unknown name or no number."""
    with at(file, f"{key}.scale"):
        if not isinstance(scales, Mapping):
            raise ScenarioError(
                f"got {scales!r}", expected='a table, such as { too_far = "10 cm" }'
            )
        found = {n: to_si(v, region.inequality(n).unit) for n, v in scales.items()}
        return region.with_scales(found) if found else region


def without_obstacles(table: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The table without the keys of `ObstaclesSpec`, and these."""
    placed = {n: v for n, v in table.items() if n in ObstaclesSpec.model_fields}
    if not {"obstacles", "room"} & set(placed):
        placed = {}
    return {n: v for n, v in table.items() if n not in placed}, placed


def obstacle_region(
    composer: Composer, system: System | None, table: Mapping[str, Any], key: str
) -> Region:
    """The region outside the polygons of the table, and in its room."""
    from holdfast.planning.obstacles import obstacles  # with geometry

    assert system is not None
    spec = validated(ObstaclesSpec, table, composer.file, key)

    def metres(corners: Sequence[Sequence[Any]]) -> list[list[float]]:
        return [[to_si(c, "m") for c in corner] for corner in corners]

    with at(composer.file, key):
        found: Region = obstacles(
            system,
            {name: metres(corners) for name, corners in spec.obstacles.items()},
            room=None if spec.room is None else metres(spec.room),
            clearance=to_si(spec.clearance, "m"),
            position=spec.position,
        )
    composer.declare(found.parameters)
    return found
