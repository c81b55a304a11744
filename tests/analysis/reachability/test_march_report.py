"""What a march is worth is one record; the attributes of a file are made of it and read into it."""

from dataclasses import asdict, fields, replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.reachability.march_report import Report

X, U = hf.symbol("x"), hf.symbol("u")
SYSTEM = hf.System(
    "line",
    states=(hf.Quantity("x", "m"),),
    inputs=(hf.Quantity("u", "m/s"),),
    rates={"x": U * hf.symbol("gain")},
    input_bounds=hf.Box((-1,), (1,)),
    parameters=(hf.Parameter("gain", value=2.0),),
)
ROOM = hf.Region("room", SYSTEM.states, (hf.Inequality("wall", X**2 - 1, "m^2"),))


@pytest.fixture(scope="module")
def value():
    grid = hf.grid(SYSTEM, {"x": (-1.5, 1.5)}, 21)
    return hf.viability_kernel(SYSTEM, ROOM, grid, horizon=1.0, estimate_error=True)


def test_report_says_what_was_marched(value):
    report = value.report
    assert (report.kind, report.region, report.system) == ("viability-kernel", "room", "line")
    assert report.parameters == {"gain": 2.0}
    assert report.converged is True
    assert report.empty is False
    assert report.error_cells >= 0
    assert report.nodes_from_outside is None, "it was not requested"
    assert report.title is None


def test_share_of_the_nodes_that_a_refined_march_computes_is_below_one():
    grid = hf.grid(SYSTEM, {"x": (-1.5, 1.5)}, 41)
    value = hf.viability_kernel(SYSTEM, ROOM, grid, horizon=1.0, refine=4)
    assert 0 < value.report.marched_share < 1


def test_attributes_and_report_are_one_another(value, tmp_path):
    assert Report.read(value.report.attributes()) == value.report
    assert hf.load(value.save(tmp_path / "v.nc")).report == value.report
    numbers = {k: v for k, v in value.dataset.attrs.items() if not isinstance(v, str)}
    assert all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in numbers.values())


@pytest.mark.few(
    "horizon_s",
    "reached_s",
    "start_time_s",
    "converged",
    "ended_early",
    "begun_from_another",
    "residual_cells",
    "scheme",
    "dissipation",
    "cfl",
    "precision",
    "refine",
    "marched_share",
    "parameters",
    "disturbance",
    "definition",
    "volume_coarse",
    "error_reach",
    "nodes_from_outside",
    "nodes_kept_outside",
    "promise_outcome",
    "promise_conclusion",
    "promise_share",
)
@pytest.mark.parametrize("one", fields(Report), ids=lambda f: f.name)
def test_every_entry_survives_the_file(one, value, tmp_path):
    """Each entry, changed from its default, comes back with its value and its type."""
    before = getattr(Report(), one.name)
    changed = {
        bool: True, int: 7, float: 0.25, str: "text", dict: {"a": 1.5}, type(None): 3
    }[type(before)]  # fmt: skip
    found = hf.load(value.reported(**{one.name: changed}).save(tmp_path / "v.nc")).report
    assert getattr(found, one.name) == changed
    assert type(getattr(found, one.name)) is type(changed)


def test_other_attributes_are_kept_and_missing_ones_have_defaults(value):
    dataset = value.dataset.assign_attrs(mine="kept")
    del dataset.attrs["residual_cells"]  # as in files of older versions
    other = replace(value, dataset=dataset)
    assert other.report.residual_cells is None
    assert other.reported(title="new").dataset.attrs["mine"] == "kept"
    assert asdict(other.reported(title="new").report)["title"] == "new"


def test_none_removes_an_entry(value):
    assert value.report.error_cells is not None
    assert value.reported(error_cells=None).report.error_cells is None
    assert value.report.error_cells is not None


def test_truth_of_an_array_is_written(value, tmp_path):
    """A condition of the caller may answer with NumPy's truth value, which NetCDF refuses."""
    grid = hf.grid(SYSTEM, {"x": (-4, 4)}, 201, {"x": "extrapolated"})
    found = hf.backward_reachable_tube(SYSTEM, ROOM, grid, 1.0, until=lambda v: np.bool_(True))
    assert found.report.ended_early == True  # noqa: E712
    assert hf.load(found.save(tmp_path / "v.nc")).report.ended_early is True


def test_nan_and_infinite_entries_are_read_back(value, tmp_path):
    found = hf.load(value.reported(cell=np.inf, cfl=np.nan).save(tmp_path / "v.nc")).report
    assert found.cell == np.inf
    assert np.isnan(found.cfl)
