"""A safety filter whose kernel stays in its file: the bits of one in memory, from few chunks."""

import gc
import weakref

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.safety import safety_filter
from holdfast.errors import OutputError, SimulationError
from holdfast.execution import table_in_parts
from holdfast.execution.simulation import blocks
from tests.carts import BOX, STATES, WALLS, X, cart, swinging

MARGIN = 0.1

pytestmark = pytest.mark.filterwarnings(  # the walls bound no speed: the set goes on beyond any box
    "ignore:of the .* of 'walls', which the filter keeps:holdfast.errors.PromiseFellShortWarning"
)


def found(times=None, precision="float64"):
    grid = hf.grid(cart(), BOX, 301)
    value = hf.discriminating_kernel(
        cart(), WALLS, grid, 0.4, scheme="upwind", times=times, precision=precision
    )
    return value.tried(hf.check_promise(cart(), value, WALLS, runs=20))


HEAVY = [pytest.param(name, marks=pytest.mark.heavy) for name in ("last", "single")]


@pytest.fixture(scope="module", params=["times", *HEAVY])
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


@pytest.fixture(autouse=True)
def by_slopes(monkeypatch):
    """Values in a file are looked up with their slopes: those in memory are compared like this."""
    monkeypatch.setattr(safety_filter, "sampled_value", lambda *of: None)


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


def kept_laws(both, law=None, **options):
    options = {"margin": MARGIN} | options
    return [hf.safety_law(cart(), v, law or swinging(), **options) for v in both]


def turns():
    """Two modes that change often."""
    laws = {n: hf.Law(n, STATES, {"u": sp.Float(u)}) for n, u in (("push", 0.9), ("pull", -0.9))}
    there = hf.Transition("push", "pull", X - 0.5)
    back = hf.Transition("pull", "push", -X - 0.5)
    return hf.Switching("turns", laws, (there, back), initial="push")


RUNS = {
    "plain": {},
    "late and noisy": {"delay": 0.04, "noise_normal": {"x": 0.01}, "seed": 3},
    "continuous": {"continuous": True},
    "adaptive steps": {"stepper": "dormand-prince"},
    "one thread": {"threads": 1},
}


@pytest.mark.few(
    "last-swinging-one thread",
    "last-turns-one thread",
    "times-swinging-one thread",
    "times-turns-one thread",
    "single-swinging-one thread",
    "single-turns-one thread",
)
@pytest.mark.parametrize("options", RUNS.values(), ids=RUNS)
@pytest.mark.parametrize("law", [swinging, turns])
def test_runs_that_fetch_what_they_look_up_have_the_same_bits(both, monkeypatch, law, options):
    monkeypatch.setattr(table_in_parts, "is_room_for", lambda needed: False)
    starts = np.random.default_rng(5).uniform(-0.9, 0.9, (40, 2))
    starts[3] = [1.2, 1.7]  # soon outside the grid
    options = {"starts": starts, "horizon": 0.4, "start_outside": True} | options
    options |= {"region": WALLS, "disturbance": {"d": 0.4}}
    inside, stored = (hf.simulate(cart(), k, **options) for k in kept_laws(both, law()))
    same_runs(inside, stored)


def same_runs(one, other):
    assert {"state", "input", "exit_time"} <= {*one.arrays.variables}
    for name in one.arrays.variables:
        assert one.arrays[name].values.tobytes() == other.arrays[name].values.tobytes()


def test_runs_that_are_handed_commands_have_the_same_bits(both, monkeypatch):
    monkeypatch.setattr(table_in_parts, "is_room_for", lambda needed: False)
    starts = np.random.default_rng(6).uniform(-0.9, 0.9, (20, 2))
    options = {"starts": starts, "horizon": 0.4, "command": lambda t, q: np.sin(9 * q[:, :1])}
    same_runs(*(hf.simulate(cart(), f.law, **options) for f in filters(both)))


def test_few_runs_read_some_chunks_and_many_the_whole_table(tmp_path):
    assert (table_in_parts.BYTES_A_SECOND, table_in_parts.SECONDS_OF_A_FETCH) == (250e6, 1e-3)
    path = found().save(tmp_path / "kernel.nc")
    law = kept_laws([hf.load(path, lazy=True)])[0]
    table = law.lookup.table[0]
    options = {"horizon": 0.1, "sample_time": 0.02}
    hf.simulate(cart(), law, starts=[[0.2, 0.3]], **options)
    assert table._whole is not None  # it is small
    table._whole = None
    table.source.stored.bytes_read = 0
    with pytest.MonkeyPatch.context() as slow:
        slow.setattr(table_in_parts, "BYTES_A_SECOND", 1e6)
        hf.simulate(cart(), law, starts=[[0.2, 0.3]], **options)
        assert table._whole is None
        assert 0 < table.source.stored.bytes_read < table.nbytes / 2
        hf.simulate(cart(), law, starts=[[0.2, 0.3]] * 16 * 200, **options)
        assert table._whole is not None


