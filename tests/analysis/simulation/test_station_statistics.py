"""How well a station was held, counted on trajectories drawn by hand."""

import numpy as np
import pytest
import sympy as sp
import xarray as xr

import holdfast as hf
from holdfast.errors import SimulationError

RADIUS, SETTLED = 0.1, 3.0
TIME = np.arange(7.0)  # seconds: the tail is the last four samples


def result(*runs, switches=(), shortest=(), names=("x", "y", "psi")):
    """A result of runs given as (distances, headings); the position turns as it goes."""
    bearing = np.linspace(0.0, 5.0, len(TIME))
    state = np.array(
        [[d * np.cos(bearing), d * np.sin(bearing), psi] for d, psi in np.array(runs, dtype=float)]
    )
    count = len(runs)
    return hf.Result(
        xr.Dataset(
            {
                "state": (("run", "time", "state_name"), np.moveaxis(state, 1, 2)),
                "switches": ("run", np.array(switches or [0] * count)),
                "shortest_dwell": ("run", np.array(shortest or [np.inf] * count)),
            },
            {"time": TIME, "run": np.arange(count), "state_name": ("state_name", list(names))},
        )
    )


def statistics(*runs, radius=RADIUS, settled=SETTLED, heading=0.1, **given):
    return hf.station_statistics(result(*runs, **given), radius, settled=settled, heading=heading)


def only(*runs, **given):
    """The numbers of the one run."""
    found = statistics(*runs, **given)
    return {str(name): found[name].values[0] for name in found.data_vars}


AT_ZERO = np.zeros(len(TIME))


def test_entry_is_the_first_time_in_the_ball_whatever_comes_after():
    """In at 2 s, out at 3 s by 50 mm, in again; the tail begins at 3 s."""
    found = only(([0.9, 0.4, 0.09, 0.15, 0.02, 0.06, 0.05], AT_ZERO))
    assert found["entered"]
    assert found["entry_time"] == 2.0
    assert found["overshoot"] == pytest.approx(0.05)
    assert found["tail_radius"] == pytest.approx(0.15)


def test_overshoot_is_counted_from_the_entry_and_the_tail_from_its_time():
    """Before it entered a run was far outside; between entry and tail it was out by 0.3 m."""
    found = only(([0.9, 0.05, 0.4, 0.03, 0.02, 0.04, 0.01], AT_ZERO))
    assert found["overshoot"] == pytest.approx(0.3)
    assert found["tail_radius"] == pytest.approx(0.04)
    held = only(([0.9, 0.05, 0.04, 0.03, 0.02, 0.04, 0.01], AT_ZERO))
    assert held["overshoot"] == 0.0


def test_ball_includes_its_boundary_and_the_first_sample_counts():
    found = only(([0.1, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3], AT_ZERO), radius=0.1 + 1e-12)
    assert found["entered"]
    assert found["entry_time"] == 0.0
    exact = hf.Result(result((AT_ZERO, AT_ZERO)).dataset.copy(deep=True))
    exact.dataset["state"][0, :, 1] = 0.25  # |(0, 0.25)| is 0.25 in floating point too
    assert bool(hf.station_statistics(exact, 0.25, settled=0.0)["entered"][0])
    assert not bool(hf.station_statistics(exact, 0.2499999, settled=0.0)["entered"][0])


def test_run_that_never_entered_has_no_entry_and_no_overshoot_but_a_tail():
    found = only(([0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3], AT_ZERO))
    assert not found["entered"]
    assert np.isnan(found["entry_time"])
    assert np.isnan(found["overshoot"])
    assert found["tail_radius"] == pytest.approx(0.6)


def test_entering_in_the_last_sample_is_entering():
    found = only(([0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.05], AT_ZERO))
    assert found["entered"]
    assert found["entry_time"] == 6.0
    assert found["overshoot"] == 0.0


@pytest.mark.parametrize(
    ("headings", "share"),
    [
        ([0.05, -0.05, 0.09, -0.09], 1.0),
        ([0.05, 0.11, -0.11, 0.0], 0.5),
        ([2 * np.pi + 0.05, -2 * np.pi - 0.05, 20 * np.pi, 2 * np.pi + 0.2], 0.75),
        ([np.pi, -np.pi, np.pi - 0.05, 3 * np.pi], 0.0),  # astern is not ahead
        ([2 * np.pi - 0.05, -2 * np.pi + 0.05, np.pi + 0.05, -np.pi - 0.05], 0.5),
    ],
)
def test_heading_counts_by_the_angle_to_zero_not_by_its_turns(headings, share):
    """Of the tail alone: before it the heading is zero."""
    psi = [0.0, 0.0, 0.0, *headings]
    assert only((AT_ZERO, psi))["heading_share"] == share


def test_heading_near_pi_counts_where_every_heading_does():
    psi = [0, 0, 0, np.pi, -np.pi, np.pi - 0.01, -np.pi + 0.01]
    assert only((AT_ZERO, psi), heading=np.pi + 1e-9)["heading_share"] == 1.0
    assert only((AT_ZERO, psi), heading=np.pi - 0.005)["heading_share"] == 0.5


