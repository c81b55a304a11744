"""A safety filter whose kernel stays in its file: the bits of one in memory, from few chunks."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SimulationError
from tests.carts import BOX, WALLS, cart, swinging

MARGIN = 0.1


def found(times=None, precision="float64"):
    grid = hf.grid(cart(), BOX, 301)
    return hf.discriminating_kernel(
        cart(), WALLS, grid, 0.4, scheme="upwind", times=times, precision=precision
    )


@pytest.fixture(scope="module", params=["last", "times", "single"])
def both(request, tmp_path_factory):
    value = {
        "last": lambda: found(),
        "times": lambda: found([0, 0.2, 0.4]),
        "single": lambda: found(precision="float32"),
    }[request.param]()
    path = value.save(tmp_path_factory.mktemp("kernels") / "kernel.nc")
    return value, hf.load(path, lazy=True)


def filters(both, **options):
    return [hf.SafetyFilter(cart(), v, margin=MARGIN, **options) for v in both]


def test_every_decision_has_the_bits_of_the_kernel_in_memory(both):
    rng = np.random.default_rng(2)
    inside, stored = filters(both)
    state = np.array([0.2, 0.3])
    for k in range(18):
        command = [float(np.sin(k / 5))]
        a, b = (f.step(state, command) for f in (inside, stored))
        assert a.input.tobytes() == b.input.tobytes()
        assert (a.value, a.slack, a.status) == (b.value, b.slack, b.status)
        state = state + 0.02 * np.array([state[1], a.input[0] + rng.uniform(-0.5, 0.5)])
    outside = [f.step([5.0, 0.0], [0.0]) for f in (inside, stored)]
    assert a.status is not outside[0].status is outside[1].status
    assert outside[0].input.tobytes() == outside[1].input.tobytes()


def test_many_states_have_the_same_bits(both):
    rng = np.random.default_rng(3)
    states, commands = rng.uniform(-1.4, 1.4, (200, 2)), rng.uniform(-1, 1, (200, 1))
    a, b = (f.step_many(states, commands) for f in filters(both))
    for one, other in zip(a, b, strict=True):
        same = one == other if isinstance(one, tuple) else one.tobytes() == other.tobytes()
        assert same


def test_an_observer_before_the_filter_changes_nothing(both):
    inside, stored = filters(both, states=["x"])
    for k in range(30):
        a, b = (f.step([0.5 + 0.004 * k], [0.4]) for f in (inside, stored))
        assert a.input.tobytes() == b.input.tobytes()


def test_a_filter_reads_the_chunks_of_the_cells_that_it_visits(tmp_path):
    """Of 90,000 nodes of one kernel in 9 chunks or more, a vehicle that rests needs one to four."""
    path = found().save(tmp_path / "kernel.nc")
    value = hf.load(path, lazy=True)
    keep = hf.SafetyFilter(cart(), value, margin=MARGIN)
    assert value.stored.bytes_read == 0
    keep.step([0.5, 0.1], [1.0])
    read = value.stored.chunks_read
    assert 1 <= read <= 4
    for _ in range(20):
        keep.step([0.5, 0.1], [1.0])
    assert value.stored.chunks_read == read


def test_the_default_margin_is_that_of_the_kernel_in_memory(both):
    a, b = (hf.sampled_margin(cart(), v, 0.02) for v in both)
    assert a == b


def test_runs_under_the_law_read_the_table_as_a_whole(both, monkeypatch):
    laws = [hf.safety_law(cart(), v, swinging(), margin=MARGIN) for v in both]
    options = {"starts": [[0.2, 0.3], [-0.4, 0.6]], "horizon": 0.4, "region": WALLS}
    runs = [hf.simulate(cart(), law, **options) for law in laws]
    for name in ("state", "input", "mode"):
        a, b = (r.arrays[name].values for r in runs)
        assert a.tobytes() == b.tobytes()
    law = hf.safety_law(cart(), both[1], swinging(), margin=MARGIN)
    monkeypatch.setattr("holdfast.execution.table_in_parts.check_memory", refused)
    with pytest.raises(SimulationError, match="GiB"):
        hf.simulate(cart(), law, **options)


def refused(size, what, remedy):
    raise SimulationError(f"{what} take {size / 2**30:.3g} GiB", remedy=remedy)


def test_pages_are_given_back_when_they_are_many(both):
    inside, stored = filters((both[0], both[1]))
    table = stored.law.lookup.table[0]
    table.source.room = 2 * 4096
    rng = np.random.default_rng(4)
    for state in rng.uniform(-1, 1, (40, 2)):
        a, b = (f.step(state, [0.3], 0.0) for f in (inside, stored))
        assert a.input.tobytes() == b.input.tobytes()
    assert table._pages <= 60
    assert sum(map(len, table._fetched)) < 60
