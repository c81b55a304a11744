"""The programs of docs/coming_from.md: the same problem in another tool and here, and how far apart
their answers are.

python -m pip install -e ".[benchmark]" && python benchmarks/coming_from.py
"""

from __future__ import annotations

import runpy
import warnings
from pathlib import Path
from typing import Any

import numpy as np

PROGRAMS = Path(__file__).parent / "side_by_side"
PEERS = ("hj_reachability", "cbfpy", "control", "casadi")
"""Names of the packages."""


def run(peer: str, half: str) -> dict[str, Any]:
    """What the program of one half, "peer" or "ours", computes, by the names of its variables."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cbfpy has advice on settings of JAX
        return runpy.run_path(str(PROGRAMS / f"{peer}_{half}.py"))


def apart(peer: str, theirs: dict[str, Any], ours: dict[str, Any]) -> dict[str, float]:
    """How far apart the two answers are, each with its name."""
    if peer == "hj_reachability":
        avoid, reach = (np.asarray(theirs[n]) for n in ("avoid", "reach"))
        differs = (reach < 0) != (ours["reach"] > 0)
        return {
            "nodes": avoid.size,
            "avoid: nodes that differ": int(((avoid <= 0) != (ours["avoid"] <= 0)).sum()),
            "avoid: 99 % of the values within [m]": np.quantile(
                np.abs(avoid - ours["avoid"]), 0.99
            ),
            "reach: nodes that differ": int(differs.sum()),
            "reach: these are as near to the boundary as [m]": np.abs(ours["reach"][differs]).max(),
        }
    name = {"cbfpy": "path", "control": "angles", "casadi": "least"}[peer]
    differences = np.asarray(ours[name]) - np.asarray(theirs[name])
    if peer == "casadi":
        return {f"from start {k}: later by [s]": s for k, s in enumerate(differences)}
    return {"largest difference": np.abs(differences).max()}


def main() -> None:
    for peer in PEERS:
        print(peer)
        for what, number in apart(peer, run(peer, "peer"), run(peer, "ours")).items():
            print(f"    {what}: {number:.4g}")


if __name__ == "__main__":
    main()
