"""[region.scale]: the amount of each inequality of a catalogue region that counts as 1."""

from __future__ import annotations

from collections.abc import Mapping

from holdfast.errors import ScenarioError
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.units import to_si
from holdfast.scenario.validation import at


def scaled_region(file: str, region: Region, scales: object, key: str) -> Region:
    """The region with the scales of the table; `ScenarioError` for an unknown name or no number."""
    with at(file, f"{key}.scale"):
        if not isinstance(scales, Mapping):
            raise ScenarioError(
                f"got {scales!r}", expected='a table, such as { too_far = "10 cm" }'
            )
        found = {n: to_si(v, region.inequality(n).unit) for n, v in scales.items()}
        return region.with_scales(found) if found else region
