"""What sampling rate and what delay the safeguards and the filters over kernels stand.

Every law runs from the same starts at several sampling rates and delays; printed is how many runs
never leave the view. The filters over the kernel in six states run from moving starts of which the
kernel says that they can be kept by 2 cm (two kernels of three minutes, computed once).

  python benchmarks/sampling.py [starts]
"""

import sys
import warnings
from collections.abc import Callable

import holdfast as hf
from holdfast.errors import GainWarning
from holdfast.maths.control.safety_filter import longest_hold
from holdfast.studies.comparison import variant

LAWS = {
    "legs": ("ch5-rescue", "5 N"),
    "legs, 0.3 N": ("ch5-rescue", "0.3 N"),
    "legs, wrong model": ("ch5-rescue", "worst_model"),
    "legs, current": ("measured", "current_of_10"),
    "convergent (5.18)": ("safeguarded", "5 N"),
}
"""Title -> safeguarded law and case of `holdfast compare ch5-rescue`; the legs of `inspection`."""
FILTERS = {
    "5 N": "5 N",
    "1 N": "1 N",
}
"""Title -> case of `holdfast compare ch7-rescue`."""
GAINS = (1.5, 8.0)
"""Of the safeguards [1/s]."""
PERIODS = (0.01, 0.02, 0.05, 0.1, 0.2)
DELAYS = (0.0, 0.05, 0.1, 0.2, 0.3)
STEP = 0.01  # of the integration [s]


def viable(law: str, case: str, period: float, delay: float, starts: int) -> int:
    """How many of so many random starts stay in view, sampled and delayed like that."""
    longest = longest_hold(GAINS, (2,))
    changes = timing(period, delay, 150)
    if period > longest:  # larger gains are refused
        most = [k * longest / period * (1 - 1e-9) for k in GAINS]
        changes.append(f"safeguard.gains={most!r}")
    return variant("ch5-rescue", law, case, starts, changes).run().viable


def kept(case: str, period: float, delay: float, starts: int) -> tuple[int, int]:
    """How many stay under the filter, and of how many that can, of ten times so many starts."""
    rate = min(10.0, 1 / (period + delay))  # the largest without a prediction
    changes = [*timing(period, delay, 3), f"compare.laws.filter.safety.rate={rate!r}"]
    found = hf.compare("ch7-rescue", ["filter"], [case], runs=10 * starts, overrides=changes)
    stayed = found.of_kernel("filter", case)
    assert stayed is not None
    return stayed.count, stayed.total


def timing(period: float, delay: float, horizon: float) -> list[str]:
    """The overrides of a closed loop that is sampled and delayed like that."""
    values = {
        "sample_time": period, "delay": delay, "substeps": max(1, round(period / STEP)),
        "record_every": float(horizon),
    }  # fmt: skip
    return [f"run.{key}={value}" for key, value in values.items()]


def table(title: str, cell: Callable[[float, float], int]) -> None:
    print(f"\n{title}\n{'':>10}", end="")
    print("".join(f"{f'{d:g} s':>8}" for d in DELAYS), " (delay)")
    for period in PERIODS:
        print(f"{1 / period:>7.0f} Hz", end="")
        for delay in DELAYS:
            shown = cell(period, delay) if whole(delay, period) else ""
            print(f"{shown:>8}", end="", flush=True)
        print()


def main() -> None:
    warnings.simplefilter("ignore", GainWarning)  # of delays that are tried on purpose
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 600
    for title, (law, case) in LAWS.items():
        table(f"{title}: viable of {starts}", lambda p, d, x=(law, case): viable(*x, p, d, starts))
    for title, case in FILTERS.items():
        of = kept(case, PERIODS[0], 0.0, starts)[1]
        table(
            f"{title}: viable of {of} inside", lambda p, d, case=case: kept(case, p, d, starts)[0]
        )


def whole(delay: float, period: float) -> bool:
    """Whether the delay is a whole number of samples."""
    return abs(delay / period - round(delay / period)) < 1e-9


if __name__ == "__main__":
    main()
