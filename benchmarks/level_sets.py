"""Sets that holdfast and hj_reachability both march to, and how the second does it.

Each problem is posed once, for holdfast. The peer gets the same grid, the same margin at every
node, and the rates of the same system printed for JAX; of two aircraft it has its own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any
from unittest.mock import patch

import numpy as np
import sympy as sp
from task import array_functions

import holdfast as hf
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.problem import Posed, with_disturbance
from holdfast.analysis.reachability.solve import set_on_grid
from holdfast.execution.level_set.march import METHODS

Array = np.ndarray

NEVER = 1e-300
"""A change per second that is none: no march ends early."""

ACCURACY = {"upwind": "low", "weno5": "very_high"}
"""What hj_reachability calls the schemes that both have, with Runge-Kutta of order 1 and 3."""

OURS = {"upwind": METHODS[1], "weno5": METHODS[3]}
"""Our Runge-Kutta methods of these orders."""


@dataclass(frozen=True)
class LevelSet:
    """The set that `find` gives for `region`, after so many steps of equal length.

    Both take steps of 0.75 of what is stable, ours with WENO5 twice that for its method of four
    stages; after whole ones they are at the same time. grows: whether the set does so, as a
    reachable set of the reversed rates.
    """

    name: str
    find: Callable[..., hf.ValueFunction]
    system: hf.System
    region: hf.Region
    grid: Grid
    steps: int
    grows: bool = False

    @property
    def hamiltonian(self) -> hf.Hamiltonian:
        return hf.hamiltonian(self.system, disturbances="max" if self.grows else "min")

    @cached_property
    def final(self) -> float:
        """The time [s] after the steps."""
        axes = self.grid.axes
        numbers = {q.symbol: q.value for q in self.system.parameters}
        of = sum(v / a.step for v, a in zip(self.hamiltonian.speeds, axes, strict=True))
        states = [q.symbol for q in self.system.states]
        fastest = sp.lambdify(states, of.subs(numbers), [array_functions(np), "numpy"])
        return self.steps * 0.75 / np.max(fastest(*np.ix_(*(a.nodes for a in axes))))

    def march(
        self, scheme: str, *, alone: bool = True, **options: Any
    ) -> tuple[Array, dict[str, Any]]:
        """The values, and what is said of the march.

        The peer calls the local dissipation global, and goes to the end whatever happens.
        alone: without the other march that holds a set to what is safe (`docs/kernels.md`), which
        the peer does not have.
        """
        options = {"dissipation": "local", "tolerance": NEVER} | options
        find = partial(self.find, self.system, self.region, self.grid, self.final)
        with patch.object(Posed, "marched_twice", False) if alone else nullcontext():
            value = find(scheme=scheme, **options)
        return value.values(), value.dataset.attrs

    @property
    def margin(self) -> Array:
        """That of the region at every node, which both begin with."""
        return set_on_grid(self.region, self.grid).values()

    @property
    def rates(self) -> sp.Matrix:
        """With numbers for the parameters, in reverse where the set grows."""
        numbers = {q.symbol: q.value for q in self.system.parameters}
        rates = sp.Matrix(list(self.system.rates.values())).subs(numbers)
        return -rates if self.grows else rates

    @property
    def operations(self) -> int:
        """Of H and its dissipation at a node; what depends on the axes alone can be in tables."""
        h, states = self.hamiltonian, {q.symbol for q in self.system.states}
        gaps = sp.symbols(f"g:{len(states)}")
        total = h.value + sum(a * g for a, g in zip(h.speeds, gaps, strict=True))
        tables = {e: sp.Dummy() for e in total.atoms(sp.Function) if e.free_symbols <= states}
        shared, left = sp.cse(total.xreplace(tables))
        return int(sum(sp.count_ops(e) for e in [*(e for _, e in shared), *left]))


def aircraft(nodes: tuple[int, ...], steps: int) -> LevelSet:
    """Pursuit and evasion of two aircraft (I. Mitchell's air3D), from 5 apart."""
    x, y, psi, turn, other = (hf.symbol(n) for n in ("x", "y", "psi", "a", "b"))
    states = (
        hf.Quantity("x", "1"), hf.Quantity("y", "1"), hf.Quantity("psi", "rad", angle=True)
    )  # fmt: skip
    system = hf.System(
        "aircraft", states, (hf.Quantity("a", "1"),),
        {
            "x": -5 + 5 * sp.cos(psi) + turn * y,
            "y": 5 * sp.sin(psi) - turn * x,
            "psi": other - turn,
        },
        disturbances=(hf.Quantity("b", "1"),),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-1,), (1,)),
        empirical="numbers",
    )  # fmt: skip
    apart = hf.Region(
        "apart",
        states[:2],
        (hf.Inequality("near", 5 - sp.sqrt(x**2 + y**2)),),
        empirical="numbers",
    )
    box = {"x": (-6, 20), "y": (-10, 10), "psi": (0, 2 * math.pi)}
    grid = hf.grid(
        system, box, dict(zip(box, nodes, strict=True)), {"x": "extrapolated", "y": "extrapolated"}
    )
    return LevelSet("aircraft", hf.discriminating_kernel, system, apart, grid, steps)


