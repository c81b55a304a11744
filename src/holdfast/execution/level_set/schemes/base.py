"""The description of a scheme. Its file is read, not imported: Numba waits until it is used."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Scheme:
    """One-sided derivatives along an axis.

    ghosts: nodes that they reach on either side. order: of the Runge-Kutta method that goes with
    them. one_slope: both ends of an interval have the same slope, as at first order. monotone: with
    a method of first order a step keeps the order of two values.
    """

    name: str
    ghosts: int
    order: int
    one_slope: bool = False
    monotone: bool = False


def scheme_of(name: str) -> Scheme:
    """The `SCHEME = {...}` of the file of that name."""
    tree = ast.parse((Path(__file__).parent / f"{name}.py").read_text("utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "SCHEME":
            return Scheme(name, **ast.literal_eval(node.value))
    raise ValueError(f"{name}.py has no SCHEME = {{...}}")
