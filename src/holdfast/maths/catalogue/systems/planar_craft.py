"""The one model of every marine craft on the plane: inertia, Coriolis force, damping, actuators."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache

import sympy as sp

from holdfast.maths.definitions.actuator import Actuator, actuation
from holdfast.maths.definitions.bounds import Ball
from holdfast.maths.definitions.quantity import Parameter, Quantity, symbol
from holdfast.maths.definitions.system import PfaffianRow, System
from holdfast.maths.expressions.functions import magnitude

AXES = ("u", "v", "r")
STATES = (
    Quantity("x", "m", "position normal to the wall"),
    Quantity("y", "m", "position along the wall"),
    Quantity("psi", "rad", "heading", angle=True),
    Quantity("u", "m/s", "surge"),
    Quantity("v", "m/s", "sway"),
    Quantity("r", "rad/s", "yaw rate"),
)
CURRENT = (
    Quantity("Vx", "m/s", "current along x", role="current"),
    Quantity("Vy", "m/s", "current along y", role="current"),
)
DAMPING = {
    "u": ("Xu", "Xuu", "Xuuu"),
    "v": ("Yv", "Yvv", "Yvvv", "Yr", "Yrv", "Yvr", "Yrr", "Yuv", "Yur"),
    "r": ("Nr", "Nrr", "Nv", "Nvv", "Nrv", "Nvr", "Nuv", "Nur"),
}
"""Axis -> coefficients of its damping: of s (Xs), |a| b (Xab) and s^3 (Xsss)."""


def planar_craft(
    name: str,
    parameters: Iterable[Parameter],
    actuators: Sequence[Actuator],
    description: str,
    source: str,
    extra: Mapping[str, sp.Expr] | None = None,
) -> System:
    """M nudot + C(nu) nu + D(nu) nu = tau of nu = (u, v, r), relative to the water.

    Without a sway force of its own the craft has the Pfaffian row (5.15) of the thesis. A term
    whose parameter is absent is left out. extra: further forces [N, N m] on each axis.
    Raises `DefinitionError` for actuators that give no surge or no moment (`actuation`).
    """
    parameters = tuple(parameters)
    declared = {q.name for q in parameters}
    psi, u, v, r = (symbol(n) for n in ("psi", *AXES))
    vx, vy = (q.symbol for q in CURRENT)
    sin, cos = sp.sin(psi), sp.cos(psi)
    produced = actuation(actuators)
    inertia = inertia_matrix(declared)
    turning = coriolis_force(inertia)
    more = extra or {}
    force = [
        sp.Add(turning[i], *_damping(axis, declared), more.get(axis, 0), produced.force[i])
        for i, axis in enumerate(AXES)
    ]
    m22, m23, m32, m33 = inertia[1, 1], inertia[1, 2], inertia[2, 1], inertia[2, 2]
    regular = m22 * m33 - m23 * m32
    across = PfaffianRow({"x": -sin, "y": cos}, v - vx * sin + vy * cos)
    return System(
        name=name,
        states=STATES,
        inputs=produced.inputs,
        disturbances=CURRENT,
        rates={
            "x": u * cos - v * sin + vx,
            "y": u * sin + v * cos + vy,
            "psi": r,
            "u": force[0] / inertia[0, 0],
            "v": (m33 * force[1] - m23 * force[2]) / regular,
            "r": (m22 * force[2] - m32 * force[1]) / regular,
        },
        parameters=parameters,
        input_bounds=produced.bounds,
        disturbance_bounds=Ball(symbol("current_limit"), 2),
        pfaffian=() if produced.full else (across,),
        description=description,
        source=source,
    )


def inertia_matrix(declared: Iterable[str]) -> sp.Matrix:
    """M = M_RB + M_A of (u, v, r), with the cross terms whose parameters are known.

    M_RB = [[m, 0, 0], [0, m, m x_g], [0, m x_g, Iz]],
    M_A = -[[Xudot, 0, 0], [0, Yvdot, Yrdot], [0, Nvdot, Nrdot]]; Nvdot is Yrdot unless known.
    """
    names = set(declared)

    def value(name: str) -> sp.Expr:
        return symbol(name) if name in names else sp.S.Zero

    m, offset = symbol("mass"), value("mass") * value("x_g")
    sway_by_yaw = value("Yrdot")
    yaw_by_sway = value("Nvdot") if "Nvdot" in names else sway_by_yaw
    return sp.Matrix(
        [
            [m - symbol("Xudot"), 0, 0],
            [0, m - symbol("Yvdot"), offset - sway_by_yaw],
            [0, offset - yaw_by_sway, symbol("Iz") - symbol("Nrdot")],
        ]
    )


def coriolis_force(inertia: sp.Matrix) -> list[sp.Expr]:
    """-C(nu) nu, of the momenta p = dT/dnu with the kinetic energy T = nu^T M nu / 2.

        -C nu = (p_v r, -p_u r, p_u v - p_v u)

    Kirchhoff's equations on the plane; Fossen, Handbook of Marine Craft Hydrodynamics and Motion
    Control, C from M. Of an unsymmetric M the symmetric part counts, so that C does no work.
    """
    entries = {e: inertia[i, k] for (i, k), e in _entries().items()}
    nu = [symbol(n) for n in AXES]
    return [
        sp.Add(*(c.xreplace(entries) * sp.Mul(*map(sp.Pow, nu, powers)) for powers, c in terms))
        for terms in _coriolis_terms()
    ]


def _entries() -> dict[tuple[int, int], sp.Symbol]:
    """A symbol for each entry of M that is not zero by the symmetry of a hull."""
    return {(i, k): symbol(f"m{i + 1}{k + 1}") for i, k in ((0, 0), (1, 1), (1, 2), (2, 1), (2, 2))}


@cache
def _coriolis_terms() -> list[list[tuple[tuple[int, ...], sp.Expr]]]:
    """Of -C nu on every axis: (powers of u, v, r) and the coefficient, in the entries of M."""
    nu = sp.Matrix([symbol(n) for n in AXES])
    inertia = sp.zeros(3, 3)
    for place, entry in _entries().items():
        inertia[place] = entry
    energy = (nu.T * inertia * nu)[0] / 2
    along, across, _ = (sp.expand(energy.diff(n)) for n in nu)
    u, v, r = nu
    return [sp.Poly(f, *nu).terms() for f in (across * r, -along * r, along * v - across * u)]


def _damping(axis: str, declared: Iterable[str]) -> list[sp.Expr]:
    return [symbol(name) * _shape(name[1:]) for name in DAMPING[axis] if name in declared]


def _shape(suffix: str) -> sp.Expr:
    """u -> u, rv -> |r| v, uuu -> u^3"""
    first, last = symbol(suffix[0]), symbol(suffix[-1])
    if len(suffix) == 1:
        return first
    return magnitude(first) * last if len(suffix) == 2 else first**3
