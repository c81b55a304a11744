"""One control sample of a closed loop, for other simulators: the leaves of the loop, one by one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.execution.arrays import Array
from holdfast.execution.compile import compile_interpolation, compile_quadratic_program
from holdfast.execution.simulation.closed_loop import ClosedLoop

NONE = np.zeros(1)


class Controller(NamedTuple):
    """What a controller carries from one sample to the next; no memory: it begins."""

    memory: Array | None
    mode: int
    in_mode: float


class Sample(NamedTuple):
    """The input of a sample, with the unfiltered command and the slack of a safeguard; the end."""

    state: Array
    controller: Controller
    input: Array
    nominal: Array
    slack: float


def one_sample(
    loop: ClosedLoop, t: float, state: Array, before: Controller, p: Array, substeps: int
) -> Sample:
    """One control sample as `simulate` computes it; `p` ends with the sample time [s]."""
    program, time = loop.program, np.array([t])
    n, m, length = len(program.states), len(program.inputs), float(p[-1])

    def values(name: str, width: int, q: Array = NONE, x: Array = NONE, at: Array = time) -> Array:
        given = (a[np.newaxis] for a in (at, q, x, p))
        found: Array = loop.leaves.values(name, 1, width, *given)[0]
        return found

    seen = np.concatenate([state, values("felt", program.measured)]) if program.measured else state
    memory = before.memory if program.remembered else np.empty(0)
    if memory is None:
        memory = values("begin", len(program.remembered), seen)
    seen = np.concatenate([seen, memory])
    mode, targets = before.mode, program.targets[before.mode]
    if targets:
        levels = values(f"guards{mode}", len(targets), seen, np.array([before.in_mode]))
        mode = next((k for k, level in zip(targets, levels, strict=True) if level >= 0.0), mode)
    look = NONE
    if program.places:
        look = np.empty(program.places + 1)
        compile_interpolation().look_up(program.table, values("places", program.places, seen), look)
    count, hard = program.conditions_of_modes[mode]
    rows = count * (m + 1)
    answer = values(f"law{mode}", m + rows + (m if count else 0), seen, look)
    nominal, command, slack = answer[:m], answer[:m], 0.0
    if count:
        given = compile_quadratic_program().keep_within(
            nominal, answer[m + rows :], answer[m : m + rows], hard
        )
        command, slack = given[:m], float(given[m])
    limited = program.limited
    actuation = values("actuate", 2 * limited + m, command, p)
    if program.remembered:
        memory = values("remember", len(memory), seen, actuation[:limited])
    u, h = actuation[2 * limited :], length / substeps
    weights, stages = program.stepper.weights(), len(program.stepper.b)
    for k in range(substeps):
        slopes: list[Array] = []
        for i in range(stages):
            q = state + h * sum(
                (w * s for w, s in zip(weights[i], slopes, strict=False) if w), np.zeros(n)
            )
            at = np.array([t + k * h + weights[stages + 2, i] * h])
            slopes.append(values("rates", n, q, u, at))
        state = state + h * sum(
            (w * s for w, s in zip(weights[stages], slopes, strict=True) if w), np.zeros(n)
        )
    stays = before.in_mode if mode == before.mode else 0.0
    return Sample(state, Controller(memory, mode, stays + length), u, nominal, slack)
