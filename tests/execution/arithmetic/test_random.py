"""Counter-based random numbers: the published answers, and what they are used for."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.execution.codegen.lane_leaves import made, number, philox, two_uniforms, whole
from holdfast.execution.leaf import compiled_leaves


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        (
            (0xFFFFFFFF,) * 4,
            (0xFFFFFFFF,) * 2,
            (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
        ),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_the_published_known_answers(counter, key, words):
    """Random123's known-answer vectors for philox4x32-10."""

    def results(steps, given):
        c, k = [[whole(x) for x in given[array]] for array in "qp"]
        return [number(word) for word in philox(tuple(c), tuple(k))]

    leaves = compiled_leaves({"philox": made(results, q=4, p=2)})
    none, rows = np.zeros(1), (np.array([counter], dtype=float), np.array([key], dtype=float))
    found = leaves.values("philox", 1, 4, none, rows[0], none, rows[1])
    assert tuple(int(w) for w in found[0]) == words


def test_uniform_numbers_fill_the_open_unit_interval_evenly():
    def results(steps, given):
        run, sample, *seed = given["t"]
        return list(two_uniforms(seed, run, sample, 0, 1))

    leaves = compiled_leaves({"uniform": made(results, t=4)})
    asked = np.array([[run, sample, 7, 0] for run in range(100) for sample in range(100)], float)
    none = np.zeros(1)
    values = leaves.values("uniform", len(asked), 2, asked, none, none, none)
    assert values.min() > 0
    assert values.max() < 1
    assert values.mean() == pytest.approx(0.5, abs=0.01)
    assert np.var(values) == pytest.approx(1 / 12, abs=0.002)
    assert abs(np.corrcoef(values.T)[0, 1]) < 0.03


def resting():
    states = (hf.Quantity("x", "m"), hf.Quantity("y", "m"))
    system = hf.System("still", states, (hf.Quantity("u", "m"),), {"x": sp.S.Zero, "y": sp.S.Zero})
    return system, hf.Law("echo", states, {"u": hf.symbol("x") - hf.symbol("y")})


def test_measurement_noise_reaches_the_law_and_not_the_plant():
    system, law = resting()
    data = hf.simulate(
        system,
        law,
        starts=np.zeros((40, 2)),
        horizon=10.0,
        record_every=0.02,
        noise_uniform={"x": 0.3},
        noise_normal={"y": 0.2},
        seed=5,
    ).dataset
    assert not data["state"].values.any()
    u = data["input"].values
    assert u.std() == pytest.approx(np.hypot(0.3 / np.sqrt(3), 0.2), rel=0.02)
    assert u.mean() == pytest.approx(0, abs=0.01)


def test_runs_depend_on_seed_and_index_only():
    system, law = resting()
    settings = {"horizon": 2.0, "record_every": 0.02, "noise_normal": {"x": 0.1}}
    many = hf.simulate(system, law, starts=np.zeros((50, 2)), seed=5, threads=2, **settings)
    one = hf.simulate(system, law, starts=np.zeros((50, 2)), seed=5, threads=1, **settings)
    few = hf.simulate(system, law, starts=np.zeros((3, 2)), seed=5, **settings)
    other = hf.simulate(system, law, starts=np.zeros((3, 2)), seed=6, **settings)
    u = many.dataset["input"].values
    assert np.array_equal(u, one.dataset["input"].values)
    assert np.array_equal(u[:3], few.dataset["input"].values)
    assert not np.array_equal(u[:3], other.dataset["input"].values)
    assert len(np.unique(u)) == u.size


def test_random_starts_lie_in_the_region_and_keep_their_index(vehicle):
    view = hf.regions.camera_view()
    law = hf.Law("idle", vehicle.states, {"tau_u": sp.S.Zero, "tau_r": sp.S.Zero})
    box = {"x": (-2.0, -0.3), "y": (-1.6, 1.6), "psi": (-1.0, 1.0)}

    def drawn(count):
        result = hf.simulate(
            vehicle,
            law,
            starts=hf.Starts(random=count, box=box),
            region=view,
            horizon=0.02,
            record_every=0.02,
            seed=9,
        )
        return result.dataset["state"].values[:, 0], result.dataset["constraint"].values[:, 0]

    states, constraints = drawn(300)
    assert constraints.max() <= 0
    assert np.array_equal(states[:20], drawn(20)[0])
    assert np.ptp(states[:, 0]) > 1.2
    assert not states[:, 3:].any()