def game(nodes: int, steps: int) -> LevelSet:
    """(7.4) of the thesis: camera and lasers, |v| <= 0.4 m/s, 0.5 m/s across the view."""
    vehicle, inputs = hf.systems.marine_vehicle(), ("u", "r")
    system = hf.promote(
        vehicle, inputs, hf.steady_bounds(vehicle, inputs),
        disturbances=("v",), disturbance_bounds=hf.Box((-0.4,), (0.4,)),
    )  # fmt: skip
    box = {"x": (-2.6, 0.2), "y": (-2, 2), "psi": (-math.pi / 2, math.pi / 2)}
    grid = hf.grid(system, box, nodes, {"psi": "contained"})
    across = with_disturbance(system, {"Vx": 0.0, "Vy": 0.5})
    region = hf.regions.camera_and_lasers()
    return LevelSet("game (7.4)", hf.discriminating_kernel, across, region, grid, steps)


def reach(nodes: int, steps: int) -> LevelSet:
    """(7.5) of the thesis, with (7.2) as it is printed: the velocities within reach."""
    said = hf.load_scenario("ch7-forward-reach-printed", [f"grid.nodes={nodes}"])
    along = with_disturbance(said.system, {"Vx": 0.0, "Vy": 0.5})
    find = hf.forward_reachable_set
    return LevelSet("reach (7.5)", find, along, said.origin, said.grid, steps, grows=True)


class Peer:
    """hj_reachability on the same problem, with what it ships, or with `slopes` of ours."""

    def __init__(self, problem: LevelSet, scheme: str, slopes: Any = None) -> None:
        import hj_reachability as hj
        import jax.numpy as jnp

        axes = problem.grid.axes
        box = hj.sets.Box(jnp.array([a.low for a in axes]), jnp.array([a.high for a in axes]))
        periodic = tuple(i for i, a in enumerate(axes) if a.ends == "periodic")
        make = hj.Grid.from_lattice_parameters_and_boundary_conditions
        limit = jnp.maximum if problem.grows else jnp.minimum
        self.hj, self.final = hj, problem.final
        self.grid = make(box, problem.grid.shape, periodic_dims=periodic)
        self.start = jnp.asarray(problem.margin)
        self.settings = hj.SolverSettings.with_accuracy(
            ACCURACY[scheme], hamiltonian_postprocessor=lambda x: limit(x, 0)
        )
        if slopes is not None:
            self.settings = self.settings.replace(
                upwind_scheme=slopes, time_integrator=four_stages, CFL_number=0.75
            )
        own = problem.name == "aircraft"
        self.dynamics = hj.systems.Air3d() if own else dynamics_of(problem)

    def march(self) -> tuple[Array, float]:
        """The values, and the seconds it took."""
        began = time.perf_counter()
        values = self.hj.step(
            self.settings, self.dynamics, self.grid, 0.0, self.start, -self.final,
            progress_bar=False,
        ).block_until_ready()  # fmt: skip
        return np.asarray(values), time.perf_counter() - began


