"""How long a law exported as C99 takes, along runs of its scenario, and how much stack it needs.

python benchmarks/exported_law.py
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import holdfast as hf
from holdfast.execution.codegen.c_timing import time_law

NAMES = (
    "ch4-unicycle", "ch3-unknown-current", "ch4-chained-4", "ch5-viable-goal-set", "ch6-chain",
    "inspection", "ch5-rescue",
)  # fmt: skip
RUNS = 4


def stack(text: str) -> int:
    """Bytes on the stack, all functions that remain together."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "law.c").write_text(text)
        subprocess.run(
            ["gcc", "-std=c99", "-O2", "-fstack-usage", "-c", "law.c"], cwd=folder, check=True
        )
        return sum(map(int, re.findall(r"\t(\d+)\t", (Path(folder) / "law.su").read_text())))


def main() -> None:
    print("| law of | modes | lines | stack, bytes | ns a call |\n|---|---|---|---|---|")
    for name in NAMES:
        scenario = hf.load_scenario(name)
        text = hf.export_c(scenario.system, scenario.law, name)
        data = scenario.run(part=range(min(RUNS, scenario.runs))).dataset
        times, states = data["time"].values, data["state"].values
        found = time_law(text, name, times, states, scenario.settings["sample_time"])
        modes = len(getattr(scenario.law, "modes", [1]))
        print(
            f"| `{name}` | {modes} | {len(text.splitlines())} | {stack(text)} "
            f"| {found.nanoseconds:.0f} |"
        )


if __name__ == "__main__":
    main()
