"""The other ways to simulate the same closed loop: scipy, diffrax and hand-written JAX.

Two layouts of the states are tried. Vectors: each run carries an array of six, the natural
way to write it, and `vmap` batches the runs. Columns: six arrays with an entry per run, which
XLA turns into one loop of vector instructions.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, ClassVar

import numpy as np
from task import (
    SAMPLE_TIME,
    SCALAR_FUNCTIONS,
    Array,
    Columns,
    Contender,
    Task,
    Timed,
    array_functions,
    closed_loop,
    final_states,
    starts_of,
)


class Jax:
    """JAX set up for float64 with one host device per core, and the loop printed for it."""

    def __init__(self, task: Task) -> None:
        import jax
        from jax.sharding import NamedSharding, PartitionSpec

        cores = len(os.sched_getaffinity(0))
        self.task = task
        self.devices = cores if task.runs % cores == 0 else 1
        jax.config.update("jax_enable_x64", True)
        jax.config.update("jax_platforms", "cpu")
        jax.config.update("jax_num_cpu_devices", self.devices)
        self.control, self.rates = closed_loop(array_functions(jax.numpy), "jax")
        mesh = jax.make_mesh((self.devices,), ("runs",))
        self.spread = NamedSharding(mesh, PartitionSpec("runs"))
        self.vectors = (jax.numpy.asarray(starts_of(task)),)
        self.columns = tuple(jax.numpy.asarray(c) for c in starts_of(task).T)

    def contender(
        self,
        name: str,
        held: bool,
        function: Callable[..., Any],
        layout: str,
        tolerance: float = 1e-9,
    ) -> Contender:
        """The function jitted and compiled ahead for 'vectors', 'columns' or 'devices'."""
        import jax

        arguments: tuple[Any, ...] = self.vectors if layout == "vectors" else self.columns
        if layout == "devices":
            arguments = tuple(jax.device_put(c, self.spread) for c in arguments)
            mesh, spec = self.spread.mesh, self.spread.spec
            function = jax.shard_map(
                function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False
            )
            layout = f"columns, {self.devices} device" + "s" * (self.devices > 1)
        jitted = jax.jit(function)
        compiled: list[Callable[..., Any]] = []

        def run() -> Timed:
            began = time.perf_counter()
            final = jax.block_until_ready(compiled[0](*arguments))
            seconds = time.perf_counter() - began
            return seconds, np.asarray(final) if layout == "vectors" else np.stack(final, axis=-1)

        return Contender(
            f"{name}, {layout}", "held" if held else "continuous", run,
            partial(final_states, self.task, not held), tolerance, self.task.runs,
            prepare=lambda: compiled.append(jitted.lower(*arguments).compile()),
        )  # fmt: skip


def jax_contenders(task: Task) -> Iterator[Contender]:
    """(c) the Runge-Kutta step written by hand, in one jitted scan."""
    import jax

    setup = Jax(task)
    control, rates, h = setup.control, setup.rates, SAMPLE_TIME

    def shifted(q: Columns, by: float, k: Columns) -> Columns:
        return tuple(x + by * y for x, y in zip(q, k, strict=True))

    def step(q: Columns) -> Columns:
        u = control(q)
        a = rates(q, u)
        b = rates(shifted(q, h / 2, a), u)
        c = rates(shifted(q, h / 2, b), u)
        d = rates(shifted(q, h, c), u)
        return tuple(
            x + h / 6 * (k0 + 2 * k1 + 2 * k2 + k3)
            for x, k0, k1, k2, k3 in zip(q, a, b, c, d, strict=True)
        )

    def columns(*start: Any) -> Any:
        return jax.lax.scan(lambda q, _: (step(q), None), start, None, length=task.steps)[0]

    def vector(start: Any) -> Any:
        def next_one(q: Any, _: object) -> tuple[Any, None]:
            return jax.numpy.stack(step(tuple(q))), None

        return jax.lax.scan(next_one, start, None, length=task.steps)[0]

    name = "(c) JAX scan"
    yield setup.contender(name, True, jax.vmap(vector), "vectors")
    yield setup.contender(name, True, columns, "columns")
    yield setup.contender(name, True, columns, "devices")


def diffrax_contenders(task: Task) -> Iterator[Contender]:
    """(b) diffrax with fixed steps: `diffeqsolve`, and its solver stepped in a scan.

    `diffeqsolve` knows no held input, so there the law is part of the right-hand side and is
    evaluated in each of the four stages.
    """
    import diffrax
    import jax

    class RK4(diffrax.AbstractERK):
        """The classical method, which diffrax does not ship."""

        tableau: ClassVar[Any] = diffrax.ButcherTableau(
            c=np.array([0.5, 0.5, 1.0]),
            a_lower=(np.array([0.5]), np.array([0.0, 0.5]), np.array([0.0, 0.0, 1.0])),
            b_sol=np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
            b_error=np.zeros(4),
        )
        interpolation_cls: ClassVar[Any] = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

        def order(self, terms: object) -> int:
            return 4

    setup = Jax(task)
    control, rates, h, solver = setup.control, setup.rates, SAMPLE_TIME, RK4()

    def solve(rhs: Callable[..., Any], start: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rhs), solver, 0.0, task.steps * h, h, start,
            stepsize_controller=diffrax.ConstantStepSize(), saveat=diffrax.SaveAt(t1=True),
            max_steps=task.steps + 2, adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        return jax.tree.map(lambda x: x[-1], solution.ys)

    def vector_rhs(t: Any, q: Any, _: object) -> Any:
        return jax.numpy.stack(rates(tuple(q), control(tuple(q))))

    def columns_rhs(t: Any, q: Columns, _: object) -> Columns:
        return tuple(rates(q, control(q)))

    held_term = diffrax.ODETerm(lambda t, q, u: tuple(rates(q, u)))

    def held_step(q: Columns, t: Any) -> tuple[Columns, None]:
        u = tuple(control(q))
        state = solver.init(held_term, t, t + h, q, u)
        return solver.step(held_term, t, t + h, q, u, state, made_jump=True)[0], None

    def stepped(*start: Any) -> Any:
        return jax.lax.scan(held_step, start, jax.numpy.arange(task.steps) * h)[0]

    # diffrax forms the step as t1 - t0, whose rounding differs from step to step
    add = partial(setup.contender, tolerance=1e-7)
    yield add("(b) diffrax solve", False, jax.vmap(partial(solve, vector_rhs)), "vectors")
    yield add("(b) diffrax solve", False, jax.vmap(lambda *q: solve(columns_rhs, q)), "columns")
    yield add("(b) diffrax step", True, stepped, "columns")
    yield add("(b) diffrax step", True, stepped, "devices")


def scipy_contenders(task: Task, few: int = 4) -> Iterator[Contender]:
    """(a) `solve_ivp` (RK45, default tolerances) with steps of at most one control sample.

    Run by run over the whole horizon with continuous control, the faster way; sample by sample
    with the input held; and all runs stacked into one problem, evaluated with NumPy.
    """
    from scipy.integrate import solve_ivp

    control, rates = closed_loop(SCALAR_FUNCTIONS, "math")
    array_control, array_rates = closed_loop(array_functions(np), "numpy")
    few = min(few, task.runs)

    def rhs(t: float, y: Array) -> Columns:
        q = y.tolist()
        return rates(q, control(q))

    def stacked_rhs(t: float, y: Array) -> Array:
        q = y.reshape(6, -1)
        return np.concatenate(array_rates(q, array_control(q)))

    def final(field: Callable[..., Any], start: Array) -> Array:
        span, only_end = (0, task.seconds), (task.seconds,)  # not every step kept in memory
        return solve_ivp(field, span, start, t_eval=only_end, max_step=SAMPLE_TIME).y[:, -1]

    def whole(start: Array) -> Array:
        return final(rhs, start)

    def by_sample(q: Array) -> Array:
        for _ in range(task.steps):
            u = control(q.tolist())
            q = solve_ivp(lambda t, y, u=u: rates(y.tolist(), u), (0, SAMPLE_TIME), q).y[:, -1]
        return q

    def one_by_one(simulate: Callable[[Array], Array]) -> Array:
        return np.array([simulate(start) for start in starts_of(task)[:few]])

    def stacked() -> Array:
        return final(stacked_rhs, starts_of(task).T.ravel()).reshape(6, -1).T

    def timed(function: Callable[[], Array]) -> Timed:
        began = time.perf_counter()
        states = function()
        return time.perf_counter() - began, states

    for name, held, function, runs, tolerance in (
        ("run by run", False, partial(one_by_one, whole), few, 1e-4),
        ("sample by sample", True, partial(one_by_one, by_sample), few, 1e-4),
        ("all runs stacked", False, stacked, task.runs, 1e-2),
    ):
        yield Contender(
            f"(a) scipy solve_ivp, {name}", "held" if held else "continuous",
            partial(timed, function),
            lambda held=held, runs=runs: final_states(task, not held)[:runs], tolerance, runs,
        )  # fmt: skip
