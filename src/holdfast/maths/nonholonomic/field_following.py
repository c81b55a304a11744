"""The law that follows the reference field, where the uniform logic alone determines it.

One leaf direction g(t) in a plane, one transverse state t, no drift: then the misalignment
s between g and F is a scalar that t moves, and

    s = atan2(g x F, g . F)
    u = -k1 sgn(g . x) |x| / |g|             along g
    dt/dt = (-k s - ds/dx . g u) / (ds/dt)   hence sdot = -k s
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.maths.definitions.quantity import symbol
from holdfast.maths.definitions.system import System
from holdfast.maths.expressions.functions import angle, length, select, sgn, wrap
from holdfast.maths.expressions.random_points import value_at
from holdfast.maths.nonholonomic.null_space import signed_minors
from holdfast.maths.nonholonomic.structure import Structure
from holdfast.maths.reference_fields.dipole import UNSEEN

SPEED, SIDE = symbol("motion_along"), symbol("motion_across")


@dataclass(frozen=True)
class Alignment:
    """The pieces of the field-following law.

    direction: g on the leaf, with p . g(0) > 0. error: s. slope: ds/dt of the transverse
    state. turns: whether g can point every way; if not, s is known up to half a turn and the
    law is local. regular: whether ds/dt keeps its sign as the transverse state runs through its
    range; if not, the law divides by zero on the way and is local too.
    """

    direction: sp.ImmutableMatrix
    error: sp.Expr
    slope: sp.Expr
    turns: bool
    regular: bool

    @property
    def everywhere(self) -> bool:
        """Whether the law is valid everywhere except at x = 0."""
        return self.turns and self.regular


def alignment(found: Structure) -> Alignment | str:
    """The pieces of the law, or a sentence that names the missing one."""
    kappa, transverse = found.matrix.rows, found.transverse
    if not found.catastatic:
        shown = ", ".join(str(b) for b in found.rhs if b != 0)
        return (
            f"the constraint is acatastatic: b = {shown} moves the system across F for any "
            "inputs; a separate condition has to make b vanish at the origin"
        )
    if any(f != 0 for f in found.drift):
        return "the system drifts with its inputs at zero"
    if not transverse:
        return (
            f"the system has no transverse state: {kappa} equation{'s' * (kappa > 1)} h = 0 "
            f"for {len(found.directions)} inputs; which consistency errors to bring to zero first "
            "is a choice that A does not make (for the nonholonomic integrator x3, then x2)"
        )
    deficient = [
        i for i, h in enumerate(found.output) if not h.has(*(t.symbol for t in transverse))
    ]
    if deficient:
        numbers = ", ".join(f"h{i + 1}" for i in deficient)
        has = "contains" if len(deficient) == 1 else "contain"
        return (
            f"relative-degree deficit: {numbers} {has} no transverse state, so no input turns "
            "the system along F as it stands; alignment h -> 0 along F is not available"
        )
    if len(transverse) != kappa or len(found.leaf) != 2:
        return (
            f"{len(found.leaf)} leafwise and {len(transverse)} transverse states for {kappa} "
            "constraints: the misalignment with F is not a single angle (needed: 2, 1 and 1)"
        )
    g = signed_minors(found.leaf_matrix)
    sampler = found.sampler()
    at = sampler.origin(found.symbols)
    along = sp.Add(*(p * e for p, e in zip(found.moment, g, strict=True)))
    if not sampler.nonzero(along, at):
        return "the direction g(0) is normal to p, or not a number"
    g = sp.ImmutableMatrix(g * (1 if value_at(along, at) > 0 else -1))
    f = found.field
    error = angle(g[0] * f[1] - g[1] * f[0], g[0] * f[0] + g[1] * f[1], UNSEEN)
    t = transverse[0]
    # the turn of g itself: s = angle(F) - angle(g), and F does not contain t
    slope = -(g[0] * g[1].diff(t.symbol) - g[1] * g[0].diff(t.symbol)) / (g[0] ** 2 + g[1] ** 2)
    slope = sp.trigsimp(sp.simplify(slope))
    if sampler.vanishes(slope):
        return f"{t.name} does not turn the direction g: dh/dt is singular"
    if not sampler.nonzero(slope, at):
        return f"{t.name} does not turn the direction g at the origin: dh/dt is singular there"
    turned, regular = _range(found, g, slope)
    return Alignment(g, error, slope, abs(turned) > 2 * math.pi - 0.1, regular)


def _range(found: Structure, g: sp.Matrix, slope: sp.Expr) -> tuple[float, bool]:
    """The angle by which g turns over the range of the transverse state, at x = 0, and whether
    ds/dt keeps its sign on the way, there and at a few other x."""
    t, sampler = found.transverse[0], found.sampler()
    reach = [math.pi * i / 90 for i in range(-90, 91)] if t.angle else _wide()
    points = [sampler.origin(found.symbols), *(sampler.point(found.symbols, i) for i in (0, 1))]
    points = points if slope.free_symbols & {q.symbol for q in found.leaf} else points[:1]
    angles: list[float] = []
    slopes: list[float] = []
    for number, place in enumerate(points):
        for value in reach:
            at = place | {t.symbol: sp.Float(value)}
            slopes.append(float(value_at(slope, at)))
            x, y = (float(value_at(e, at)) for e in g)
            if number == 0 and math.hypot(x, y) > 0:
                angles.append(math.atan2(y, x))
    turned = math.fsum(math.remainder(b - a, 2 * math.pi) for a, b in pairwise(angles))
    return turned, all(v > 0 for v in slopes) or all(v < 0 for v in slopes)


def _wide() -> list[float]:
    grid = [10 ** (0.1 * i) for i in range(-30, 61)]
    return [-v for v in reversed(grid)] + [0.0, *grid]


def law_outputs(system: System, found: Structure, pieces: Alignment) -> dict[str, sp.Expr]:
    """The inputs of `system`, from the speed along g and the rate of the transverse state."""
    g, t = pieces.direction, found.transverse[0]
    x = [q.symbol for q in found.leaf]
    rho = length(x[0], x[1], UNSEEN)
    along = sp.Add(*(a * b for a, b in zip(g, x, strict=True)))
    size = sp.sqrt(sp.trigsimp(g[0] ** 2 + g[1] ** 2))
    forward = -symbol("k1") * sgn(along) * rho / size
    drift = sp.Add(*(pieces.error.diff(a) * b for a, b in zip(x, g, strict=True)))
    turn = (-symbol("k") * pieces.error - drift * forward) / pieces.slope
    outside = rho - symbol("freeze")
    chosen = {
        SPEED: select(outside, forward, sp.S.Zero),
        SIDE: select(outside, turn, -symbol("k") * (wrap(t.symbol) if t.angle else t.symbol)),
    }
    return {name: e.subs(chosen) for name, e in own_inputs(system, found, pieces).items()}


def own_inputs(system: System, found: Structure, pieces: Alignment) -> dict[str, sp.Expr]:
    """The inputs of `system` for the motions `SPEED` along g and `SIDE` of the transverse state."""
    if not found.kinematic:
        raise DefinitionError(
            f"the inputs of system '{system.name}' do not move its coordinates directly",
            remedy="use velocities as inputs (promote), and track them (track_velocity)",
        )
    rates = {found.transverse[0].name: SIDE}
    rates |= {q.name: e * SPEED for q, e in zip(found.leaf, pieces.direction, strict=True)}
    solved = found.speeds(sp.Matrix([rates[q.name] for q in found.coordinates]))
    return {
        u.name: sp.Add(*(sp.simplify(sp.expand(e).coeff(m)) * m for m in (SPEED, SIDE)))
        for u, e in zip(found.inputs, solved, strict=True)
    }
