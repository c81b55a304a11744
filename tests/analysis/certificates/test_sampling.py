"""What is not exact about sampling, and laws: in closed loop, and checked by the other program."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError
from holdfast_check.checker import NotValidError, check
from tests.certified_systems import changed

X, V, A, W = (hf.symbol(n) for n in ("x", "v", "a", "w"))
BOX = {"x": (-1, 1), "v": (-2, 2)}


def cart(push=0.2):
    """Between two walls at 1 m, pushed by up to `push`."""
    system = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": V, "v": A + W}, disturbances=(hf.Quantity("w", "m/s^2"),),
        disturbance_bounds=hf.Box((-push,), (push,)), input_bounds=hf.Box((-1.0,), (1.0,)),
    )  # fmt: skip
    walls = (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m"))
    return system, hf.Region("walls", system.states, walls)


def certified(**more):
    return hf.certify(*cart(), box=BOX, cells=81, sample_time=0.2, **more)


def spring(gain, damping, system=None):
    system = system or cart()[0]
    push = {"a": -gain * X - damping * V}
    return hf.Law("spring", system.states, push, empirical="gains are numbers")


def run(found, generator, *, errors=(0.0, 0.0), delay=0.0, count=1500, holds=150):
    """Whether all of so many starts stay between the walls, each of these errors at its worst."""
    cells, hold = found.cells, found.sampling.hold
    table = np.full(int(np.prod(cells.counts)), -1)
    table[found.kept.members] = found.kept.inputs
    low, high = cells.corners(generator.choice(found.kept.members, count))
    q = low + (high - low) * generator.random(low.shape)
    seen, before = q.copy(), np.zeros(count)
    for _ in range(holds):
        place = [np.searchsorted(e, seen[:, k], side="right") - 1
                 for k, e in enumerate(cells.edges)]  # fmt: skip
        inside = all(((p >= 0) & (p < n)).all() for p, n in zip(place, cells.counts, strict=True))
        if not inside or (table[np.ravel_multi_index(place, cells.counts)] < 0).any():
            return False
        a = found.candidates[table[np.ravel_multi_index(place, cells.counts)], 0]
        late = delay * generator.choice([0.0, 1.0], count)
        w = 0.2 * np.sign(q[:, 1] + 1e-9)  # pushed on
        for lasts, u in ((late, before), (hold - late, a)):  # exact, as all is constant
            peak = np.where(u + w == 0, 0, np.clip(-q[:, 1] / (u + w + (u + w == 0)), 0, lasts))
            for t in (peak, lasts):
                x = q[:, 0] + t * q[:, 1] + t**2 / 2 * (u + w)
                if np.abs(x).max() > 1 + 1e-9:
                    return False
            q = np.stack([x, q[:, 1] + lasts * (u + w)], axis=1)
        before = a
        seen = q + np.array(errors) * generator.choice([-1.0, 1.0], q.shape)
    return True


def test_measurement_errors_cost_cells_and_nothing_leaves_with_them(tmp_path):
    errors = {"x": 0.01, "v": 0.02}
    exact, noisy = certified(), certified(errors=errors)
    assert 0.3 < noisy.kept.share < exact.kept.share
    assert run(noisy, np.random.default_rng(1), errors=(0.01, 0.02))
    assert not run(exact, np.random.default_rng(1), errors=(0.01, 0.02))
    path = noisy.write(tmp_path / "noisy.certificate")
    assert "entries hold" in check(str(path))
    with pytest.raises(NotValidError):
        check(str(changed(path, lambda h: h.update(errors=[(0.02).hex(), (0.04).hex()]))))


@pytest.mark.heavy
def test_late_inputs_cost_cells_and_nothing_leaves_with_them(tmp_path):
    exact, late = certified(), certified(delay=0.05)
    assert 0.2 < late.kept.share < exact.kept.share
    assert run(late, np.random.default_rng(2), delay=0.05)
    assert not run(exact, np.random.default_rng(2), delay=0.15)
    path = late.write(tmp_path / "late.certificate")
    assert "entries hold" in check(str(path))
    with pytest.raises(NotValidError):
        check(str(changed(path, lambda h: h.update(delay=(0.1).hex()))))


@pytest.mark.heavy
def test_law_keeps_a_set_and_the_checker_agrees(tmp_path):
    system, walls = cart()
    found = certified(law=spring(0.5, 1))
    assert 0.2 < found.kept.share < certified().kept.share
    assert found.title == "cart in walls, by spring"
    generator = np.random.default_rng(4)
    low, high = found.cells.corners(generator.choice(found.kept.members, 500))
    starts = low + (high - low) * generator.random(low.shape)
    for w in (-0.2, 0.2):
        runs = hf.simulate(
            system, spring(0.5, 1), starts=starts, region=walls, horizon=20, sample_time=0.2,
            substeps=4, record_every=0.2, disturbance={"w": w}, tolerance=1e-9,
        )  # fmt: skip
        assert (runs.dataset["outcome"].values != hf.Outcome.LEFT).all()
    path = found.write(tmp_path / "law.certificate")
    assert "entries hold" in check(str(path))

    def weaker(header):
        header["law"]["modes"] = [[[[], ["greatest(-1, least(1, -x/10 - v/10))"], 0]]]

    with pytest.raises(NotValidError):
        check(str(changed(path, weaker)))

    def other(header):
        header["law"]["modes"] = [[[[], ["-x - q"], 0]]]

    with pytest.raises(NotValidError, match="the undeclared name q"):
        check(str(changed(path, other)))


def test_law_that_does_not_keep_the_walls_has_no_cell():
    assert not len(certified(law=spring(0.01, 0.0)).kept.members)


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"errors": {"y": 0.1}}, "'y', which is no state"),
        ({"errors": {"x": -0.1}}, "x is -0.1"),
        ({"delay": 0.2}, "below the sample time"),
        ({"law": hf.Law("other", cart()[0].states, {"b": X})}, "gives b"),
        ({"law": hf.Law("timed", cart()[0].states, {"a": sp.sin(hf.TIME)})}, "uses t"),
        ({"cells": {"x": [-1, 0, 0.5]}}, "the edges of x are from -1 to 0.5"),
        ({"cells": {"x": [-1, 0, 0, 1]}}, "the edges of x do not grow"),
    ],
)
def test_sampling_that_is_no_sampling_is_refused(more, match):
    given = {"box": BOX, "cells": 11, "sample_time": 0.2, **more}
    with pytest.raises((SimulationError, DefinitionError), match=match):
        hf.certify(*cart(), **given)


def test_cells_that_need_not_be_even_are_certified_and_checked(tmp_path):
    edges = np.concatenate([np.linspace(-1, -0.5, 21), np.linspace(-0.5, 0.5, 16)[1:],
                            np.linspace(0.5, 1, 21)[1:]])  # fmt: skip
    found = hf.certify(*cart(), box=BOX, cells={"x": edges, "v": 61}, sample_time=0.2)
    assert found.kept.share > 0.4
    assert run(found, np.random.default_rng(6))
    assert "entries hold" in check(str(found.write(tmp_path / "uneven.certificate")))