def four_stages(
    settings: Any, dynamics: Any, grid: Any, time: Any, values: Any, target: Any
) -> tuple[Any, Any]:
    """Our method of third order, as hj_reachability asks for one."""
    import jax.numpy as jnp
    from hj_reachability.time_integration import euler_step

    weights = [weight for weight, _ in OURS["weno5"].stages]
    middle, new = euler_step(
        settings, dynamics, grid, time, values, max_time_step=(target - time) / 2
    )
    half = middle - time
    for weight, at in zip(weights[1:], (middle, middle + half, middle), strict=True):
        _, euler = euler_step(settings, dynamics, grid, at, new, half)
        new = (1 - weight) * values + weight * euler
    end = middle + half
    end = jnp.where(jnp.abs(target - end) < 1e-4 * jnp.abs(half), target, end)  # a rounding
    return end, settings.value_postprocessor(end, new)


def limited_weno5(values: Any, spacing: Any, boundary_condition: Any) -> tuple[Any, Any]:
    """The two slopes of docs/kernels.md along a line, as hj_reachability asks for a scheme.

    G.-S. Jiang, D. Peng (2000), its small number a millionth of the three smoothnesses and of a
    quarter of the plain difference squared; with the sign of this and at most twice its size.
    """
    import jax.numpy as jnp

    line = boundary_condition(values, 3)
    d, n = (line[1:] - line[:-1]) / spacing, len(values)

    def side(a: Any, b: Any, c: Any, d: Any, e: Any) -> Any:
        rough = (
            13 / 12 * (a - 2 * b + c) ** 2 + (a - 4 * b + 3 * c) ** 2 / 4,
            13 / 12 * (b - 2 * c + d) ** 2 + (b - d) ** 2 / 4,
            13 / 12 * (c - 2 * d + e) ** 2 + (3 * c - 4 * d + e) ** 2 / 4,
        )
        small = 1e-6 * (sum(rough) + c**2 / 4 + 2.5e-31)
        weights = [k / (r + small) ** 2 for k, r in zip((0.1, 0.6, 0.3), rough, strict=True)]
        of = (2 * a - 7 * b + 11 * c, -b + 5 * c + 2 * d, 2 * c + 5 * d - e)
        slope = sum(w * s for w, s in zip(weights, of, strict=True)) / (6 * sum(weights))
        most = 2 * jnp.abs(c)
        return jnp.where(slope * c > 0, jnp.clip(slope, -most, most), 0.0)

    return side(*(d[k : k + n] for k in range(5))), side(*(d[5 - k : 5 - k + n] for k in range(5)))


def dynamics_of(problem: LevelSet) -> Any:
    """The rates, affine in what two players choose, as hj_reachability asks for them."""
    import hj_reachability as hj
    import jax.numpy as jnp

    system, rates = problem.system, problem.rates
    numbers = {q.symbol: q.value for q in system.parameters}
    players = [q.symbol for q in (*system.inputs, *system.disturbances)]
    tables, spaces = [rates.subs(dict.fromkeys(players, 0))], []
    for members, bounds in (
        (system.inputs, system.input_bounds),
        (system.disturbances, system.disturbance_bounds or hf.Box((0,), (0,))),
    ):
        gain = rates.jacobian([q.symbol for q in members]) if members else sp.zeros(len(rates), 1)
        chosen = bounds.at(numbers)
        if isinstance(chosen, hf.LinearImage):  # of what the actuators choose
            gain, chosen = gain * chosen.matrix, chosen.of
        tables.append(gain)
        sides = (chosen.lower, chosen.upper)
        spaces.append(hj.sets.Box(*(jnp.array([float(e) for e in side]) for side in sides)))
    states = [q.symbol for q in system.states]
    own = [array_functions(jnp), "jax"]
    drift, control, disturbance = (
        sp.lambdify(states, e.tolist(), modules=own, cse=True) for e in tables
    )

    class Derived(hj.dynamics.ControlAndDisturbanceAffineDynamics):
        def open_loop_dynamics(self, state: Any, time: Any) -> Any:
            return jnp.array(drift(*state))[:, 0]

        def control_jacobian(self, state: Any, time: Any) -> Any:
            return jnp.array(control(*state))

        def disturbance_jacobian(self, state: Any, time: Any) -> Any:
            return jnp.array(disturbance(*state))

    return Derived("max", "max" if problem.grows else "min", *spaces)
