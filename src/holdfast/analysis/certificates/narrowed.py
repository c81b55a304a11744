"""A certificate of what is harder, stated for what is easier: room for another arithmetic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from holdfast.analysis.certificates.certificate import Certificate, Range
from holdfast.errors import SimulationError
from holdfast.maths.expressions.traversal import symbols_of


def narrowed(found: Certificate, ranges: Mapping[str, Range]) -> Certificate:
    """The same cells and inputs for ranges that lie within those of the certificate.

    What is proved for every number of a range is proved for fewer. A parameter that no rate has and
    that only tightens constraints (dc/dp >= 0, a number) may also be lower: c(p) <= 0 implies
    c(p') <= 0 for p' <= p. The checker, whose balls are wider than the intervals of `certify`, then
    has room. Raises `SimulationError` for other ranges.
    """
    for name, (low, high) in ranges.items():
        if name not in found.ranges:
            raise SimulationError(f"'{name}' is no number of the certificate")
        least, most = found.ranges[name]
        within = least <= low and high <= most
        if not within and not (high <= least and _tightens(found, name)):
            raise SimulationError(
                f"{name} from {low:g} to {high:g} is not implied by {least:g} to {most:g}",
                expected="ranges within those of the certificate",
            )
    return replace(found, ranges={**found.ranges, **ranges})


def _tightens(found: Certificate, name: str) -> bool:
    """Whether a larger number only makes constraints harder."""
    constraints = [c for _, _, c in (*found.constraints, *found.target)]
    named = [s for s in symbols_of([*found.rates, *constraints]) if s.name == name]
    if any(s in symbols_of(found.rates) for s in named):
        return False
    slopes = [c.diff(s) for c in constraints for s in named]
    return all(slope.is_number and slope.is_nonnegative for slope in slopes)
