"""[system] flat_output of a file: the flat output (z1, zn) of a system written by expressions."""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp

from holdfast.maths.definitions.flat_output import FlatOutput
from holdfast.maths.expressions.parser import parse_expression
from holdfast.scenario.schema.values import FlatOutputSpec
from holdfast.scenario.validation import at


def flat_output(
    file: str, spec: FlatOutputSpec | None, names: Mapping[str, sp.Expr]
) -> FlatOutput | None:
    """The flat output, or None if the file declares none."""
    if spec is None:
        return None
    found = []
    texts = {"first": spec.first} | {f"last.{i}": text for i, text in enumerate(spec.last)}
    for key, text in texts.items():
        with at(file, f"system.flat_output.{key}"):
            found.append(parse_expression(text, dict(names)))
    with at(file, "system.flat_output"):
        return FlatOutput(found[0], tuple(found[1:]))
