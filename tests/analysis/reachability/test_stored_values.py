"""Values that stay in their file: the same numbers, of which only what is asked for is read."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from importlib import import_module
from threading import Thread

import netCDF4
import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.value_function import ValueFunction, to_value_function
from holdfast.analysis.simulation.files import chunks_of, write_netcdf
from holdfast.errors import OutputError, SimulationError
from holdfast.execution import table_in_parts

load_module = import_module("holdfast.analysis.load")
NAMES = ("x", "y", "theta", "v")
SHAPE = (24, 20, 22, 21)
RNG = np.random.default_rng(5)


def grid(shape=SHAPE):
    states = tuple(
        hf.Quantity(n, "rad", angle=True) if n == "theta" else hf.Quantity(n) for n in NAMES
    )
    system = hf.System("four", states, (), {n: hf.symbol(n) for n in NAMES})
    box = {"x": (-1, 1), "y": (-2, 2), "theta": (-np.pi, np.pi), "v": (0, 3)}
    return hf.grid(system, box, dict(zip(NAMES, shape, strict=True)), {"theta": "periodic"})


def made(times=None, dtype=np.float32, arrival=False):
    on = grid()
    x, y, th, v = np.meshgrid(*(a.nodes for a in on.axes), indexing="ij", sparse=True)
    value = np.maximum(0.7 - np.sqrt(x**2 + y**2) - 0.1 * np.cos(th) * v, -0.5).astype(dtype)
    if times is not None:
        value = np.stack([value - 0.1 * k for k in range(len(times))]).astype(dtype)
    first = np.where(value > 0, np.abs(value), np.nan) if arrival else None
    return to_value_function(on, value, Report(kind="viability-kernel"), times=times, arrival=first)


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """A value function in memory, and the same in its file."""
    value = made(arrival=True)
    path = value.save(tmp_path_factory.mktemp("values") / "value.nc")
    return value, path


def opened(both, **options):
    found = hf.load(both[1], lazy=True, **options)
    assert isinstance(found, ValueFunction)
    assert found.stored is not None
    return found


def states(count):
    return np.stack([RNG.uniform(a.low - 0.05, a.high + 0.05, count) for a in grid().axes], axis=1)


def on_nodes(count):
    """States at nodes, and next to them by rounding."""
    at = np.stack([RNG.choice(a.nodes, count) for a in grid().axes], axis=1)
    return np.concatenate([at, np.nextafter(at, 10), np.nextafter(at, -10)])


def test_a_file_is_in_chunks_compressed_and_in_the_precision_of_its_values(both):
    with netCDF4.Dataset(both[1]) as file:
        variable = file["value"]
        assert variable.dtype == np.float32
        assert variable.chunking() == list(chunks_of(SHAPE, NAMES))
        assert variable.filters()["zlib"]
        assert variable.filters()["fletcher32"]
    assert both[1].stat().st_size < both[0].dataset.nbytes / 2


def test_chunks_are_about_as_long_along_every_axis_and_of_one_time():
    assert chunks_of((3, *[31] * 6), ("time", *"abcdef")) == (1, 6, 6, 6, 6, 7, 7)
    for shape in ((1000, 1000), (3, 2000, 4), (31,) * 6, (100_000,), (2, 2, 90_000)):
        chunks = chunks_of(shape, ["d"] * len(shape))
        assert np.prod(chunks) <= 2**16
        assert all(1 <= c <= n for c, n in zip(chunks, shape, strict=True))
        assert np.prod([-(-n // c) for n, c in zip(shape, chunks, strict=True)]) <= 64 * max(
            1, np.prod(shape) // 2**16
        )


def test_opening_reads_no_values(both):
    assert opened(both).stored.bytes_read == 0


@pytest.mark.parametrize("points", [states(300), on_nodes(60)], ids=["between", "on nodes"])
def test_values_slopes_and_least_times_have_the_bits_of_those_in_memory(both, points):
    value, lazy = both[0], opened(both)
    for name in ("at", "gradient", "contains", "least_time"):
        a, b = (getattr(v, name)(points) for v in (value, lazy))
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name


def test_one_state_reads_the_chunks_around_it(both):
    lazy = opened(both)
    lazy.at([[0.1, 0.2, 0.3, 0.4]])
    stored = lazy.stored.values
    assert 1 <= stored.chunks_read <= 2**4
    before = stored.chunks_read
    lazy.gradient([[0.1, 0.2, 0.3, 0.4]])
    lazy.at([[0.1, 0.2, 0.3, 0.4]])
    assert stored.chunks_read - before <= 3**4 - 2**4
    again = stored.chunks_read
    lazy.gradient([[0.1, 0.2, 0.3, 0.4]])
    assert stored.chunks_read == again


def test_a_slice_reads_the_chunks_that_it_crosses(both):
    value, lazy = both[0], opened(both)
    a, b = (v.slice(theta=-2.0, v=0.5) for v in (value, lazy))
    assert np.array_equal(a.values(), b.values())
    chunks = lazy.stored.values.chunks
    across = -(-SHAPE[0] // chunks[0]) * -(-SHAPE[1] // chunks[1])
    assert lazy.stored.values.chunks_read <= 4 * across
    assert lazy.stored.bytes_read < value.values().nbytes


def test_a_small_cache_bounds_what_is_kept_and_changes_nothing(both):
    value, lazy = both[0], opened(both, cache=0)
    points = states(40)
    assert np.array_equal(value.gradient(points), lazy.gradient(points), equal_nan=True)
    for one in points[:8]:
        assert np.array_equal(value.at([one]), lazy.at([one]), equal_nan=True)
    assert len(lazy.stored.values._kept) == 1


def test_what_needs_all_values_has_them(both):
    value, lazy = both[0], opened(both)
    assert lazy.highest() == value.highest()
    assert lazy.stored.bytes_read == 0
    assert lazy.volume() == value.volume()
    assert lazy.extent() == value.extent()
    for names in (("x", "y"), ("theta", "v"), NAMES):
        assert np.array_equal(lazy.projection(*names).values(), value.projection(*names).values())
    assert np.array_equal(lazy.in_memory().values(), value.values())
    assert lazy.in_memory().stored is None


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_several_times_are_read_one_by_one(tmp_path, dtype):
    value = made([0.0, 0.5, 1.0], dtype)
    lazy = hf.load(value.save(tmp_path / "times.nc"), lazy=True)
    points = states(50)
    for time in (None, 0.0, 0.5):
        assert np.array_equal(value.at(points, time), lazy.at(points, time), equal_nan=True)
        assert lazy.highest(time) == value.highest(time)
    assert np.array_equal(lazy.last().at(points), value.at(points), equal_nan=True)
    with pytest.raises(SimulationError, match=r"no value at 0.7 s"):
        lazy.at(points, 0.7)


def test_files_of_before_are_read_lazily_too(tmp_path, both):
    value = made()
    old = write_netcdf(value.dataset, tmp_path / "old.nc")
    lazy, points = hf.load(old, lazy=True), states(30)
    assert np.array_equal(lazy.gradient(points), value.gradient(points), equal_nan=True)
    assert lazy.highest() == value.highest()


def test_a_stored_value_is_written_again_as_it_is(tmp_path, both):
    lazy = opened(both)
    copy = hf.load(lazy.save(tmp_path / "copy.nc"))
    assert np.array_equal(copy.values(), both[0].values())
    assert copy.report == both[0].report
    over = lazy.save(both[1])
    assert np.array_equal(hf.load(over).values(), both[0].values())
    assert np.array_equal(lazy.at(states(1)[:1]).shape, (1,))


def test_a_file_that_is_replaced_does_not_mix_with_the_one_that_is_open(tmp_path):
    first = made()
    path = first.save(tmp_path / "v.nc")
    lazy = hf.load(path, lazy=True)
    made(dtype=np.float64).reported(kind="other").save(path)
    points = states(20)
    assert np.array_equal(lazy.at(points), first.at(points), equal_nan=True)


def test_a_stored_value_is_sent_to_another_process(both):
    lazy = pickle.loads(pickle.dumps(opened(both)))
    points = states(5)
    assert np.array_equal(lazy.at(points), both[0].at(points), equal_nan=True)


def test_a_stored_value_that_was_used_is_sent_and_copied(both):
    lazy, points = opened(both), states(5)
    lazy.at(points)
    for copy in (pickle.loads(pickle.dumps(lazy)), deepcopy(lazy)):
        assert np.array_equal(copy.at(points), both[0].at(points), equal_nan=True)
        assert copy.highest() == both[0].highest()


def test_a_file_that_is_replaced_is_not_read_in_place_of_the_one_that_was_sent(tmp_path):
    path = made().save(tmp_path / "v.nc")
    sent = pickle.dumps(hf.load(path, lazy=True))
    made(dtype=np.float64).save(path)
    with pytest.raises(OutputError, match="is not the file that it was"):
        pickle.loads(sent)


def test_a_file_that_is_written_over_is_not_read_on(tmp_path):
    path = made().save(tmp_path / "v.nc")
    other = made(dtype=np.float64).save(tmp_path / "other.nc")
    lazy = hf.load(path, lazy=True)
    renamed = hf.load(other, lazy=True)
    found = renamed.values().copy()
    other.rename(tmp_path / "renamed.nc")
    assert np.array_equal(renamed.values(), found, equal_nan=True)
    path.write_bytes((tmp_path / "renamed.nc").read_bytes())
    with pytest.raises(OutputError, match="is not the file that it was"):
        lazy.at(states(3))


def test_a_file_that_is_replaced_while_it_is_opened_is_refused(tmp_path, monkeypatch):
    path = made().save(tmp_path / "v.nc")
    read = load_module.read_netcdf

    def replaced(*given):
        found = read(*given)
        made(dtype=np.float64).save(path)
        return found

    monkeypatch.setattr(load_module, "read_netcdf", replaced)
    with pytest.raises(OutputError, match="is not the file that it was"):
        hf.load(path, lazy=True)


def test_a_thread_that_reads_a_table_keeps_its_numbers_until_it_has_read(both, monkeypatch):
    value, lazy = both[0], opened(both, cache=0)
    here, there = states(20), states(20)
    called, others = table_in_parts.called, []

    def interrupted(file, name, *given):
        if name == "slopes_many" and not others:
            others.append(Thread(target=lazy.gradient, args=(there,)))
            others[0].start()
            others[0].join(0.2)
        return called(file, name, *given)

    monkeypatch.setattr(table_in_parts, "called", interrupted)
    found = lazy.gradient(here)
    others[0].join()
    assert np.array_equal(found, value.gradient(here), equal_nan=True)


def test_threads_read_and_write_files_at_the_same_time(tmp_path, both):
    value, lazy = both[0], opened(both, cache=0)
    points = states(30)
    found = value.at(points)

    def saved_and_loaded(k):
        again = hf.load(lazy.save(tmp_path / f"{k}.nc"), lazy=k % 2 > 0)
        return np.array_equal(again.at(points), found, equal_nan=True) and read(k)

    def read(k):
        return np.array_equal(lazy.at(points), found, equal_nan=True)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(saved_and_loaded, range(12)))
        assert all(pool.map(read, range(12)))


@pytest.mark.parametrize("held", [{"x": 0.9130434782608696}, {"x": 0.9}], ids=["node", "between"])
def test_a_part_of_a_value_does_not_have_the_highest_of_the_whole(tmp_path, both, held):
    part = opened(both).slice(**held)
    again = hf.load(part.save(tmp_path / "part.nc"), lazy=True)
    assert again.highest() == part.values().max() < both[0].highest()


def test_numbers_that_another_program_packed_or_turned_are_those_in_memory(tmp_path):
    value = made()
    path = write_netcdf(value.dataset, tmp_path / "v.nc")
    turned = tmp_path / "turned.nc"
    data = value.dataset.copy()
    data["value"] = (NAMES, value.values(), value.dataset["value"].attrs)
    data.attrs["format_version"] = 2
    data.to_netcdf(turned, encoding={"value": {"dtype": ">f4", "_FillValue": np.nan}})
    packed = tmp_path / "packed.nc"
    packing = {"dtype": "i2", "scale_factor": 1e-4, "add_offset": 0.1, "_FillValue": -32768}
    data.to_netcdf(packed, encoding={"value": packing})
    points = states(30)
    for name in (path, turned, packed):
        a, b = (hf.load(name, lazy=lazy).at(points) for lazy in (True, False))
        assert np.array_equal(a, b, equal_nan=True)


def test_a_value_that_is_no_number_is_the_highest_in_the_file_too(tmp_path):
    value = made()
    value.dataset["value"].values[-1, 0, 0, 0] = np.nan
    lazy = hf.load(value.save(tmp_path / "v.nc"), lazy=True)
    assert np.isnan(lazy.highest())
    assert np.isnan(value.highest())


def test_a_highest_that_does_not_fit_is_computed(tmp_path, both):
    for k, odd in enumerate(([1.0, 2.0], "high", 3)):
        path = tmp_path / f"{k}.nc"
        path.write_bytes(both[1].read_bytes())
        with netCDF4.Dataset(path, "a") as file:
            file["value"].highest = odd
        assert hf.load(path, lazy=True).highest() == both[0].highest()


def test_damage_is_noticed_where_it_is_read(tmp_path, both):
    path = tmp_path / "damaged.nc"
    data = bytearray(both[1].read_bytes())
    data[len(data) // 2 : len(data) // 2 + 4000] = b"\x5a" * 4000
    path.write_bytes(data)
    lazy = hf.load(path, lazy=True)
    with pytest.raises(OutputError, match="damaged"):
        lazy.projection("x")


def test_values_too_large_for_the_memory_are_refused_as_a_whole_only(both, monkeypatch):
    monkeypatch.setattr("holdfast.execution.resources.os.sysconf", lambda name: 256)
    lazy = opened(both)
    with pytest.raises(SimulationError, match="needed as a whole"):
        lazy.values()
    assert np.isfinite(lazy.at([[0, 0, 0, 1]])).all()


def test_large_values_stay_in_their_file_unless_asked_otherwise(both, monkeypatch):
    assert hf.load(both[1]).stored is None
    monkeypatch.setattr("holdfast.analysis.load.LARGE", both[0].values().nbytes)
    assert hf.load(both[1]).stored is not None
    assert hf.load(both[1], lazy=False).stored is None
    monkeypatch.setattr("holdfast.analysis.load.LARGE", both[0].values().nbytes + 1)
    assert hf.load(both[1]).stored is None
    monkeypatch.undo()
    from holdfast.analysis.load import LARGE

    assert LARGE == 256 * 2**20
