"""A march that is interrupted goes on as if it had not been."""

import itertools
import json
import signal
import subprocess
import sys

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import OutputError, SimulationError

PROBLEM = """
import holdfast as hf
x, v, u = (hf.symbol(n) for n in ("x", "v", "u"))
cart = hf.System(
    "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("u", "m/s^2"),),
    {"x": v, "v": u}, input_bounds=hf.Box((-1,), (1,)),
    parameters=(hf.Parameter("width", "m", value=1.0),),
)
w = hf.symbol("width")
walls = hf.Region(
    "walls", cart.states[:1],
    (hf.Inequality("left", -w - x, "m"), hf.Inequality("right", x - w, "m")), cart.parameters,
)
disc = hf.Inequality("c", x**2 + v**2 - 0.1, "m")
goal = hf.Region("goal", cart.states, (disc,), empirical="a disc of numbers")
grid = hf.grid(cart, {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}, 41)

def basin(**options):
    return hf.capture_basin(
        cart, goal, walls, grid, 1.0, arrival_steps=7, times=[0.3, 0.5], **options)
"""
scope = {}
exec(PROBLEM, scope)
basin, CART, WALLS, GRID = (scope[n] for n in ("basin", "cart", "walls", "grid"))


def steps_in(path):
    with np.load(path) as kept:
        return json.loads(str(kept["said"]))["done"]["steps"]


def interrupted(problem, after, path):
    """The problem, whose process is told to stop after that many steps."""
    count = itertools.count(1)

    def stop(_share):
        if next(count) > after:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        problem(checkpoint=path, checkpoint_every=0, progress=stop)
    assert steps_in(path) == after


def same(one, other):
    """All but how long it took, and how much was skipped."""
    for name in one.dataset.variables:
        a, b = one.dataset[name].values, other.dataset[name].values
        assert np.array_equal(a, b, equal_nan=True), name
    change = {"wall_time_s", "computed_share"}
    a, b = ({k: v for k, v in d.dataset.attrs.items() if k not in change} for d in (one, other))
    return a == b


@pytest.mark.heavy
@pytest.mark.parametrize(
    "writes", [3, *(pytest.param(n, marks=pytest.mark.heavy) for n in (2, 30))]
)
def test_march_killed_while_it_writes_ends_at_the_same_numbers(writes, tmp_path):
    """SIGKILL in the middle of a write: the state before is there, and it goes on from it."""
    path = tmp_path / "basin.checkpoint"
    kill = f"""
import itertools, os, signal
basin()  # compiled, so that only checkpoints are written from here on
count = itertools.count(1)
def fsync(file):
    if next(count) == {writes}:
        os.ftruncate(file, 1000)
        os.kill(os.getpid(), signal.SIGKILL)
os.fsync = fsync
basin(checkpoint={str(path)!r}, checkpoint_every=0)
"""
    ended = subprocess.run([sys.executable, "-c", PROBLEM + kill])
    assert ended.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2  # and what was not finished
    assert steps_in(path) == writes - 2  # the first is written before the first step
    assert same(basin(checkpoint=path), basin())
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("scheme", ["upwind", "eno2", "weno5"])
def test_interrupted_march_ends_at_the_same_numbers(scheme, tmp_path):
    path = tmp_path / "kernel.checkpoint"

    def kernel(**options):
        return hf.viability_kernel(CART, WALLS, GRID, 2.0, scheme=scheme, band=0.3, **options)

    interrupted(kernel, 5, path)
    told = []
    again = kernel(checkpoint=path, progress=told.append)
    whole = kernel()
    assert same(again, whole)
    share = 1.0 if scheme == "upwind" else 0.5  # the filtered march beside it has the second half
    assert sum(s <= share for s in told[:-1]) == whole.dataset.attrs["steps"] - 5


def test_finished_march_is_not_marched_again(tmp_path):
    first = basin(checkpoint=tmp_path)
    assert [f.name for f in tmp_path.iterdir()] == ["capture-basin.checkpoint"]
    told = []
    assert same(basin(checkpoint=tmp_path, progress=told.append), first)
    assert told == [1.0]


@pytest.mark.parametrize(
    ("other", "complaint"),
    [
        ({"horizon": 3.0}, r"the horizon differs, 1\.0 there and 3\.0 here"),
        ({"parameters": {"width": 0.9}}, r"parameter width differs, 1\.0 there and 0\.9 here"),
        ({"scheme": "eno2"}, "scheme differs, 'weno5' there and 'eno2' here"),
        ({"cfl": 0.5}, r"cfl differs, 0\.75 there and 0\.5 here"),
        ({"grid": hf.grid(CART, {"x": (-1.3, 1.3), "v": (-1.8, 1.9)}, 41)}, "the axis v differs"),
        ({"region": scope["goal"]}, "the region differs"),
        ({"times": [0.5]}, r"the times differs, \(\) there and \(0\.5, 1\.0\) here"),
        (
            {"system": hf.System("cart", CART.states, CART.inputs, dict(CART.rates),
                                 input_bounds=hf.Box((-1,), (2,)), parameters=CART.parameters)},
            "the bounds of the inputs differs",
        ),
        (
            {"system": hf.System("cart", CART.states, CART.inputs, {"x": scope["v"], "v": 2 * scope["u"]},
                                 input_bounds=CART.input_bounds, parameters=CART.parameters)},
            "the rate of v differs",
        ),
    ],
)  # fmt: skip
def test_checkpoint_of_another_problem_is_refused(other, complaint, tmp_path):
    path = tmp_path / "a.checkpoint"
    given = {"system": CART, "region": WALLS, "grid": GRID, "horizon": 1.0, "checkpoint": path}
    hf.viability_kernel(**given)
    with pytest.raises(SimulationError, match=f"belongs to another problem: {complaint}"):
        hf.viability_kernel(**given | other)


def test_checkpoints_that_cannot_be_used_are_refused(tmp_path):
    path = tmp_path / "a.checkpoint"
    path.write_text("not one")
    with pytest.raises(SimulationError, match="cannot be read as a checkpoint; remove it to begin"):
        basin(checkpoint=path)
    with pytest.raises(
        OutputError, match=r"cannot be written \(No such file.*; choose a folder that exists"
    ):
        basin(checkpoint=tmp_path / "none" / "a.checkpoint")
    with pytest.raises(SimulationError, match="checkpoint_every without a checkpoint"):
        basin(checkpoint_every=5)
    with pytest.raises(SimulationError, match="checkpoint_every: -1; expected seconds"):
        basin(checkpoint=path, checkpoint_every=-1)
