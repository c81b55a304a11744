"""The values of a set in a page: one byte each, on the same side of the boundary."""

import zlib

import numpy as np
import pytest
import xarray as xr

import holdfast as hf
from holdfast.analysis.reachability.grid import Axis, Grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import ScenarioError
from holdfast.studies import exploration as module
from holdfast.studies.exploration import check_size, packed_slices


@pytest.fixture(scope="module")
def reached():
    """Velocities within reach after 1, 2 and 3 s, on 15 nodes an axis."""
    return hf.load_scenario(
        "ch7-forward-reach",
        ["grid.nodes=15", "march.horizon=3", 'march.times=["1 s", "2 s", "3 s"]'],
    ).solve()


def unpacked(grid, parts):
    return [
        np.frombuffer(zlib.decompress(p), np.int8).reshape(grid["shape"]).astype(float)
        for p in parts
    ]


def test_every_node_keeps_its_side_and_the_boundary_moves_by_less_than_a_twentieth_of_a_cell(
    reached,
):
    grid, parts, says = packed_slices(reached)
    assert grid["times"] == [1, 2, 3]
    assert says == "its values have one byte each"
    for time, levels in zip(grid["times"], unpacked(grid, parts), strict=True):
        values = reached.values(time)
        np.testing.assert_array_equal(levels > 0, values > 0)
        crossed = (values[:, :, 1:] > 0) != (values[:, :, :-1] > 0)
        before, after = (
            (v[:, :, :-1] / np.where(crossed, v[:, :, :-1] - v[:, :, 1:], 1))[crossed]
            for v in (values, levels)
        )
        assert np.abs(before - after).max() < 0.05


def test_the_last_times_stay_where_not_all_fit(reached, monkeypatch):
    _, parts, _ = packed_slices(reached)
    monkeypatch.setattr(module, "MOST_BYTES_PACKED", len(parts[1]) + len(parts[2]))
    grid, some, says = packed_slices(reached)
    assert (grid["times"], some) == ([2, 3], parts[1:])
    assert says == "its values have one byte each, at 2 of their 3 times"
    monkeypatch.setattr(module, "MOST_BYTES_PACKED", len(parts[2]) - 1)
    with pytest.raises(ScenarioError, match="take fewer nodes"):
        packed_slices(reached)


def test_a_boundary_across_the_seam_of_an_angle_counts():
    """Along a periodic axis the last node is beside the first."""
    angle = Axis(hf.systems.unicycle().states[2], -np.pi, np.pi, 8, "periodic")
    values = np.array([5.0, 4, 3, 2, 1, 0.5, 0.25, -3])
    data = xr.Dataset({"value": (("psi",), values)})
    grid, parts, _ = packed_slices(ValueFunction(data, Grid((angle,))))
    (levels,) = unpacked(grid, parts)
    np.testing.assert_array_equal(levels[[0, 7]], [127, round(-3 * 127 / 5)])


def test_a_grid_that_no_page_can_hold_is_refused_before_its_march():
    check_size("small", module.MOST_NODES)
    with pytest.raises(ScenarioError, match=r"888 million nodes.*at most 134 million"):
        check_size("large", 31**6)
    with pytest.raises(ScenarioError, match="22164 million nodes"):
        hf.explore("ch7-six-states", ["grid.nodes=53"])
