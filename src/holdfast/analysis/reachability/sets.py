"""The problems of viability by their names; each is one of `solve.solve`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from holdfast.analysis.reachability.given import by_name
from holdfast.analysis.reachability.grid import Grid
from holdfast.analysis.reachability.options import Problem
from holdfast.analysis.reachability.solve import solve
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.arguments import checked
from holdfast.errors import RenamedWarning, SimulationError
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System


@checked
def viability_kernel(
    system: System, region: Region, grid: Grid, horizon: float, **options: Any
) -> ValueFunction:
    """The states from which some input keeps the system in `region` for `horizon` seconds.

    V_t + min{0, max_u p . f} = 0, V(T) = l; the viability kernel itself once it has converged
    (`converged` of the result). The system has no disturbances, or all are given (`disturbance`).
    options: those of `Marching`, and times, disturbance, parameters, start_time, progress
    (`solve.solve`).

    Raises `SimulationError` for what cannot be solved, and for a march that is unstable.
    """
    if _undecided(system, options):
        raise SimulationError(
            f"system '{system.name}' has disturbances",
            remedy="give them (disturbance=...), or ask for the discriminating_kernel",
        )
    return solve(system, Problem("viability-kernel", "shrink", region), grid, horizon, **options)


def _undecided(system: System, options: Mapping[str, Any]) -> bool:
    """Whether some disturbance is left that is not given."""
    given = options.get("disturbance")
    known = {} if given is None else by_name("disturbance", given, '{"d": 0.1}')
    return bool(set(system.disturbance_names) - set(known))


@checked
def discriminating_kernel(
    system: System, region: Region, grid: Grid, horizon: float, **options: Any
) -> ValueFunction:
    """The states from which some input keeps the system in `region` whatever the disturbance does.

    V_t + min{0, max_u min_d p . f} = 0, V(T) = l (thesis (7.6)). The rest as `viability_kernel`.
    """
    if not _undecided(system, options):
        raise SimulationError("the system has no disturbances", remedy="use viability_kernel")
    problem = Problem("discriminating-kernel", "shrink", region)
    return solve(system, problem, grid, horizon, **options)


@checked
def invariance_kernel(
    system: System, region: Region, grid: Grid, horizon: float, **options: Any
) -> ValueFunction:
    """The states from which every input and every disturbance keeps the system in `region`.

    V_t + min{0, min_u min_d p . f} = 0, V(T) = l. The rest as `viability_kernel`.
    """
    problem = Problem("invariance-kernel", "shrink", region, inputs="min")
    return solve(system, problem, grid, horizon, **options)


@checked
def backward_reachable_tube(
    system: System,
    target: Region,
    grid: Grid,
    horizon: float,
    *,
    disturbances: str = "min",
    **options: Any,
) -> ValueFunction:
    """The states from which some input brings the system to `target` within `horizon` seconds.

    V_t + max{0, max_u opp_d p . f} = 0, V(T) = l_T. disturbances: "min" work against it, "max"
    help. `backward_reachable_at` is the set of the states that are there at the horizon itself.
    """
    problem = Problem("backward-reachable-tube", "grow", target, disturbances=disturbances)
    return solve(system, problem, grid, horizon, **options)


@checked
def backward_reachable_at(
    system: System,
    target: Region,
    grid: Grid,
    horizon: float,
    *,
    disturbances: str = "min",
    **options: Any,
) -> ValueFunction:
    """The states from which some input has the system in `target` after exactly `horizon` seconds.

    The backward reachable set, as against the tube: V_t + max_u opp_d p . f = 0, V(T) = l_T. It
    need not contain the target, and the march goes on to the horizon. disturbances: "min" work
    against it, "max" help. Raises `SimulationError` for check_outside, which is about tubes.
    """
    if options.get("check_outside"):
        raise SimulationError(
            "check_outside of a set at exactly the horizon", remedy="ask for the tube"
        )
    problem = Problem("backward-reachable-at", "exact", target, disturbances=disturbances)
    return solve(system, problem, grid, horizon, **options)


def backward_reachable_set(*given: Any, **options: Any) -> ValueFunction:
    """The former name of `backward_reachable_tube`; it warns, and goes with the next release."""
    warnings.warn(
        "backward_reachable_set is now backward_reachable_tube; the set at exactly the horizon is "
        "backward_reachable_at",
        RenamedWarning,
        stacklevel=2,
    )
    return backward_reachable_tube(*given, **options)


@checked
def forward_reachable_set(
    system: System,
    start: Region,
    grid: Grid,
    horizon: float,
    *,
    disturbances: str = "max",
    **options: Any,
) -> ValueFunction:
    """The states that some input, and some disturbance, can bring the system to from `start`.

    The forward reachable tube: the backward one of the reversed dynamics (thesis section 7.3). The
    states are those at the end of the horizon, after leaving `start` at any time within it.
    disturbances: "max" are at the choice of whoever wants to get there, "min" work against it. The
    set is an inner approximation (`report.approximation`): on a grid it leaves out what is thin.
    """
    problem = Problem(
        "forward-reachable-set", "grow", start, disturbances=disturbances, backwards=True
    )
    return solve(system, problem, grid, horizon, **options)


@checked
def capture_basin(
    system: System,
    goal: Region,
    region: Region | None,
    grid: Grid,
    horizon: float,
    *,
    arrival_steps: int | None = None,
    **options: Any,
) -> ValueFunction:
    """The states from which some input reaches `goal` within `horizon` s, in `region` until then.

    The reach-avoid set. W = max_u max_tau min{ l_G(tau), min_{s <= tau} l_K(s) } solves
    min{ max{ W_t + H, l_G - W }, l_K - W } = 0; disturbances work against it. `arrival` is the
    least time, from `arrival_steps` values over the horizon (100; 0: none). Where something depends
    on time there is none: it would hold for one start only.
    """
    problem = Problem("capture-basin", "free", goal, above=region)
    return solve(system, problem, grid, horizon, arrival_steps=arrival_steps, **options)
