"""The arguments of the compiled loop, as named tuples: Numba knows tuples, and no other records."""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import Array
from holdfast.execution.codegen.closed_loop_program import ClosedLoopProgram
from holdfast.execution.codegen.lane_leaves import CLOCK
from holdfast.execution.compile import part
from holdfast.execution.simulation.settings import Settings

Whole = npt.NDArray[np.int64]


def block(driver: ModuleType, program: ClosedLoopProgram, addresses: Mapping[str, int],
          settings: Settings) -> tuple[Whole, Array]:  # fmt: skip
    """The arrays s and w of `driver.py`: the program as whole numbers, and room for one block."""
    n, m, limited = len(program.states), len(program.inputs), program.limited
    remembered, watched = len(program.remembered), len(program.constraints)
    seen, actuators = n + program.measured + remembered, len(program.actuators)
    parameters = len(program.parameters) + len(program.given) + 1
    conditions = max(count for count, _ in program.conditions_of_modes)
    guards = max(len(targets) for targets in program.targets)
    tableau, stages, modes = program.stepper, len(program.stepper.b), len(program.modes)
    sizes = {
        "STATES": n, "INPUTS": m, "MEASURED": program.measured, "REMEMBERED": remembered,
        "LIMITED": limited, "ACTUATORS": actuators, "PLACES": program.places,
        "SIGNALS": len(program.signals), "WATCHED": watched, "MODES": modes,
        "PARAMETERS": parameters, "STAGES": stages, "SAFEGUARDED": program.safeguarded,
        "CONTINUOUS": program.continuous, "ADAPTIVE": tableau.adaptive,
        "SUBSTEPS": settings.substeps, "LEAVING": guards,
        "CONDITIONS": conditions, "LANES": driver.WIDTH,
        "SWITCH_LIMIT": min(settings.switch_limit, settings.samples + 2),  # what it can count
    }  # fmt: skip
    rows = {  # leaves read and write several of these at once: `lane_leaves.py`
        **dict.fromkeys(map(str.upper, CLOCK_ROWS), 1), "Q": n, "STAGE": stages * n, "THEN": 1,
        "WILD": 1, "NEW": n, "K1": n, "BETWEEN": n, "AT": 1, "C0": watched, "D0": watched,
        "C1": watched, "D1": watched, "COMMAND": m, "NOMINAL": m, "OUTCOME": 1, "CLOSE": 1,
        "UNBOUNDED": 1, "WORST": watched, "BAD": 1, "PEAKS": m + actuators, "SEEN": seen,
        "INNER": seen, "PLANT": parameters, "GAINS": parameters, "MEMORY": remembered,
        "PLACE": program.places, "LOOK": program.places + 1, "MODE": 1,
        "ANSWER": 2 * m + conditions * (m + 1), "ACTUATION": 2 * limited + m,
        "BELIEVED": 2 * limited + m, "LEVELS": guards, "TIME_IN_MODE": 1,
        "SIGNAL": len(program.signals), "LEVEL": 1, "SLACK": 1, "OVERRULED": 1, "SLOPE": n,
        "INSIDE": watched, "FRACTION": 1, "NOTES": driver.NOTED,
    }  # fmt: skip
    width, of_modes = driver.WIDTH, driver.PER_MODE + stages - 1
    entries = driver.OF_MODE + guards
    table = of_modes + modes + modes * entries
    s = np.zeros(table + 5 + 2 * program.places, dtype=np.int64)
    for name, size in sizes.items():
        s[getattr(driver, name)] = size
    for name, leaf in LEAVES.items():
        s[getattr(driver, name)] = addresses.get(leaf, 0)
    length = 0
    for name, count in rows.items():
        s[getattr(driver, name)] = length
        length += count * width
    s[driver.METHOD] = length
    for k in range(1, stages):
        s[driver.PER_MODE + k - 1] = addresses[f"stage{k}"]
    for k, targets in enumerate(program.targets):
        own = s[of_modes + k] = of_modes + modes + k * entries
        s[own : own + driver.OF_MODE] = (
            addresses[f"law{k}"], addresses.get(f"guards{k}", 0), addresses[f"blend{k}"],
            len(targets), *program.conditions_of_modes[k],
        )  # fmt: skip
        s[own + driver.OF_MODE :][: len(targets)] = targets
    w = np.zeros(length + 4 + 2 * program.places)
    for name, value in (
        ("LENGTH", settings.sample_time / settings.substeps),
        ("LAST_INDEX", settings.substeps - 1),
        ("TOLERANCE", settings.tolerance),
    ):
        first = s[getattr(driver, name)]
        w[first : first + width] = value
    w[length : length + 4] = (
        settings.absolute, settings.relative, tableau.order, settings.sample_time
    )  # fmt: skip
    if program.safeguarded:
        s[driver.KEEP] = part("keep_lanes")
    if program.table is not None:
        values, low, steps, shape, periodic = program.table
        s[driver.LOOK_UP], s[driver.TABLE] = part("look_up_lanes"), table
        s[table : table + 5] = (
            values.ctypes.data, values.size, values.dtype == np.float32, program.timed, length + 4
        )  # fmt: skip
        s[table + 5 :] = *shape, *periodic
        w[length + 4 :] = *low, *steps
    return s, w


CLOCK_ROWS = tuple("t" if name == "time" else name for name in CLOCK)
LEAVES = {
    "RATES": "rates", "FELT": "felt", "BEGIN": "begin", "LOOKED_UP": "places",
    "SIGNALLED": "signals", "ACTUATE": "actuate", "REMEMBER": "remember",
    "CONSTRAINED": "constraints", "CONSTRAINT_RATES": "constraint_rates", "GOAL": "goal",
    "START": "start", "STEPPED": "new", "ERROR": "error", "ACCEPT": "accept", "TICK": "tick",
    "ARRIVE": "arrive", "PEAKED": "peaks", "BETWEEN_ENDS": "between", "WATCH": "watch",
    "TAKE": "take",
}  # fmt: skip


class Numbers(NamedTuple):
    """The numbers with which the expressions of a closed loop are evaluated.

    plant: the parameters of the simulated vehicle; gains: those that its controller believes, in
    the same order. varied_plant: columns of `plant` for which every run has its own values, in
    its row of `own_plant`; likewise for the gains.
    """

    plant: Array
    gains: Array
    varied_plant: Whole
    varied_gains: Whole
    own_plant: Array
    own_gains: Array


class Sampling(NamedTuple):
    """Measurement and sampling of a run.

    noise: (uniform or normal, state); noisy: whether any of it is not 0. samples: control samples
    of `sample_time`, of which every `stride`-th is recorded. The law sees what was measured `delay`
    samples ago.
    """

    noise: Array
    noisy: bool
    seed: np.uint64
    sample_time: float
    samples: int
    stride: int
    initial_mode: int
    delay: int


class Records(NamedTuple):
    """The arrays that the loop writes, each indexed by the run: `closed_loop.Trajectories`."""

    state: Array
    input: Array
    actuator: Array
    mode: npt.NDArray[np.int16]
    signal: Array
    constraint: Array
    nominal: Array
    nominal_actuator: Array
    sample_slack: Array
    safeguard: npt.NDArray[np.int8]
    outcome: npt.NDArray[np.int8]
    exit_time: Array
    exit_constraint: npt.NDArray[np.int16]
    goal_time: Array
    worst: Array
    peak_input: Array
    peak_actuator: Array
    switches: Whole
    shortest_dwell: Array
    overruled: Whole
    infeasible: Whole
    largest_slack: Array
    rejected: Whole
    off_grid: Array
