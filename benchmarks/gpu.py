"""Marches and simulations on a graphics processor: docs/gpu.md.

    python benchmarks/gpu.py [--device gpu] [--nodes 21,31,50] [--runs 1000000] [--peers]

--device c++ runs the same kernels by the C++ compiler, one thread: for what they compute, not how
fast. The full vehicle's kernel (`ch7-six-states`: 3 s, first order, single precision), its values
beside the processor's up to --both nodes; `inspection` with that many runs, beside the processor's
share of them. --peers: hj_reachability on the same card, a double integrator of three states.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from holdfast.execution.device.program import device_named
from holdfast.scenario.load import load_scenario

FEW = 2_000
"""Runs that the processor is timed with."""


def kernel(nodes: int, device: str, both: int) -> str:
    """A row of the table of kernels."""
    changes = [f"grid.nodes={nodes}"]
    scenario = load_scenario("ch7-six-states", changes).on_device(device)
    begun = time.perf_counter()
    found = scenario.solve()
    whole = time.perf_counter() - begun
    report = found.report
    row = f"| {nodes}^6 = {nodes**6 / 1e6:,.3g} million | {report.steps:,} "
    row += f"| {report.wall_time_s:.1f} s | {whole:.1f} s | {100 * report.computed_share:.0f} % "
    if nodes > both:
        return row + "| | | |"
    here = load_scenario("ch7-six-states", changes).solve()
    a, b = here.values(), found.values()
    unlike = int((np.sign(a) != np.sign(b)).sum())
    return row + f"| {here.report.wall_time_s:.1f} s | {np.abs(a - b).max():.1g} m | {unlike} |"


def simulation(runs: int, device: str) -> str:
    """A row of the table of simulations; the first runs are compared, outcome by outcome."""
    seconds, outcomes = [], []
    few = min(runs, FEW)
    for where, many in ((device, runs), ("cpu", few)):
        scenario = load_scenario("inspection", ("safeguard.uncertain=",), many)  # nominal model
        result = scenario.with_settings(
            record_every=scenario.settings["horizon"], device=where
        ).run()
        seconds.append(result.dataset.attrs["wall_time_s"] / many)
        outcomes.append(result.dataset["outcome"].values[:few])
    return (
        f"| {runs:,} | {seconds[0] * runs:.1f} s | {1e6 * seconds[0]:.1f} us "
        f"| {1e6 * seconds[1]:.0f} us | {seconds[1] / seconds[0]:.2g} "
        f"| {int((outcomes[0] != outcomes[1]).sum())} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="gpu", choices=("gpu", "c++"))
    parser.add_argument("--nodes", default="13,17,21,31")
    parser.add_argument("--both", type=int, default=17)
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--peers", action="store_true")
    given = parser.parse_args()
    device = device_named(given.device)
    print(getattr(device, "model", given.device))
    print("| nodes | steps | march | whole | computed | processor | largest difference | signs |")
    for nodes in map(int, given.nodes.split(",")):
        print(kernel(nodes, given.device, given.both), flush=True)
    print("| runs | all | one | one on the processor | ratio | other outcomes |")
    print(simulation(given.runs, given.device), flush=True)
    if given.peers:
        peer(given.device)


def peer(device: str) -> None:
    """The march of a peer on the same card, fifth order in space, third in time."""
    import hj_reachability as hj
    import jax.numpy as jnp

    import holdfast as hf

    x, v, u = (hf.symbol(n) for n in ("x", "v", "u"))
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
        {"x": v, "v": u}, input_bounds=hf.Box((-1,), (1,)),
        empirical="numbers",
    )  # fmt: skip
    walls = hf.Region(
        "walls",
        cart.states[:1],
        (hf.Inequality("walls", x**2 - 1, "m"),),
        empirical="numbers",
    )
    box, nodes, horizon = {"x": (-2, 2), "v": (-2, 2)}, 2001, 1.0
    ends = dict.fromkeys(box, "extrapolated")
    for _ in range(2):  # the second without compilation
        begun = time.perf_counter()
        hf.viability_kernel(
            cart, walls, hf.grid(cart, box, nodes, ends), horizon, skip=False, device=device
        )
        ours = time.perf_counter() - begun

    class Cart(hj.ControlAndDisturbanceAffineDynamics):  # type: ignore[misc]
        def __init__(self) -> None:
            one = hj.sets.Box(jnp.array([-1.0]), jnp.array([1.0]))
            super().__init__("max", "min", one, hj.sets.Box(jnp.zeros(1), jnp.zeros(1)))

        def open_loop_dynamics(self, state, time):  # type: ignore[no-untyped-def]
            return jnp.array([state[1], 0.0])

        def control_jacobian(self, state, time):  # type: ignore[no-untyped-def]
            return jnp.array([[0.0], [1.0]])

        def disturbance_jacobian(self, state, time):  # type: ignore[no-untyped-def]
            return jnp.zeros((2, 1))

    over = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(jnp.array([-2.0, -2.0]), jnp.array([2.0, 2.0])), (nodes, nodes)
    )
    values = 1.0 - over.states[..., 0] ** 2
    settings = hj.SolverSettings.with_accuracy(
        "very_high", hamiltonian_postprocessor=lambda h: jnp.minimum(h, 0.0)
    )
    for _ in range(2):
        begun = time.perf_counter()
        hj.step(settings, Cart(), over, 0.0, values, -horizon).block_until_ready()
        theirs = time.perf_counter() - begun
    print(f"a cart of {nodes}^2 nodes: {ours:.2f} s, hj_reachability {theirs:.2f} s")


if __name__ == "__main__":
    main()
