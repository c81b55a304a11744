"""[law] certificate: the inputs of a certificate, whose file `holdfast certify` wrote."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sympy as sp

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.certified_law import certified_law
from holdfast.analysis.certificates.reading import read_certificate
from holdfast.errors import ScenarioError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact
from holdfast.scenario.schema.values import Section, Text
from holdfast.scenario.validation import validated


class CertificateSpec(Section):
    """[law] of a certificate: in every cell the input that keeps it.

    certificate: its file.
    """

    certificate: Text
    description: Text = ""


def law_of_certificate(
    file: str, table: Mapping[str, Any], system: System, region: Region | None
) -> Law:
    """The law of the certificate that [law] names, for this system and region.

    Raises `ScenarioError` for a region with an inequality that is not certified.
    """
    found = read_certificate(validated(CertificateSpec, dict(table), file, "law").certificate)
    if region is not None:
        _check_region(found, region)
    return certified_law(found, system)


def _check_region(certificate: Certificate, region: Region) -> None:
    certified = [exact(e) for _, _, e in certificate.constraints]
    for c in region.inequalities:
        if not any(sp.expand(exact(c.expression) - e) == 0 for e in certified):
            raise ScenarioError(
                f"'{c.name}' of region '{region.name}' is not certified",
                expected="a region with the inequalities of the certificate: "
                + ", ".join(name for name, _, _ in certificate.constraints),
            )
    for p in region.parameters:
        low, high = certificate.ranges.get(p.name, (p.value, p.value))
        if not low <= p.value <= high:
            raise ScenarioError(
                f"{p.name} of region '{region.name}' is {p.value:g}",
                expected=f"{low:g} to {high:g}, for which it is certified",
            )
