"""Through how many files does one call go? A newcomer reads as many.

    python benchmarks/roads.py [--list NAME]

Counts the files of holdfast of which a function is entered by one `viability_kernel`, one
`simulate` and one `certify` of a cart between walls, and one `explain` of the unicycle, nothing of
it compiled before; `--list` prints them in the order in which they are entered first. The system
and what is asked of it are built before the count: a user has them, and asks about them.
"""

from __future__ import annotations

import argparse
import inspect
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import holdfast as hf

SOURCE = Path(hf.__file__).parent


def entered(call: Callable[[], Any]) -> list[str]:
    """The files below `src/holdfast` of which functions are entered, in order."""
    files: dict[str, None] = {}

    def looked_at(frame: Any, event: str, _: Any) -> None:
        name = frame.f_code.co_filename
        function = frame.f_code.co_flags & inspect.CO_OPTIMIZED  # and no body of a class
        if event == "call" and function and name.startswith(str(SOURCE)):
            files[str(Path(name).relative_to(SOURCE))] = None

    sys.setprofile(looked_at)
    try:
        call()
    finally:
        sys.setprofile(None)
    return list(files)


def roads() -> dict[str, Callable[[], Any]]:
    x, v, a = (hf.symbol(n) for n in "xva")
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": v, "v": a}, input_bounds=hf.Box((-1.0,), (1.0,)),
    )  # fmt: skip
    limits = (hf.Inequality("l", -1 - x, "m"), hf.Inequality("r", x - 1, "m"))
    walls = hf.Region("walls", cart.states, limits)
    grid = hf.grid(cart, {"x": (-1.5, 1.5), "v": (-2.0, 2.0)}, 41)
    back = hf.Law("back", cart.states, {"a": -1.0 * x - 1.5 * v})
    box = {"x": (-1, 1), "v": (-2, 2)}
    robot = hf.systems.unicycle()
    return {
        "viability_kernel": lambda: hf.viability_kernel(cart, walls, grid, 1.0),
        "simulate": lambda: hf.simulate(cart, back, starts=[[0.5, 0.0]], horizon=1.0, region=walls),
        "explain": lambda: str(hf.explain(robot)),
        "certify": lambda: hf.certify(cart, walls, box=box, cells=21, sample_time=0.2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--list", choices=("viability_kernel", "simulate", "explain", "certify"))
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HOLDFAST_CACHE_DIR"] = folder  # all that has to be compiled is
        for name, call in roads().items():
            if asked.list in (None, name):
                files = entered(call)
                print(f"{name}: {len(files)} files")
                if asked.list:
                    print("\n".join(files))


if __name__ == "__main__":
    main()