def test_a_law_that_is_forgotten_gives_its_pages_back_at_once(both, monkeypatch):
    monkeypatch.setattr(table_in_parts, "is_room_for", lambda needed: False)

    def simulated():
        law = kept_laws(both)[1]
        hf.simulate(cart(), law, starts=[[0.2, 0.3]] * 40, horizon=0.1)
        return weakref.ref(law.lookup.table[0])

    def stepped():
        keep = filters(both)[1]
        keep.step([0.2, 0.3], [0.1])
        return weakref.ref(keep.law.lookup.table[0])

    gc.collect()
    gc.disable()
    try:
        assert simulated()() is None
        assert stepped()() is None
    finally:
        gc.enable()


def test_a_damaged_part_of_the_file_ends_the_runs_and_the_filter(both, monkeypatch):
    monkeypatch.setattr(table_in_parts, "is_room_for", lambda needed: False)

    def damaged(nodes):
        raise OutputError("a part is damaged")

    for few in (1, 400):
        law = kept_laws(both)[1]
        monkeypatch.setattr(law.lookup.table[0].source, "take", damaged)
        with pytest.raises(OutputError, match="a part is damaged"):
            hf.simulate(cart(), law, starts=[[0.2, 0.3]] * few, horizon=0.4)
    keep = filters(both, states=["x"])[1]
    source = keep.law.lookup.table[0].source
    first = keep.step([0.2], [0.1])
    with monkeypatch.context() as inside:
        inside.setattr(source, "take", damaged)
        with pytest.raises(OutputError, match="a part is damaged"):
            keep.step([-0.9], [0.1])
    again = filters(both, states=["x"])[0]
    assert again.step([0.2], [0.1]).input.tobytes() == first.input.tobytes()
    assert again.step([-0.8], [0.1], 0.02).input == keep.step([-0.8], [0.1], 0.02).input


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interruption_before_the_first_line_of_a_look_up_is_not_lost(both, monkeypatch):
    """Python raises it in a function that C calls, and goes on."""
    monkeypatch.setattr(table_in_parts, "is_room_for", lambda needed: False)
    made, left = blocks._fetching, []

    def interrupted(*of):
        called = made(*of)

        def first(*given):
            if left.pop():
                raise KeyboardInterrupt
            called(*given)

        return first

    monkeypatch.setattr(blocks, "_fetching", interrupted)
    for options, seen in (({}, [0.1, 0.2]), ({"states": ["x"]}, [0.1])):
        inside, stored = filters(both, **options)
        left[:] = [False, True]
        with pytest.raises(KeyboardInterrupt):
            stored.step(seen, [0.3], 0.0)
        a, b = (f.step(seen, [0.3], 0.0) for f in (inside, stored))
        assert a.input.tobytes() == b.input.tobytes()
        assert a.status is b.status
    left[:] = [False, True, False, False]
    with pytest.raises(KeyboardInterrupt):
        hf.simulate(
            cart(), filters(both)[1].law, starts=[[0.1, 0.2]], horizon=0.4,
            command=lambda t, q: q[:, :1],
        )  # fmt: skip


def refused(size, what, remedy):
    raise SimulationError(f"{what} take {size / 2**30:.3g} GiB", remedy=remedy)


def test_the_table_of_a_law_in_c_is_written_part_by_part(both, tmp_path, monkeypatch):
    monkeypatch.setattr(table_in_parts, "check_memory", refused)
    files = [tmp_path / name for name in ("inside.bin", "stored.bin")]
    sources = []
    for law, path in zip(kept_laws(both), files, strict=True):
        hf.export_c_table(law, path)
        sources.append(hf.export_c(cart(), law, "kept", table="file"))
    assert files[0].read_bytes() == files[1].read_bytes()
    assert sources[0] == sources[1]
    with pytest.raises(SimulationError, match="GiB"):
        hf.export_c(cart(), kept_laws(both)[1], "kept", table="text")


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
