"""What sampling rate and what delay the safeguards of the inspection task stand.

Every law runs from the same starts at several sampling rates and delays; printed is how many runs
never leave the view.  python benchmarks/sampling.py [starts]
"""

import sys

from holdfast.comparing import variant

LAWS = {
    "legs, safeguarded": ("ch5-rescue", "5 N"),
    "legs, safeguarded, 0.3 N": ("ch5-rescue", "0.3 N"),
    "legs, safeguarded, inertia +20 %, drag -20 %": ("ch5-rescue", "worst_model"),
    "legs, safeguarded, current of 0.1 m/s measured": ("measured", "current_of_10"),
    "convergent (5.18), safeguarded": ("safeguarded", "5 N"),
}
"""Title -> law and case of `holdfast compare ch5-rescue`; its legs are those of `inspection`."""
PERIODS = (0.01, 0.02, 0.05, 0.1, 0.2)
DELAYS = (0.0, 0.05, 0.1, 0.2, 0.3)
STEP = 0.01  # of the integration [s]


def viable(law: str, case: str, period: float, delay: float, starts: int) -> int:
    """How many of so many random starts stay in view, sampled and delayed like that."""
    timing = {
        "sample_time": period, "delay": delay, "substeps": max(1, round(period / STEP)),
        "record_every": 150.0,
    }  # fmt: skip
    changes = [f"run.{key}={value}" for key, value in timing.items()]
    return variant("ch5-rescue", law, case, starts, changes).run().viable


def main() -> None:
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 600
    for title, (law, case) in LAWS.items():
        print(f"\n{title}: viable of {starts}\n{'':>10}", end="")
        print("".join(f"{f'{d:g} s':>8}" for d in DELAYS), " (delay)")
        for period in PERIODS:
            found = [
                f"{viable(law, case, period, delay, starts):>8}"
                if whole(delay, period)
                else f"{'':>8}"
                for delay in DELAYS
            ]
            print(f"{1 / period:>7.0f} Hz{''.join(found)}", flush=True)


def whole(delay: float, period: float) -> bool:
    """Whether the delay is a whole number of samples."""
    return abs(delay / period - round(delay / period)) < 1e-9


if __name__ == "__main__":
    main()
