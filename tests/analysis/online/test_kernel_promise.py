"""A filter over a kernel says once, and by name, that its promise was not tried or fell short."""

import dataclasses
import warnings

import numpy as np
import pytest

import holdfast as hf

X, U = hf.symbol("x"), hf.symbol("u")
STATE = (hf.Quantity("x"),)
ENDS = hf.Region("ends", STATE, (hf.Inequality("left", -1 - X), hf.Inequality("right", X - 1)))


def drifting():
    """It is driven outwards by x / 2 and steered by at most .1: |x| <= .2 can be held."""
    return hf.System(
        "drifting", STATE, (hf.Quantity("u"),), {"x": X / 2 + U},
        input_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip


def kernel():
    system = drifting()
    return hf.viability_kernel(system, ENDS, hf.grid(system, {"x": (-1.3, 1.3)}, 261), 20)


def false(value):
    """The whole region, as if all of it could be held."""
    numbers = 1 - np.abs(value.grid.axes[0].nodes)
    return dataclasses.replace(value, dataset=value.dataset.assign(value=("x", numbers)))


def said_of(value, times=1):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for _ in range(times):
            hf.SafetyFilter(drifting(), value, margin=0.0)
    return said


@pytest.mark.heavy
def test_kernel_that_was_computed_is_tried_by_its_first_filter_and_remembers_it():
    value = kernel()
    assert value.report.promise_outcome is None
    assert said_of(value) == []
    assert value.report.promise_outcome in ("confirmed", "confirmed from inside")
    assert 0.8 < value.report.promise_share <= 1.0


@pytest.mark.heavy
def test_false_kernel_is_warned_of_once_and_by_name():
    (only,) = said_of(false(kernel()), times=3)
    assert only.category is hf.PromiseFellShortWarning
    assert "of the viability-kernel of 'ends', which the filter keeps, the promise falls" in str(
        only.message
    )
    assert only.filename == __file__


@pytest.mark.heavy
def test_kernel_from_a_file_was_tried_when_it_was_saved_or_is_warned_of(tmp_path):
    value = kernel()
    (only,) = said_of(hf.load(value.save(tmp_path / "untried.nc")), times=2)
    assert only.category is hf.PromiseNotTriedWarning
    assert "kernel = kernel.tried(hf.check_promise(system, kernel, region))" in str(only.message)
    promise = hf.check_promise(drifting(), value, ENDS, runs=50)
    tried = value.tried(promise)
    assert value.report.promise_outcome is None
    loaded = hf.load(tried.save(tmp_path / "tried.nc"))
    assert said_of(loaded) == []
    assert loaded.report.promise_conclusion == promise.conclusion
    assert loaded.report.promise_share == promise.kept_share


@pytest.mark.heavy
def test_promise_that_fell_short_is_remembered_by_the_file(tmp_path):
    value = false(kernel())
    value = value.tried(hf.check_promise(drifting(), value, ENDS, runs=50))
    (only,) = said_of(hf.load(value.save(tmp_path / "false.nc")))
    assert only.category is hf.PromiseFellShortWarning


@pytest.mark.heavy
def test_set_that_is_worn_away_has_to_be_tried_anew():
    system = drifting()
    grid = hf.grid(system, {"x": (-1.3, 1.3)}, 261)
    value = hf.viability_kernel(system, ENDS, grid, 20, estimate_error=True)
    value = value.tried(hf.check_promise(system, value, ENDS, runs=20))
    assert value.inner().report.promise_outcome is None


@pytest.mark.heavy
def test_sample_time_that_trial_runs_do_not_bear_is_warned_of():
    """Of an oscillator whose samples are a tenth of its period; with a margin it is the caller's."""
    x, v, d = (hf.symbol(n) for n in ("x", "v", "d"))
    plain = {n: hf.Quantity(n, "1") for n in ("x", "v", "u", "d")}
    system = hf.System(
        "oscillator", (plain["x"], plain["v"]), (plain["u"],), {"x": v, "v": -16 * x + U + d},
        disturbances=(plain["d"],), input_bounds=hf.Box((-5,), (5,)),
        disturbance_bounds=hf.Box((-2,), (2,)),
    )  # fmt: skip
    sides = hf.Inequality("left", -1 - x), hf.Inequality("right", x - 1)
    region = hf.Region("sides", (plain["x"],), sides)
    box = {"x": (-1.2, 1.2), "v": (-5, 5)}
    grid = hf.grid(system, box, dict.fromkeys(box, 101), {"v": "extrapolated"})
    value = hf.discriminating_kernel(system, region, grid, 6.0)

    def said(**options):
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            hf.SafetyFilter(system, value, **options)
        return [str(w.message) for w in found if w.category is hf.PromiseFellShortWarning]

    assert said(sample_time=0.05) == []
    (message,) = said(sample_time=0.15)
    assert message.startswith("inputs that are held for 0.15 s lose trial runs")
    assert said(sample_time=0.15, margin=0.3) == []
