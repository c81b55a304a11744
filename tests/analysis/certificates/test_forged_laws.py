"""Files of laws that exist nowhere, or on next to nothing, or without a branch, are refused."""

import base64
import os
import random
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import OutputError
from holdfast_check.checker import NotValidError, check
from tests.carts import STATES, WALLS, D, U, V, X, cart
from tests.certified_systems import changed

BOX = {"x": (-1, 1), "v": (-1, 1)}


@pytest.fixture(scope="module")
def braked(tmp_path_factory):
    """u = -3 x - 3 v keeps a cart between its walls: one option, whatever is measured."""
    system = replace(cart(0.1), input_bounds=hf.Box((-2,), (2,)))
    law = hf.Law("braked", system.states, {system.input_names[0]: -3 * X - 3 * V})
    found = hf.certify(system, WALLS, law=law, box=BOX, cells=41, sample_time=0.1)
    return found.write(tmp_path_factory.mktemp("law") / "braked.holdfast")


def with_options(path, of):
    """The file whose law has other options, from those of an honest one: conditions, inputs."""

    def other(header):
        ((_, inputs, mode),) = header["law"]["modes"][0]
        header["law"]["modes"][0] = [[when, inputs, mode] for when in of]

    return str(changed(path, other))


def test_honest_law_is_valid_with_one_option_and_with_two(braked):
    assert "entries hold" in check(str(braked))
    assert "entries hold" in check(with_options(braked, [["x - 1/2"], ["1/2 - x"]]))
    assert "entries hold" in check(
        with_options(braked, [["time_in_mode - 1"], ["1 - time_in_mode"]])
    )


@pytest.mark.parametrize(
    "options",
    [
        [["x - 1/2"]],
        [["x - 1/2"], ["log(-1 - x*x)"]],
        [["x - 1/2"], ["sqrt(-1 - x*x)"]],
        [["x - 1/2"], ["1/(x - x)"]],
        [["x - 1/2"], ["time_in_mode"]],
        [["time_in_mode - 1"]],
        [["1 - time_in_mode"]],
        [["log(-1 - x*x)"]],
    ],
)
def test_law_without_a_branch_is_refused(braked, options):
    with pytest.raises(NotValidError, match="the law does nothing in a part of it"):
        check(with_options(braked, options))


def test_law_at_places_that_a_seed_foretells_is_refused(tmp_path):
    """It is defined within 1e-12 m of 32 places of each cell alone."""
    system = hf.System(
        "line", STATES[:1], (hf.Quantity("u", "m/s"),), {"x": U + D},
        disturbances=(hf.Quantity("d", "m/s"),), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    law = hf.Law("to the middle", system.states, {"u": -X})
    path = hf.certify(system, WALLS, law=law, box={"x": (-1, 1)}, cells=20, sample_time=0.5).write(
        tmp_path / "line.holdfast"
    )
    assert "entries hold" in check(str(path))
    edges, options = np.linspace(-1, 1, 21), []
    for cell in range(20):
        chance = random.Random(cell)
        for _ in range(32):
            chance.uniform(-0.1, 0.1)  # the disturbance
            at = sp.Rational(chance.uniform(edges[cell], edges[cell + 1]))
            chance.choice((0, chance.uniform(-3, 5)))  # the time in the mode
            options.append([f"x - ({at}) - 1/10**12", f"({at}) - x - 1/10**12"])
    with pytest.raises(NotValidError, match="the law does nothing in a part of it"):
        check(with_options(path, options))


def test_share_is_drawn_anew_each_time_and_the_seed_is_printed(braked):
    told = {check(str(braked), share=0.1) for _ in range(3)}
    assert len(told) == 3
    seed = int(told.pop().split("drawn with seed ")[1].split(":")[0])
    assert f"seed {seed}" in check(str(braked), share=0.1, seed=seed)


@pytest.mark.parametrize("what", ["entries", "nodes"])
def test_small_file_that_unpacks_to_much_is_refused_in_little_memory(braked, what):
    def much(header):
        packed = base64.b64encode(zlib.compress(bytes(50_000_000), 9)).decode()
        header["law"]["table"] = {
            "axes": [["x", [(0.0).hex(), (1.0).hex()], 6_250_000, False]],
            "nodes": {"_V": [packed, packed]},
        }

    def many(content):
        return content[:10] * 5_000_000

    forged = (
        changed(braked, much) if what == "nodes" else changed(braked, lambda h: None, entries=many)
    )
    tracemalloc.start()
    try:
        with pytest.raises(NotValidError, match="unpacks to more than"):
            check(str(forged))
        with pytest.raises(OutputError, match="unpacks to more than"):
            hf.read_certificate(forged)
        assert tracemalloc.get_traced_memory()[1] < 30_000_000
    finally:
        tracemalloc.stop()


def test_device_without_an_end_is_no_file():
    with pytest.raises(OSError, match="no file"):
        check(os.devnull)
    with pytest.raises(OutputError, match="is no file"):
        hf.read_certificate(os.devnull)
