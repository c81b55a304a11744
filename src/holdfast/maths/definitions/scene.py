"""Shapes of a region in the plane, as data; `presentation` draws them."""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp


@dataclass(frozen=True)
class Segment:
    """A fixed line from start to end, e.g. a wall or a target on it."""

    role: str
    start: tuple[sp.Expr, sp.Expr]
    end: tuple[sp.Expr, sp.Expr]


@dataclass(frozen=True)
class Cone:
    """A field of view: apex, heading, half angle and range, expressions of the state."""

    role: str
    apex: tuple[sp.Expr, sp.Expr]
    heading: sp.Expr
    half_angle: sp.Expr
    range: sp.Expr


@dataclass(frozen=True)
class Footprint:
    """A sensor's footprint: a polygon with corners (ahead, left) of the apex, turned by heading."""

    role: str
    apex: tuple[sp.Expr, sp.Expr]
    heading: sp.Expr
    corners: tuple[tuple[sp.Expr, sp.Expr], ...]


@dataclass(frozen=True)
class Circle:
    """A fixed circle, e.g. an obstacle or a set of goals."""

    role: str
    centre: tuple[sp.Expr, sp.Expr]
    radius: sp.Expr


Shape = Segment | Cone | Footprint | Circle