def test_tail_begins_with_the_sample_at_its_time_and_may_be_one_sample():
    run = ([0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3], [1, 1, 1, 1, 1, 1, 0])
    assert only(run, settled=6.0)["tail_radius"] == pytest.approx(0.3)
    assert only(run, settled=6.0)["heading_share"] == 1.0
    assert only(run, settled=5.5)["tail_radius"] == pytest.approx(0.3)
    assert only(run, settled=5.0)["tail_radius"] == pytest.approx(0.4)
    assert only(run, settled=0.0)["tail_radius"] == pytest.approx(0.9)


def test_changes_of_mode_are_told_by_the_minute_and_as_dwells():
    """In six seconds: no change, one, and five; the shortest dwell is that of the driver."""
    still = (AT_ZERO, AT_ZERO)
    found = statistics(still, still, still, switches=(0, 1, 5), shortest=(np.inf, np.inf, 0.25))
    assert list(found["switches_per_minute"].values) == [0.0, 10.0, 50.0]
    assert list(found["mean_dwell"].values) == [6.0, 3.0, 1.0]
    assert list(found["shortest_dwell"].values) == [np.inf, np.inf, 0.25]


def test_run_that_diverged_has_an_infinite_tail():
    """In at 1 s, no number from 4 s on; the other run is not touched by it."""
    nan = np.nan
    lost = ([0.9, 0.05, 0.05, 0.05, nan, nan, nan], [0, 0, 0, 0, nan, nan, nan])
    found = statistics(lost, (AT_ZERO, AT_ZERO))
    assert found["entry_time"].values[0] == 1.0
    assert list(found["tail_radius"].values) == [np.inf, 0.0]
    assert list(found["overshoot"].values) == [np.inf, 0.0]
    assert list(found["heading_share"].values) == [0.25, 1.0]
    gone = only(([nan] * 7, [nan] * 7))
    assert not gone["entered"]
    assert gone["tail_radius"] == np.inf
    assert gone["heading_share"] == 0.0


def test_every_run_has_its_own_numbers_and_units():
    far = ([0.9] * 7, AT_ZERO)
    near = ([0.9, 0.9, 0.9, 0.08, 0.08, 0.08, 0.08], [3.0] * 7)
    found = statistics(far, near, far)
    assert list(found["entered"].values) == [False, True, False]
    assert found["tail_radius"].values == pytest.approx([0.9, 0.08, 0.9])
    assert list(found["heading_share"].values) == [1.0, 0.0, 1.0]
    assert list(found["run"].values) == [0, 1, 2]
    assert {n: found[n].attrs["units"] for n in ("entry_time", "tail_radius", "mean_dwell")} == {
        "entry_time": "s",
        "tail_radius": "m",
        "mean_dwell": "s",
    }


def test_states_are_found_by_name():
    """The same run with the heading first."""
    whole = result(([0.9, 0.4, 0.09, 0.15, 0.02, 0.06, 0.05], [0.3] * 7)).dataset
    turned = hf.Result(whole.isel(state_name=[2, 0, 1]))
    ordered = hf.station_statistics(hf.Result(whole), RADIUS, settled=SETTLED)
    xr.testing.assert_identical(hf.station_statistics(turned, RADIUS, settled=SETTLED), ordered)


@pytest.mark.parametrize("missing", ["x", "y", "psi"])
def test_result_without_a_pose_is_refused(missing):
    names = [n if n != missing else "z" for n in ("x", "y", "psi")]
    with pytest.raises(SimulationError, match=f"no state '{missing}'; expected x, y and psi"):
        statistics((AT_ZERO, AT_ZERO), names=names)


@pytest.mark.parametrize("settled", [6.001, np.inf, np.nan])
def test_tail_that_begins_after_the_end_is_refused(settled):
    with pytest.raises(SimulationError, match=r"tail begins at .* s, the runs end at 6 s"):
        statistics((AT_ZERO, AT_ZERO), settled=settled)


@pytest.mark.parametrize("radius", [-0.1, np.nan])
def test_ball_of_no_radius_is_refused(radius):
    with pytest.raises(SimulationError, match="radius"):
        statistics((AT_ZERO, AT_ZERO), radius=radius)


def test_recorded_samples_alone_are_seen():
    """What happens between two of them does not count: a real run through the ball at 1 m/s."""
    system = hf.systems.drifting_unicycle()
    law = hf.Law("ahead", system.states, {"u": sp.S.One, "r": sp.S.Zero})
    found = {}
    for every in (0.02, 0.5):
        run = hf.simulate(
            system, law, starts=[[-0.75, 0, 0]], horizon=2.0, sample_time=0.02, record_every=every
        )
        found[every] = hf.station_statistics(run, 0.1, settled=0.0)
    assert float(found[0.02]["entry_time"][0]) == pytest.approx(0.66)  # 0.65 is between samples
    assert float(found[0.02]["overshoot"][0]) == pytest.approx(1.15)
    assert not bool(found[0.5]["entered"][0])  # x = -0.25, then 0.25
