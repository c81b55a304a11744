"""`holdfast filter` as a process: the time of a round trip, and lines per second of a stream.

A vehicle in front of a target is steered by a PD controller through the pipes of the process; the
same lines are then read from a file. `holdfast monitor` reads the decisions from a file.

    python benchmarks/filter_process.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import holdfast as hf

SCENARIO = """
[scenario]
title = "a controller in front of a target"
[system]
name = "marine_vehicle"
[law]
external = true
[region]
name = "camera_view"
[safeguard]
gains = [1.5, 8]
[starts]
random = 1
[run]
horizon = 1
"""
SAMPLES, TOLD = 3000, 30_000


def holdfast(*words: str | Path, **streams: object) -> subprocess.Popen[bytes]:
    line = [sys.executable, "-m", "holdfast", *map(str, words)]
    return subprocess.Popen(line, **streams)


def seconds(*words: str | Path, told: Path, answers: Path) -> float:
    with told.open("rb") as read, answers.open("wb") as write:
        begun = time.perf_counter()
        process = holdfast(*words, stdin=read, stdout=write, stderr=subprocess.DEVNULL)
        assert process.wait() == 0
        return time.perf_counter() - begun


def round_trips(scenario: Path, kept: Path) -> np.ndarray:
    """Seconds from the line of a sample to that of its decision."""
    vehicle = hf.systems.marine_vehicle()
    boat, taken = hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0]), []
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process = holdfast("filter", scenario, **pipes)
    assert process.stdin is not None
    assert process.stdout is not None
    with kept.open("wb") as file:
        for _ in range(SAMPLES):
            x, y, psi, u, _v, r = boat.state
            state = dict(zip(vehicle.state_names, map(float, boat.state), strict=True))
            command = {"tau_u": 4 * (-0.5 - x) - 6 * u, "tau_r": -0.6 * psi - 1.2 * y - 0.4 * r}
            line = json.dumps({"state": state, "command": command}).encode() + b"\n"
            file.write(line)
            begun = time.perf_counter()
            process.stdin.write(line)
            process.stdin.flush()
            answer = process.stdout.readline()
            taken.append(time.perf_counter() - begun)
            boat.step(list(hf.DecisionRecord.read(answer).input.values()))
    process.stdin.close()
    assert process.wait() == 0
    return np.array(taken[1:])


def rate(*words: str | Path, told: Path, answers: Path) -> str:
    """Lines per second, without the start of the process, which reads the first line alone."""
    first = told.with_suffix(".first")
    first.write_bytes(told.read_bytes().splitlines(keepends=True)[0])
    begins = seconds(*words, told=first, answers=answers)
    for left in answers.parent.glob("*.mcap"):
        left.unlink()
    took = seconds(*words, told=told, answers=answers) - begins
    return f"begins in {begins:.2f} s, {TOLD / took:,.0f} lines per second"


def main() -> None:
    folder = Path(tempfile.mkdtemp())
    scenario, samples = folder / "mine.toml", folder / "samples"
    scenario.write_text(SCENARIO)
    taken = round_trips(scenario, samples) * 1e6
    print(
        f"filter: {np.median(taken):.0f} us a sample, 1 of 100 above {np.quantile(taken, 0.99):.0f}"
    )
    samples.write_bytes(samples.read_bytes() * (TOLD // SAMPLES))
    answers, seen, mcap = folder / "answers", folder / "seen", folder / "seen.mcap"
    print("filter:", rate("filter", scenario, told=samples, answers=answers))
    print("monitor:", rate("monitor", told=answers, answers=seen))
    print("monitor --mcap:", rate("monitor", "--mcap", mcap, told=answers, answers=seen))
    print(f"MCAP: {mcap.stat().st_size / TOLD:.0f} bytes a decision")


if __name__ == "__main__":
    main()
