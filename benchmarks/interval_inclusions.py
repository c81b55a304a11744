"""Enclosures of random boxes against balls of 60 digits: is a value ever outside?

    python benchmarks/interval_inclusions.py [--boxes 10000000]

writes `benchmarks/interval_inclusions.json`. Every operation and function of `hf.certify` gets the
same number of random boxes, of sizes and widths of many orders, and in each one random point. The
values are those of python-flint.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.ball_arithmetic import OPERATIONS, X, Y, ball, boxes

from holdfast.execution.intervals.enclosure import Enclosure

RECORD = Path(__file__).with_suffix(".json")
BLOCK = 20_000


def missed(name: str, count: int, seed: int) -> tuple[int, int]:
    """(values outside, values that exist) of so many boxes."""
    generator = np.random.default_rng([seed, sum(map(ord, name))])
    enclosure = Enclosure([OPERATIONS[name]], [X, Y])
    outside = judged = 0
    for first in range(0, count, BLOCK):
        low, high = boxes(generator, min(BLOCK, count - first))
        at = np.clip(low + (high - low) * generator.random(low.shape), low, high)
        corner = generator.random(low.shape)
        at = np.where(corner < 0.2, low, np.where(corner > 0.8, high, at))
        least, most = enclosure.over(low, high)
        for a, b, (x, y) in zip(
            least[:, 0].tolist(), most[:, 0].tolist(), at.tolist(), strict=True
        ):
            try:
                value = ball(OPERATIONS[name], {X: x, Y: y})
            except ZeroDivisionError:
                continue
            if value.is_finite():
                judged += 1
                outside += bool(value < a) or bool(value > b)
    return outside, judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boxes", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    each = -(-asked.boxes // len(OPERATIONS))
    begun, found = time.perf_counter(), {}
    for name in OPERATIONS:
        outside, judged = missed(name, each, asked.seed)
        found[name] = {"boxes": each, "values": judged, "outside": outside}
        print(name, found[name], f"{time.perf_counter() - begun:.0f} s", flush=True)
    record = {"seed": asked.seed, "operations": found}
    RECORD.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
