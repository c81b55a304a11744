"""How much longer is the way of `inspection` than the shortest found from the same start?

Every start is run with many sets of numbers of the law; the shortest of its rescued runs is the
shortest found. All go to the same pose, and
the filter knows the nominal model alone.  python benchmarks/detours.py [starts]
"""

import itertools
import sys

import numpy as np

from holdfast.scenario.load import load_scenario

GRID = {
    "leg_margin": (0.01, 0.02, 0.045, 0.08),
    "far_margin": (0.05, 0.25, 0.5),
    "swing": (0.02, 0.1),
    "exponent": (1.25, 1.5, 2.0),
}


def lengths(runs: int, overrides: list[str]) -> np.ndarray:
    """The length of every path in the plane, infinite where the start was not rescued."""
    changes = ["safeguard.uncertain=", *overrides]
    data = load_scenario("inspection", changes, runs=runs).run().dataset
    steps = [np.diff(data["state"].sel(state_name=n).values, axis=1) for n in ("x", "y")]
    return np.where(data["outcome"].values == 1, np.hypot(*steps).sum(axis=1), np.inf)


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 600
    ours = lengths(runs, [])
    found = ours
    for values in itertools.product(*GRID.values()):
        changed = [f"law.{k}={v}" for k, v in zip(GRID, values, strict=True)]
        found = np.minimum(found, lengths(runs, changed))
    ratio = ours / np.maximum(found, 0.05)  # below 5 cm it is there already
    shares = {bound: np.mean(ratio <= bound) for bound in (1.1, 1.25, 1.5, 2.0)}
    print(f"{np.prod([len(v) for v in GRID.values()])} sets of numbers, {len(ours)} starts")
    print("within", ", ".join(f"{b}: {s:.3f}" for b, s in shares.items()))
    print("median, 99 %, worst:", np.round(np.quantile(ratio, (0.5, 0.99, 1.0)), 2))
    print("rescued:", np.isfinite(ours).mean())


if __name__ == "__main__":
    main()
