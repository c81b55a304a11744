"""Seconds until the first answer: of a new law, of a command, and of a march, beside the peers.

    python benchmarks/start_up.py [--repeats 3]

Every figure is from processes of their own, with a cache of compiled code of their own; the least
and the median of the repeats are printed. "Nobody compiled": another program was simulated or
marched before with that cache, so that it contains what is compiled once on a machine, and not this
program. A law's time begins when it is derived and ends with the result of one run; a march's
begins with the call; a command's is its wall time.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

BESIDE = str(Path(__file__).parent)
TUTORIAL = Path(__file__).parents[1] / "docs" / "tutorial.md"

SIMULATE = """
import time
import holdfast as hf
scene = hf.load_scenario({name!r}, runs=1)
began = time.perf_counter()
hf.simulate(scene.system, scene.law, starts=scene.starts, region=scene.region, goal=scene.goal,
            horizon=1.0)
print(time.perf_counter() - began)
"""

JAX = """
import sys, time
sys.path.insert(0, {folder!r})
import jax
jax.config.update("jax_enable_x64", True)
import peers, task
one = task.Task(16, 1.0)
contender = next(c for c in peers.jax_contenders(one) if "columns" in c.name)
began = time.perf_counter()
contender.prepare()
contender.run()
print(time.perf_counter() - began)
"""

MARCH = """
import sys, time
sys.path.insert(0, {folder!r})
import level_sets
problem = level_sets.{problem}
began = time.perf_counter()
problem.march({scheme!r})
print(time.perf_counter() - began)
"""

PEER_MARCH = """
import time
import jax
jax.config.update("jax_enable_x64", True)
import hj_reachability as hj
import jax.numpy as jnp
game = hj.systems.Air3d()
box = hj.sets.Box(jnp.array([-6.0, -10.0, 0.0]), jnp.array([20.0, 10.0, 2 * jnp.pi]))
grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(box, (41, 41, 41), periodic_dims=2)
values = jnp.linalg.norm(grid.states[..., :2], axis=-1) - 5.0
settings = hj.SolverSettings.with_accuracy({accuracy!r})
began = time.perf_counter()
hj.step(settings, game, grid, 0.0, values, -0.2, progress_bar=False).block_until_ready()
print(time.perf_counter() - began)
"""


class Machine:
    """A fresh cache of compiled code, and a folder for results."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = dict(os.environ, HOLDFAST_CACHE_DIR=str(folder / "cache"))

    def python(self, code: str) -> float:
        """The seconds that a script prints."""
        return float(self._run([sys.executable, "-c", code]).split()[-1])

    def command(self, *words: str) -> float:
        """The wall time of a command."""
        began = time.perf_counter()
        self._run([sys.executable, "-m", "holdfast", *words, "--out", f"run{time.time_ns()}"])
        return time.perf_counter() - began

    def _run(self, command: list[str]) -> str:
        return subprocess.run(
            command, env=self.environment, cwd=self.folder, capture_output=True, text=True,
            check=True,
        ).stdout  # fmt: skip


def measured(repeats: int, once: Callable[[Machine], dict[str, float]]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            for name, seconds in once(Machine(Path(folder))).items():
                found.setdefault(name, []).append(seconds)
    return found


def laws(machine: Machine) -> dict[str, float]:
    machine.python(SIMULATE.format(name="ch2-unicycle"))
    plain, viable = (SIMULATE.format(name=n) for n in ("ch5-nominal", "inspection"))
    return {
        "plain law": machine.python(plain),
        "plain law, again": machine.python(plain),
        "viable law": machine.python(viable),
        "viable law, again": machine.python(viable),
    }


def commands(machine: Machine) -> dict[str, float]:
    (ferry,) = re.findall(r"```toml\n(# ferry\.toml\n.*?)```", TUTORIAL.read_text("utf-8"), re.S)[
        :1
    ]
    (machine.folder / "ferry.toml").write_text(ferry, "utf-8")
    found = {"`ch2-unicycle`, first": machine.command("run", "ch2-unicycle", "--no-figures")}
    for name in ("ferry.toml", "inspection"):
        for what in ("new", "warm"):
            found[f"`{name}`, {what}"] = machine.command("run", name, "--no-figures")
    machine.command("run", "inspection")  # Matplotlib's cache of fonts
    found["`inspection`, figures"] = machine.command("run", "inspection")
    return found


def marches(machine: Machine) -> dict[str, float]:
    found = {}
    for scheme in ("upwind", "weno5"):
        first, other = (
            MARCH.format(folder=BESIDE, scheme=scheme, problem=problem)
            for problem in ("aircraft((41, 40, 41), 5)", "game(41, 5)")
        )
        found[f"march, {scheme}, first"] = machine.python(first)
        found[f"march, {scheme}"] = machine.python(other)
    return found


def peer(name: str, code: str) -> Callable[[Machine], dict[str, float]]:
    return lambda machine: {name: machine.python(code)}


def peers() -> Iterator[Callable[[Machine], dict[str, float]]]:
    if importlib.util.find_spec("jax"):
        yield peer("peer: plain law", JAX.format(folder=BESIDE))
    if importlib.util.find_spec("hj_reachability"):
        for accuracy in ("low", "very_high"):
            yield peer(f"peer: march, {accuracy}", PEER_MARCH.format(accuracy=accuracy))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    print(f"load average {os.getloadavg()[0]:.2f}, {os.cpu_count()} cores\n")
    print("| what | least, s | median, s |\n|---|---|---|")
    for once in (laws, commands, marches, *peers()):
        for name, seconds in measured(repeats, once).items():
            print(f"| {name} | {min(seconds):.2f} | {statistics.median(seconds):.2f} |", flush=True)


if __name__ == "__main__":
    main()
