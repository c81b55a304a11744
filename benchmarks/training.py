"""An agent of a standard library learns with and without a safety filter: violations in training.

`python benchmarks/training.py` needs Gymnasium and Stable-Baselines3
(`python -m pip install stable-baselines3`). Soft actor-critic steers the marine vehicle to its pose
in front of the target; an episode ends where the view is lost. The agents, their seeds and their
steps are the same with the filter and without. The learned policies are tried from 200 starts.
"""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3 as sb3

import holdfast as hf
from holdfast.interop.gymnasium import Environment, Filtered

SAMPLE_TIME, HORIZON = 0.1, 20.0
INSIDE = {"edge_low": 0.02, "edge_high": 0.02, "too_near": 0.01, "too_far": 0.03}  # rad, m
GOAL = np.array([-0.5, 0.0, 0.0])


class Nearer(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A reward for being near the pose, and a count of the episodes that left the view."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.left = self.episodes = self.samples = self.overruled = 0

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """The environment's own step, rewarded by the distance to the pose."""
        seen, reward, over, cut_off, info = self.env.step(action)
        self.samples += 1
        self.overruled += info.get("overruled", False)
        self.left += reward < 0
        self.episodes += over or cut_off
        off = np.asarray(seen)[:3] - GOAL
        away = math.hypot(off[0], off[1]) + 0.3 * abs(off[2])
        return seen, -0.1 * away + 10.0 * reward, over, cut_off, info


def world(filtered: bool) -> Nearer:
    """The vehicle in front of its target."""
    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    box = {"x": (-1.8, -0.5), "y": (-1.0, 1.0), "psi": (-1.0, 1.0)}
    goal = hf.regions.near_pose(goal_x=-0.5)
    env: gymnasium.Env[Any, Any] = Environment(
        vehicle, view, goal=goal, box=box, sample_time=SAMPLE_TIME, horizon=HORIZON
    )
    if filtered:
        keep = hf.SafetyFilter(
            vehicle, view, gains=(1.5, 8), margins=INSIDE, sample_time=SAMPLE_TIME
        )
        env = Filtered(env, keep)
    return Nearer(env)


def tried(agent: Any, filtered: bool, runs: int) -> tuple[int, int]:
    """How many of so many starts the learned policy keeps in the view, and brings to the goal."""
    env, kept, arrived = world(filtered), 0, 0
    for seed in range(runs):
        seen, _ = env.reset(seed=10_000 + seed)
        over = cut_off = False
        while not (over or cut_off):
            action, _ = agent.predict(seen, deterministic=True)
            seen, _, over, cut_off, _ = env.step(action)
        left = env.left
        env.left = 0
        kept += not left
        arrived += over and not left
    return kept, arrived


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=30_000)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--runs", type=int, default=200)
    chosen = parser.parse_args()
    print(
        "| agent | seed | episodes | left the view in training | overruled | kept | arrived | s |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for seed in range(chosen.seeds):
        for filtered in (False, True):
            env, began = world(filtered), time.perf_counter()
            agent = sb3.SAC("MlpPolicy", env, seed=seed, verbose=0, device="cpu")
            agent.learn(chosen.steps)
            kept, arrived = tried(agent, filtered, chosen.runs)
            name = "SAC behind the filter" if filtered else "SAC alone"
            print(
                f"| {name} | {seed} | {env.episodes} | {env.left} | "
                f"{env.overruled / env.samples:.0%} | {kept} of {chosen.runs} | "
                f"{arrived} of {chosen.runs} | {time.perf_counter() - began:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
