"""A filter among discs that move: who is hit, how often no input meets all conditions, the way.

The same controller drives alone and filtered.

    python benchmarks/moving.py unicycle crossing head-on overtaking adversarial
    python benchmarks/moving.py boat crossing --runs 50

A vehicle drives ahead among 20 discs of .4 m radius and up to .4 m/s, whose velocity changes by up
to .1 m/s^2, on a square of 14 m that repeats. An adversary steers straight for the vehicle. The
truth is looked at beside the filter: the distance of the vehicle to every disc at every sample.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import holdfast as hf

DISCS, RADIUS, FASTEST, CHANGE = 20, 0.4, 0.4, 0.1
SQUARE, SAMPLE, SECONDS = 14.0, 0.02, 30.0
KINDS = {"crossing": np.pi / 2, "head-on": np.pi, "overtaking": 0.0, "adversarial": 0.0}


def towards_the_front(states, surge, turn, damping):
    """A controller that drives along x, a row for each run."""
    heading = states[:, 2]
    wanted = np.clip(1.5 * -heading, -1, 1) * turn
    if damping:
        wanted = np.clip(0.6 * -heading - damping * states[:, 5], -0.4, 0.4) * turn
    return np.stack([surge * np.maximum(np.cos(heading), 0), wanted], axis=1)


VEHICLES = {
    "unicycle": (lambda: hf.systems.unicycle(), 0.25, (1.0, 4.0), (1.0, 2.0, 0.0)),
    "boat": (
        lambda: hf.systems.marine_vehicle("videoray_pro_iii"), 0.3, (0.6, 3.0), (6.0, 1.0, 0.25),
    ),
}  # fmt: skip


class Traffic:
    """Discs around every run, and the least distance of each run to them."""

    def __init__(self, kind, runs, seed=0):
        self.random, self.kind = np.random.default_rng(seed), kind
        place = self.random.uniform(-SQUARE / 2, SQUARE / 2, (runs, DISCS, 2))
        far = np.linalg.norm(place, axis=2, keepdims=True)
        self.place = place * np.where(far < 2, 2 / far, 1)
        course = KINDS[kind] * self.random.choice([-1, 1], (runs, DISCS))
        course = course + 0.2 * self.random.standard_normal((runs, DISCS))
        speed = FASTEST * self.random.uniform(0.5, 1, (runs, DISCS, 1))
        self.velocity = speed * np.stack([np.cos(course), np.sin(course)], axis=-1)
        self.least, self.began = np.full(runs, np.inf), False
        self.hit_at = np.full(runs, np.inf)

    def __call__(self, t, states):
        """The discs as the filter is told of them, nearest copies in the square that repeats."""
        if self.began:
            self.move(states)
        self.began = True
        gap = self.gap(states)
        self.least = np.minimum(self.least, np.linalg.norm(gap, axis=2).min(axis=1) - RADIUS)
        self.hit_at = np.where((self.least < 0) & np.isinf(self.hit_at), t, self.hit_at)
        shape = (*gap.shape[:2], 1)
        return np.concatenate(
            [states[:, np.newaxis, :2] + gap, np.full(shape, RADIUS), self.velocity,
             np.full(shape, CHANGE)], axis=2,
        )  # fmt: skip

    def gap(self, states):
        gap = self.place - states[:, np.newaxis, :2]
        return (gap + SQUARE / 2) % SQUARE - SQUARE / 2

    def move(self, states):
        push = self.random.standard_normal(self.place.shape)
        if self.kind == "adversarial":
            push = -self.gap(states)
        size = np.linalg.norm(push, axis=2, keepdims=True)
        push *= CHANGE * (1 / size if self.kind == "adversarial" else np.minimum(1 / size, 1))
        self.place = self.place + SAMPLE * self.velocity
        velocity = self.velocity + SAMPLE * push
        size = np.linalg.norm(velocity, axis=2, keepdims=True)
        self.velocity = velocity * np.minimum(1, FASTEST / size)


def drive(vehicle, kind, runs, filtered):
    """One line of the table."""
    make, lead, gains, (surge, turn, damping) = VEHICLES[vehicle]
    system = make()
    traffic = Traffic(kind, runs)

    def controller(t, states):
        return towards_the_front(states, surge, turn, damping)

    starts = np.zeros((runs, len(system.states)))
    if filtered:
        around = hf.Obstacles(8, lead=lead, clearance=0.03)
        keep = hf.SafetyFilter(system, obstacles=around, gains=gains, sample_time=SAMPLE)
        law, command = keep.law, keep.among(controller, traffic)
    else:

        def command(t, states):
            traffic(t, states)
            return controller(t, states)

        law = hf.commanded(system)
    result = hf.simulate(
        system, law, command=command, starts=starts, horizon=SECONDS, sample_time=SAMPLE,
        record_every=0.1,
    )  # fmt: skip
    samples = result.arrays["infeasible"].values if filtered else np.zeros(runs)
    warned = ""
    if filtered and (traffic.least < 0).any():
        at = result.arrays["time"].values
        short = result.arrays["safeguard"].values == 2
        ahead = []
        for k in np.flatnonzero(traffic.least < 0):  # since when pinched, before the hit
            before = np.flatnonzero(short[k] & (at <= traffic.hit_at[k]))
            ahead.append(traffic.hit_at[k] - at[before[0]] if len(before) else 0.0)
        warned = f", pinched {min(ahead):.1f} s or more before a hit"
    way = np.median(result.arrays["state"].values[:, -1, 0])
    return (
        f"{vehicle:9s} {kind:12s} {'filtered' if filtered else 'alone':9s} "
        f"hit {int((traffic.least < 0).sum()):3d} of {runs}, least {traffic.least.min():+.3f} m, "
        f"infeasible {100 * samples.mean() / (SECONDS / SAMPLE):.2f} %, way {way:.1f} m{warned}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vehicle", choices=VEHICLES)
    parser.add_argument("kinds", nargs="+", choices=KINDS)
    parser.add_argument("--runs", type=int, default=200)
    asked = parser.parse_args()
    for kind in asked.kinds:
        for filtered in (False, True):
            began = time.perf_counter()
            line = drive(asked.vehicle, kind, asked.runs, filtered)
            print(f"{line} ({time.perf_counter() - began:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
