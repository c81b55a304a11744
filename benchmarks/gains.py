"""Gains of every shipped scenario whose law has conditions, beside those that `hf.tune` finds.

For each scenario and the cost that it has (time, or clearance without a goal): the gains, their
least slack, and the costs of both from one simulation. Prints the table of docs/gains.md, and
writes its figure. `--only NAME` for some, `--docs FOLDER` for the figure; about five minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

import holdfast as hf
from holdfast.maths.definitions.law import GainCondition
from holdfast.presentation.figures import style
from holdfast.scenario.files import scenario_names
from holdfast.scenario.load import load_scenario

FIGURE = "inspection"
CANDIDATES, MORE = 100, 200
"""Of every scenario, and of the case that the figure shows."""
MODEL = "model"
RECORD = Path(__file__).with_suffix(".json")


@dataclass(frozen=True)
class Row:
    """One scenario, in a case of it or not, and what was found."""

    name: str
    case: str | None
    found: hf.Tuning
    seconds: float

    @property
    def summary(self) -> dict[str, object]:
        """What the page says of it."""
        f = self.found
        costs = {
            w: {n: _number(getattr(c, n)) for n in ("time", "effort", "clearance", "lost")}
            for w, c in (("before", f.before), ("after", f.after))
        }
        slack = {
            "shipped": min(c.slack for c in f.shipped_conditions),
            "tuned": min(c.slack for c in f.conditions),
        }
        least = min(f.shipped_conditions, key=lambda c: c.slack)
        return {
            "scenario": self.name, "case": self.case or "", "cost": f.cost, "gains": dict(f.gains),
            "shipped": dict(f.shipped), "slack": slack, "least": least.condition,
            "where": least.where, "checked": f.checked, "corners": f.corners, **costs,
        }  # fmt: skip


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.4g}")


def tunable() -> list[tuple[str, str | None]]:
    """The scenarios whose laws have conditions; the inspection with its wrong model too."""
    found: list[tuple[str, str | None]] = []
    for name in scenario_names():
        scenario = load_scenario(name)
        if scenario.kind == "closed-loop" and any(map(of_the_law, scenario.law.conditions)):
            found.append((name, None))
    return [*found, ("inspection", MODEL)]


def of_the_law(condition: GainCondition) -> bool:
    """Whether a condition is one on the gains of the law itself, not of its safety filter."""
    symbols = (condition.value + condition.limit).free_symbols
    return not {s.name for s in symbols} & {"kappa1", "kappa2"}


def tuned(name: str, case: str | None) -> Row:
    scenario = load_scenario(name)
    cost = "time" if scenario.goal is not None else "clearance"
    began = time.perf_counter()
    return Row(
        name,
        case,
        hf.tune(name, cost, case=case, candidates=CANDIDATES if case is None else MORE),
        time.perf_counter() - began,
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--only", nargs="*", help="names of scenarios")
    options.add_argument("--docs", type=Path, help="folder of the figure")
    chosen = options.parse_args()
    wanted = [(n, c) for n, c in tunable() if not chosen.only or n in chosen.only]
    with ProcessPoolExecutor(2) as pool:
        names, cases = zip(*wanted, strict=True)
        rows = list(tqdm(pool.map(tuned, names, cases), total=len(wanted)))
    summaries = {(r.name, r.case or ""): r.summary for r in rows}
    if chosen.only:  # the others stay as they are recorded
        kept = {(r["scenario"], r["case"]): r for r in json.loads(RECORD.read_text())}
        every = kept | summaries
        summaries = {key: every[key] for n, c in tunable() if (key := (n, c or "")) in every}
    RECORD.write_text(json.dumps([*summaries.values()], indent=1) + "\n")
    print(table([*summaries.values()]))
    seconds = [row.seconds for row in rows]
    print(f"{sum(seconds):.0f} s, the slowest {max(seconds):.0f} s")
    for row in rows:
        if chosen.docs and (row.name, row.case) == (FIGURE, MODEL):
            for path in style.write(hf.tuning_figure(row.found), chosen.docs, "gains"):
                if path.suffix == ".svg":
                    path.unlink()


def table(rows: list[dict[str, object]]) -> str:
    """The table of the page."""
    lines = [HEADER, "|" + "---|" * 7]
    return "\n".join([*lines, *map(_line, rows)])


HEADER = "| scenario | gains: shipped | gains: tuned | slack | time [s] | effort | clearance |"


def _line(row: dict[str, object]) -> str:
    name = f"`{row['scenario']}`" + (f", case {row['case']}" if row["case"] else "")
    cells = [name, _gains(row["shipped"]), _gains(row["gains"])]
    slack = row["slack"]
    cells.append(f"{slack['shipped']:.2f}, {slack['tuned']:.2f}")  # type: ignore[index]
    for cost in ("time", "effort", "clearance"):
        pair = [row[w][cost] for w in ("before", "after")]  # type: ignore[index]
        cells.append("-" if pair[0] is None else ", ".join(f"{v:.3g}" for v in pair))
    return "| " + " | ".join(cells) + " |"


def _gains(gains: object) -> str:
    assert isinstance(gains, dict)
    return ", ".join(f"{k.removeprefix('law.')} {v:.4g}" for k, v in gains.items())


if __name__ == "__main__":
    main()
