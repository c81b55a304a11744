"""The time of a decision among 20 obstacles that move: from Python, and as C; and of the build.

`python benchmarks/moving_times.py` prints a table. The states are those of a vehicle among discs of
up to .4 m/s, at random. Each number is the least of 25 repetitions, in time of the processor that
the thread had, since other work shares the machine; a line says how much.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import holdfast as hf

OBSTACLES, STATES = 20, 400
LOOP = """
void many(const double *seen, const double *commands, const double *records, long size, long count,
          double *answer) {
    keep_state s;
    double handed[KEEP_HANDED];
    keep_start(&s);
    for (long k = 0; k < count; k++) {
        for (int i = 0; i < KEEP_INPUTS; i++) handed[i] = commands[k * KEEP_INPUTS + i];
        keep_obstacles(seen + k * KEEP_SEEN, records + k * size, size, handed);
        keep_step(&s, 0.0, 0.02, seen + k * KEEP_SEEN, handed, keep_parameters, answer,
                  answer + KEEP_INPUTS);
    }
}
"""


def least(run, count: int) -> float:
    """The least time of one of `count` decisions, in nanoseconds of the processor."""
    best = float("inf")
    for _ in range(25):
        began = time.thread_time()
        run()
        best = min(best, (time.thread_time() - began) / count)
    return best * 1e9


def vehicles():
    yield "unicycle", hf.systems.unicycle(), hf.Obstacles(OBSTACLES, lead=0.25), (1.0, 4.0)
    boat = hf.systems.marine_vehicle("videoray_pro_iii")
    yield "VideoRay, six states", boat, hf.Obstacles(OBSTACLES, lead=0.3), (0.6, 3.0)


def asked(system: hf.System, rng: np.random.Generator):
    """States, commands, and the discs around each: x, y, radius, vx, vy, acceleration."""
    states = rng.uniform(-0.3, 0.3, (STATES, len(system.states)))
    commands = rng.uniform(0, 1, (STATES, len(system.inputs)))
    angles = rng.uniform(-np.pi, np.pi, (STATES, OBSTACLES))
    away = rng.uniform(1.2, 6, (STATES, OBSTACLES))
    places = away[..., np.newaxis] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rest = np.broadcast_to([0.4], (STATES, OBSTACLES, 1))
    velocities = rng.uniform(-0.28, 0.28, (STATES, OBSTACLES, 2))
    changes = np.full((STATES, OBSTACLES, 1), 0.1)
    return states, commands, np.concatenate([places, rest, velocities, changes], axis=2)


def listed(discs: np.ndarray) -> list[hf.Obstacle]:
    return [
        hf.Obstacle.disc((x, y), r, velocity=(vx, vy), acceleration=a)
        for x, y, r, vx, vy, a in discs.tolist()
    ]


def in_c(keep: hf.SafetyFilter, states: np.ndarray, commands: np.ndarray, around) -> float:
    """The time of finding the nearest and of a step of the exported filter [ns]."""
    rows = [np.frombuffer(b"".join(o.records for o in some)) for some in around]
    records = np.concatenate(rows)
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "keep.c"), Path(folder, "keep.so")
        text = keep.export_c("keep")
        text += LOOP.replace("KEEP_HANDED", str(len(keep.law.handed)))
        source.write_text(text)
        subprocess.run(
            ["cc", "-std=c99", "-O2", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True
        )
        code, answer = ctypes.CDLL(str(library)), np.zeros(16)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (states, commands, records, answer)]
        size, count = ctypes.c_long(len(rows[0])), ctypes.c_long(len(states))
        return least(lambda: code.many(*pointers[:3], size, count, pointers[3]), len(states))


def main() -> None:
    """Print the table."""
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print("| 20 obstacles around a | changed | discs as an array | as hf.Obstacle | C | build |")
    print("|---|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    for name, system, clear, gains in vehicles():
        began = time.process_time()
        keep = hf.SafetyFilter(system, obstacles=clear, gains=gains)
        keep.step([0.0] * len(system.states), [0.0] * len(system.inputs), obstacles=[])
        build = time.process_time() - began
        states, commands, discs = asked(system, rng)
        around = [listed(row) for row in discs]
        statuses = []

        def stepped(obstacles, keep=keep, states=states, commands=commands) -> list:
            return [
                keep.step(q, u, 0.0, obstacles=o).status
                for q, u, o in zip(states, commands, obstacles, strict=True)
            ]

        statuses = stepped(around)
        changed = np.mean([s is not hf.Status.PASSED for s in statuses])
        arrays, objects = (
            least(lambda o=o: stepped(o), STATES) / 1e3 for o in (list(discs), around)
        )
        code = in_c(keep, states, commands, around) / 1e3
        print(
            f"| {name} | {changed:.0%} | {arrays:.1f} us | {objects:.1f} us | {code:.2f} us | "
            f"{build:.1f} s |",
            flush=True,
        )


if __name__ == "__main__":
    main()
