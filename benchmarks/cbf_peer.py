"""A peer: cbfpy (D. Morton, MIT), a library of control barrier functions on JAX, from our system.

    pip install cbfpy

Its user writes f, g and the barriers h in JAX. Here they are made from the same expressions, with
the same gains, so that the two filters answer the same question.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import sympy as sp

import holdfast as hf


def cbf_filter(
    system: hf.System,
    region: hf.Region,
    gains: tuple[float, float],
    low: Any,
    high: Any,
    margins: Mapping[str, float],
) -> Callable[[Any, Any], np.ndarray]:
    """filter(state, command) -> input, within the box from low to high."""
    import jax
    import jax.numpy as jnp
    from cbfpy import CBF, CBFConfig

    jax.config.update("jax_enable_x64", True)
    own_functions = {
        "wrap": lambda x: jnp.arctan2(jnp.sin(x), jnp.cos(x)),
        "angle": lambda y, x, guard: jnp.arctan2(y, x),
        "length": lambda x, y, guard: jnp.hypot(x, y),
        "least": jnp.minimum, "greatest": jnp.maximum, "magnitude": jnp.abs, "sgn": jnp.sign,
        "select": lambda x, a, b: jnp.where(x >= 0, a, b),
    }  # fmt: skip
    own_functions["nearest_face"] = nearest_face
    modules = [own_functions, "jax"]
    states = [q.symbol for q in system.states]
    inputs = [q.symbol for q in system.inputs]
    values = {p.symbol: sp.Float(p.value) for p in (*system.parameters, *region.parameters)}
    still = {q.symbol: sp.S.Zero for q in system.disturbances}
    rates = [sp.sympify(system.rates[n]).xreplace(still | values) for n in system.state_names]
    none = dict.fromkeys(inputs, sp.S.Zero)
    drift = sp.lambdify([states], [e.xreplace(none) for e in rates], modules=modules)
    effect = sp.lambdify([states], [[e.diff(u) for u in inputs] for e in rates], modules=modules)
    orders = {c.name: c.relative_degree for c in hf.viability_conditions(system, region)}
    own = {
        order: [
            -c.expression.xreplace(values) - margins.get(c.name, 0.0)
            for c in region.inequalities
            if orders[c.name] == order
        ]
        for order in (1, 2)
    }
    barriers = {k: sp.lambdify([states], e, modules=modules) for k, e in own.items()}

    class Config(CBFConfig):
        def f(self, z: Any) -> Any:
            return jnp.array(drift(z), dtype=float)

        def g(self, z: Any) -> Any:
            return jnp.array(effect(z), dtype=float)

        def h_1(self, z: Any) -> Any:
            return jnp.array(barriers[1](z), dtype=float) if own[1] else jnp.array([])

        def h_2(self, z: Any) -> Any:
            return jnp.array(barriers[2](z), dtype=float) if own[2] else jnp.array([])

        def alpha(self, h: Any) -> Any:
            return gains[0] * h

        def alpha_2(self, h_2: Any) -> Any:
            return gains[1] * h_2

        def P(self, z: Any, u_des: Any) -> Any:  # noqa: N802
            size = (np.asarray(high) - np.asarray(low)) / 2
            return jnp.diag(jnp.array(1 / size**2))

        def q(self, z: Any, u_des: Any) -> Any:
            size = (np.asarray(high) - np.asarray(low)) / 2
            return -jnp.array(1 / size**2) * u_des

    made = CBF.from_config(Config(len(states), len(inputs), low, high))
    decide = jax.jit(made.safety_filter)
    return lambda state, command: np.asarray(decide(jnp.asarray(state), jnp.asarray(command)))


def nearest_face(k: int, x: Any, y: Any, *ends: Any) -> Any:
    """The nearest side or corner of convex polygons, as `holdfast` numbers what is asked of it."""
    import jax
    import jax.numpy as jnp

    px, py, qx, qy = jnp.array(ends, dtype=float).reshape(-1, 4).T
    dx, dy = qx - px, qy - py
    size = jnp.hypot(dx, dy)
    along = ((x - px) * dx + (y - py) * dy) / size**2
    share = jnp.clip(along, 0.0, 1.0)
    nx, ny = dy / size, -dx / size
    cx, cy = px + share * dx, py + share * dy
    off = jnp.hypot(x - cx, y - cy)
    depth = (x - px) * nx + (y - py) * ny
    # at a corner two sides are as near: the one that the point is farther out of decides
    nearest = jnp.argmin(off - 1e-9 * jnp.abs(depth))
    inside = depth[nearest] < 0
    at_side = (along[nearest] > 0) & (along[nearest] < 1)
    found = [
        jnp.where(at_side, 1.0, -1.0), jnp.where(inside, -1.0, 1.0),
        cx[nearest], cy[nearest], nx[nearest], ny[nearest],
    ]  # fmt: skip
    return jax.lax.stop_gradient(found[k])
