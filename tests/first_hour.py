"""A person's first hour with holdfast: an installed wheel, an empty folder, a vehicle of their own.

    python first_hour.py

runs as they would: the command line, a vehicle file, a safety filter around a controller of their
own, a kernel, a notebook, and what happens with a mistake. Nothing is imported but what `pip
install` put there, nbclient and ipykernel. What is promised is checked; each step says how long it
took. The exit status is 0 if all of it holds.
"""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

MOWER = """
[scenario]
title = "A mower that keeps off the flower bed"

[system]
states = { x = { unit = "m" }, y = { unit = "m" }, heading = { unit = "rad", angle = true } }
inputs = { turn = { unit = "rad/s", bounds = [-1, 1] } }
rates = { x = "pace*cos(heading)", y = "pace*sin(heading)", heading = "turn" }

[system.parameters]
pace = { value = 0.5, unit = "m/s" }

[region]
constraints = { bed = { expression = "1 - sqrt((x - 3)**2 + y**2)", unit = "m" } }

[law]
outputs = { turn = "2*wrap(atan2(-y, 6 - x) - heading)" }

[starts]
random = 50
box = { x = [-1, 1], y = [-1, 1], heading = ["-90 deg", "90 deg"] }

[run]
horizon = 20
"""

NOTEBOOK = """
import holdfast as hf
from first_hour import mower
vehicle = mower()
display(vehicle)
kernel = hf.load("kernel.nc")
kernel
"""


def command(*words: str, status: int = 0) -> str:
    """What `holdfast` prints; it ends with `status`."""
    line = [sys.executable, "-m", "holdfast", *words]
    done = subprocess.run(line, capture_output=True, text=True)
    text = done.stdout + done.stderr
    assert done.returncode == status, (words, done.returncode, text)
    return text


# -- the vehicle, in Python ------------------------------------------------------------------------


def mower():
    """A mower that goes on at 0.5 m/s and turns."""
    import sympy as sp

    import holdfast as hf

    heading, turn, pace = (hf.symbol(n) for n in ("heading", "turn", "pace"))
    return hf.System(
        "mower",
        (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("heading", "rad", angle=True)),
        (hf.Quantity("turn", "rad/s"),),
        {"x": pace * sp.cos(heading), "y": pace * sp.sin(heading), "heading": turn},
        input_bounds=hf.Box((-1,), (1,)),
        parameters=(hf.Parameter("pace", "m/s", value=0.5),),
    )


def lawn():
    """Outside the flower bed, which is a disc of 1 m around (3, 0), and inside the fence."""
    import sympy as sp

    import holdfast as hf

    x, y = hf.symbol("x"), hf.symbol("y")
    return hf.Region(
        "lawn",
        mower().states,
        (
            hf.Inequality("bed", 1 - sp.sqrt((x - 3) ** 2 + y**2), "m"),
            hf.Inequality("fence across", sp.Abs(y) - 4, "m"),
            hf.Inequality("fence along", sp.Abs(x - 3) - 5, "m"),
        ),
    )


def my_controller(state) -> list[float]:
    """To (6, 0), through the flower bed."""
    x, y, heading = state
    wanted = math.atan2(-y, 6 - x) - heading
    return [2 * math.remainder(wanted, math.tau)]


def clearance(keep, samples: int = 600) -> tuple[float, int]:
    """How far from the bed a run of `my_controller` stays [m], and how many inputs were changed."""
    import holdfast as hf

    plant, least, changed = hf.Plant(mower(), [0.0, 0.05, 0.0], sample_time=0.02), math.inf, 0
    state = plant.state
    for _ in range(samples):
        command = my_controller(state)
        if keep is not None:
            decision = keep.step(state, command)
            command, changed = decision.input, changed + decision.overruled
        state = plant.step(command)
        least = min(least, math.hypot(state[0] - 3, state[1]) - 1)
    return least, changed


# -- the hour --------------------------------------------------------------------------------------


