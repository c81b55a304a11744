"""Up to which current does the full vehicle with two 5 N thrusters hold station? By search.

Runs of scenario ch3-dynamic with a current of random direction and a speed from 0 to 0.9 m/s,
for several speed limits of the law. A run holds the ball if it enters r0 and stays within
`HELD` metres for the last minute. Reported: the slowest current at which any run failed.

    python benchmarks/largest_current.py [--runs 4000]
"""

from __future__ import annotations

import argparse

import numpy as np
from tqdm import tqdm

import holdfast as hf
from holdfast.scenario.load import load_scenario

HELD = 0.36
SPEED_LIMITS = (0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8)
FASTEST = 0.9


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=4000)
    runs = parser.parse_args().runs
    rows = []
    for limit in tqdm(SPEED_LIMITS, unit="limit"):
        changes = [
            f"law.speed_limit={limit}",
            f"system.current_limit={FASTEST}",
            f"varied.draws.speed={{range = [0, {FASTEST}], unit = 'm/s'}}",
        ]
        result = load_scenario("ch3-dynamic", changes, runs=runs).run()
        found = hf.station_statistics(result, 0.1, settled=60.0)
        speed = result.dataset["varied"].sel(varied_name="speed").values
        held = found["entered"].values & (found["tail_radius"].values <= HELD)
        slowest = speed[~held].min(initial=FASTEST)
        below = speed < slowest
        at = [held[(speed > v - 0.05) & (speed < v)].mean() for v in (0.5, 0.55, 0.6, 0.7, 0.8)]
        rows.append(
            (limit, slowest, int(below.sum()), found["tail_radius"].values[below].max(), at)
        )
    print("speed limit  slowest failure  held below  largest tail   held at up to")
    print("      [m/s]            [m/s]     of those           [m]   .50   .55   .60   .70   .80")
    for limit, slowest, count, tail, at in rows:
        shares = "  ".join(f"{v:.2f}" for v in at)
        print(f"{limit:11.2f} {slowest:16.3f} {count:11d} {tail:13.3f}   {shares}")
    best = max(rows, key=lambda row: row[1])
    print(f"\nheld in every direction up to {best[1]:.2f} m/s, with speed_limit = {best[0]:g} m/s")
    print(f"water speed at full thrust, straight ahead: {full_ahead():.2f} m/s")


def full_ahead() -> float:
    """Xu u + Xuu u^2 + 2 F = 0."""
    value = {p.name: p.value for p in hf.systems.marine_vehicle().parameters}
    roots = np.roots([value["Xuu"], value["Xu"], 2 * value["thrust_limit"]])
    return float(roots.max())


if __name__ == "__main__":
    main()
