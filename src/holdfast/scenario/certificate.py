"""[law] certificate: the inputs of a certificate, whose file `holdfast certify` wrote."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import sympy as sp
from pydantic import Field

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.certified_law import certified_law
from holdfast.analysis.certificates.reading import read_certificate
from holdfast.errors import ScenarioError
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Inequality, Region
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.traversal import exact
from holdfast.scenario.schema.values import Section, Text, validated


class CertificateSpec(Section):
    """[law] of a certificate: in every cell the input that keeps it.

    certificate: its file. check: the share of its entries that the checker reads, all by default.
    """

    certificate: Text
    check: float = Field(1.0, ge=0, le=1)
    description: Text = ""


def law_of_certificate(
    file: str,
    table: Mapping[str, Any],
    system: System,
    region: Region | None,
    goal: Region | None,
    disturbance: Mapping[str, float],
) -> Law:
    """The law of the certificate that [law] names, for this system, region, goal and disturbance.

    Raises `ScenarioError` for a region with an inequality that is not certified, and for a goal
    with one that need not hold at the target of the certificate.
    """
    spec = validated(CertificateSpec, dict(table), file, "law")
    certificate = read_certificate(spec.certificate, check=spec.check)
    if region is not None:
        check_region(certificate, region)
    if goal is not None and certificate.target:
        check_goal(certificate, goal)
    return certified_law(certificate, system, disturbance=disturbance)


def check_region(certificate: Certificate, region: Region) -> None:
    """Raises `ScenarioError` for a region with an inequality that is not certified."""
    for c in region.inequalities:
        if not _among(c, certificate.constraints):
            raise ScenarioError(
                f"'{c.name}' of region '{region.name}' is not certified",
                expected="a region with the inequalities of the certificate: "
                + ", ".join(name for name, _, _ in certificate.constraints),
            )
    _check_parameters(certificate, region, "region")


def check_goal(certificate: Certificate, goal: Region) -> None:
    """Raises `ScenarioError` for a goal with one that need not hold at the target."""
    for c in goal.inequalities:
        if not _among(c, (*certificate.target, *certificate.constraints)):
            raise ScenarioError(
                f"'{c.name}' of the goal is not what the certificate leads to",
                expected="a goal with the inequalities of its target: "
                + ", ".join(name for name, _, _ in certificate.target),
            )
    _check_parameters(certificate, goal, "goal")


def _among(c: Inequality, certified: Iterable[tuple[str, str, sp.Expr]]) -> bool:
    return any(sp.expand(exact(c.expression) - exact(e)) == 0 for _, _, e in certified)


def _check_parameters(certificate: Certificate, region: Region, what: str) -> None:
    for p in region.parameters:
        low, high = certificate.ranges.get(p.name, (p.value, p.value))
        if not low <= p.value <= high:
            raise ScenarioError(
                f"{p.name} of {what} '{region.name}' is {p.value:g}",
                expected=f"{low:g} to {high:g}, for which it is certified",
            )