def installed() -> None:
    import holdfast as hf

    assert hf.__version__ in command("--version")
    assert "site-packages" in hf.__file__, hf.__file__


def from_a_file() -> None:
    Path("mower.toml").write_text(MOWER)
    text = command("run", "mower")
    assert "bed" in text, text
    for name in ("result.nc", "summary.json", "paths.png", "histories.png"):
        assert Path("runs/mower", name).stat().st_size > 0, name


def my_controller_kept_safe() -> None:
    import holdfast as hf

    assert clearance(None)[0] < -0.5, "the controller goes through the bed by itself"
    kernel = kernel_of_the_lawn()
    keep = hf.SafetyFilter(mower(), kernel, sample_time=0.02)
    least, changed = clearance(keep)
    assert least > 0, least
    assert 0 < changed < 600
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        keep.reset()
        assert pool.submit(clearance, keep).result() == (least, changed)


def kernel_of_the_lawn():
    import holdfast as hf

    if Path("kernel.nc").exists():
        return hf.load("kernel.nc")
    grid = hf.grid(
        mower(), {"x": (-2.5, 8.5), "y": (-4.5, 4.5), "heading": ("-180 deg", "180 deg")},
        {"x": 56, "y": 46, "heading": 40},
    )  # fmt: skip
    kernel = hf.viability_kernel(mower(), lawn(), grid, 30)
    kernel = kernel.tried(hf.check_promise(mower(), kernel, lawn(), runs=100, horizon=20))
    kernel.save("kernel.nc")
    return kernel


def my_kernel() -> None:

    kernel = kernel_of_the_lawn()
    assert kernel.contains([[0.0, 0.05, 0.0], [3.0, 0.0, 0.0]]).tolist() == [True, False]
    assert kernel.report.promise_outcome == "confirmed from inside", kernel.report
    assert pickle.loads(pickle.dumps(kernel)) == kernel


def in_a_notebook() -> None:
    import nbformat
    from nbclient import NotebookClient

    book = nbformat.v4.new_notebook()
    book.cells = [nbformat.v4.new_code_cell(NOTEBOOK)]
    Path("first_hour.py").write_text(Path(__file__).read_text())
    NotebookClient(book, timeout=300, kernel_name="python3").execute()
    pages = [o["data"].get("text/html", "") for o in book.cells[0]["outputs"] if "data" in o]
    assert len(pages) == 2, [o.get("text") for o in book.cells[0]["outputs"]]
    assert "<math" in pages[0], "the equations of the vehicle"
    assert "<svg" in pages[1] or "<img" in pages[1], "slices of the kernel"
    nbformat.write(book, "first_hour.ipynb")


def mistakes_are_explained() -> None:
    import holdfast as hf
    from holdfast.errors import HoldfastError

    assert "did you mean 'mower'" in command("run", "mowr", status=2)
    for mistake, remedy in (
        (lambda: hf.Inequality("fence", "abs(y) <= 3", "m"), "'abs(y) - 3'"),
        (lambda: hf.SafetyFilter(mower(), lawn(), sample_tme=0.02), "sample_time"),
        (lambda: hf.load_vehicle("oter"), "otter"),
    ):
        message = ""
        try:
            mistake()
        except HoldfastError as error:
            message = str(error)
        assert remedy in message, (remedy, message)


STEPS = (
    installed, from_a_file, my_kernel, my_controller_kept_safe, in_a_notebook,
    mistakes_are_explained,
)  # fmt: skip


def main() -> None:
    seconds = {}
    for step in STEPS:
        began = time.perf_counter()
        step()
        seconds[step.__name__] = round(time.perf_counter() - began, 1)
        print(
            f"  {step.__name__.replace('_', ' '):<26} {seconds[step.__name__]:6.1f} s", flush=True
        )
    Path("first_hour.json").write_text(json.dumps(seconds))


if __name__ == "__main__":
    main()
