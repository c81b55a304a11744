"""Attack holdfast with random problems, and say what is not so.

    python benchmarks/attack.py --minutes 30 --seed 1
    python benchmarks/attack.py --kind kernels --count 200 --seed 7
    python benchmarks/attack.py --kind filters --only 15 --seed 1
    python benchmarks/attack.py --planted
    python benchmarks/attack.py --sum one/table.json other/table.json --out both

Every case follows from (seed, number). Faults are shrunk to files that run alone (--out), one for
each kind of thing that is wrong. Exit status 1 if there is a fault.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from attacks import engine, planted


def main() -> int:
    names = [k.name for k in engine.kinds()]
    ask = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    ask.add_argument(
        "--minutes", type=float, help="wall time of the cases; what is found is shrunk after it"
    )
    ask.add_argument("--count", type=int, help="cases of each kind, in place of --minutes")
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument(
        "--kind", action="append", choices=names, help="only this kind (again: several)"
    )
    ask.add_argument("--first", type=int, default=0, help="number of the first case")
    ask.add_argument("--only", type=int, help="one case, in this process")
    ask.add_argument("--workers", type=int, default=2)
    ask.add_argument(
        "--out", type=Path, default=Path("attack"), help="folder of the faults and the table"
    )
    ask.add_argument(
        "--planted",
        action="store_true",
        help="break the product on purpose: is every breakage found?",
    )
    ask.add_argument(
        "--sum", type=Path, nargs="+", metavar="TABLE", help="add up the tables of several runs"
    )
    asked = ask.parse_args()
    chosen = [k for k in engine.kinds() if not asked.kind or k.name in asked.kind]
    if asked.planted:
        return planted.prove(asked.workers)
    if asked.only is not None:
        for kind in chosen:
            print(kind.name, kind.attempt(asked.seed, asked.only))
        return 0
    if asked.minutes is None and asked.count is None:
        asked.minutes = 30.0
    if asked.sum:
        tallies, written = engine.summed(asked.sum), []
    else:
        tallies = engine.run(
            chosen, asked.seed, minutes=asked.minutes, count=asked.count, workers=asked.workers,
            first=asked.first, progress=True,
        )  # fmt: skip
        written = engine.write_faults(tallies, asked.seed, asked.out)
    asked.out.mkdir(parents=True, exist_ok=True)
    (asked.out / "table.json").write_text(engine.as_json(tallies, asked.seed), "utf-8")
    print(engine.table(tallies))
    for path in written:
        print(path)
    return int(any(t.faults for t in tallies.values()))


if __name__ == "__main__":
    sys.exit(main())
