"""What held inputs leave of a constraint: measured, and of the size that is derived."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError

X, Y, A, B = (hf.symbol(n) for n in ("x", "y", "a", "b"))
FAST = 2.0
HOLD, GAIN = 0.1, 5.0
BOX = {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}


@pytest.fixture(scope="module")
def puck():
    """x' = a, y' = b, as fast as 2 m/s each, within a disc."""
    system = hf.System(
        "puck", (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")), {"x": A, "y": B},
        input_bounds=hf.Box((-FAST, -FAST), (FAST, FAST)),
    )  # fmt: skip
    rim = hf.Inequality("rim", X**2 + Y**2 - 1, "m^2")
    return system, hf.Region("disc", system.states, (rim,))


def test_overshoot_over_a_curved_limit_is_of_the_size_that_is_derived(puck):
    """Along the rim d2c/dt2 = 2 (a^2 + b^2), at most 16 m^2/s^2: M T / (2 k1) = 0.16 m^2."""
    keep = hf.SafetyFilter(*puck, gains=(GAIN, GAIN), sample_time=HOLD)
    found = keep.overshoot(BOX)
    assert found.runs == 1000
    assert found.relaxed == 0
    derived = 2 * 2 * FAST**2 * HOLD / (2 * GAIN)
    assert 0.3 * derived < found.crossed["rim"] <= derived
    assert str(found).startswith("in 1000 runs under hostile commands, held for 0.1 s")


def test_filter_says_what_remains_between_samples_and_how_much_where_it_is_known(puck):
    system, disc = puck
    keep = hf.SafetyFilter(system, disc, gains=(GAIN, GAIN), sample_time=HOLD)
    bound = keep.crossings["rim"]
    assert bound == pytest.approx(2 * 2 * FAST**2 * HOLD / (2 * GAIN), rel=1e-9)
    assert keep.overshoot(BOX).crossed["rim"] <= bound
    assert str(keep) == (
        "safety filter of 'puck': keeps 'disc', with inputs held for 0.1 s\n"
        "between samples, 0.1 s apart, constraints may be crossed: 'rim' by at most 0.16; "
        "a margin of that size covers it"
    )
    wide = hf.SafetyFilter(
        system, disc, gains=(GAIN, GAIN), sample_time=HOLD, margins={"rim": 1.01 * bound}
    )
    assert not wide.crossings
    assert wide.overshoot(BOX).crossed["rim"] == 0
    half = hf.SafetyFilter(
        system, disc, gains=(GAIN, GAIN), sample_time=HOLD, margins={"rim": bound / 2}
    )
    assert half.crossings["rim"] == pytest.approx(bound / 2)
    side = hf.Region("strip", system.states, (hf.Inequality("side", X - 1, "m"),))
    flat = hf.SafetyFilter(system, side, gains=(GAIN, GAIN), sample_time=HOLD)
    assert not flat.crossings
    assert "between samples" not in str(flat)


@pytest.mark.heavy
def test_filter_of_order_two_says_that_what_remains_is_to_be_measured(vehicle):
    keep = hf.SafetyFilter(vehicle, hf.regions.camera_view(), gains=(1.5, 8))
    assert set(keep.crossings.values()) == {np.inf}
    assert "by what SafetyFilter.overshoot(box) measures" in str(keep)
    mass = hf.System(
        "mass", (hf.Quantity("x", "m"), hf.Quantity("y", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": Y, "y": A}, input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    wall = hf.Region("wall", mass.states, (hf.Inequality("far", X - 1, "m"),))
    assert not hf.SafetyFilter(mass, wall).crossings


def test_margin_of_the_size_of_the_overshoot_covers_it(puck):
    plain = hf.SafetyFilter(*puck, gains=(GAIN, GAIN), sample_time=HOLD).overshoot(BOX)
    inside = {"rim": plain.crossed["rim"]}
    keep = hf.SafetyFilter(*puck, gains=(GAIN, GAIN), sample_time=HOLD, margins=inside)
    assert keep.overshoot(BOX).crossed["rim"] <= 0.01 * inside["rim"]


def test_overshoot_falls_with_the_sample_time_and_is_none_at_a_flat_limit(puck):
    sizes = [
        hf.SafetyFilter(*puck, gains=(GAIN, GAIN), sample_time=t).overshoot(BOX).crossed["rim"]
        for t in (0.1, 0.025)
    ]
    assert sizes[0] / sizes[1] == pytest.approx(4.0, rel=0.35)
    system, _ = puck
    flat = hf.Region("strip", system.states, (hf.Inequality("side", X - 1, "m"),))
    keep = hf.SafetyFilter(system, flat, gains=(1 / HOLD, 1.0), sample_time=HOLD)
    assert keep.overshoot(BOX).crossed["side"] <= 1e-12


def test_overshoot_of_a_vehicle_is_millimetres_and_says_what_does_not_count(vehicle):
    keep = hf.SafetyFilter(vehicle, hf.regions.camera_view(), gains=(1.5, 8))
    box = {"x": (-2, -0.3), "y": (-1.6, 1.6), "psi": (-1, 1), "u": (-0.2, 0.2), "v": (-0.1, 0.1), "r": (-0.5, 0.5)}  # fmt: skip
    found = keep.overshoot(box, runs=200)
    assert 150 < found.runs == 200 - found.relaxed
    assert np.max([*found.crossed.values()]) < 0.003


@pytest.mark.parametrize(
    ("box", "complaint"),
    [
        ({"x": (-1, 1)}, "'y' has no ends"),
        ({"x": (-1, 1), "y": (1, -1)}, "the ends of 'y' are 1 and -1"),
        ({"x": (3, 4), "y": (3, 4)}, "none of 20000 states of the box"),
        (BOX | {"z": (0, 1)}, "'z' is no state"),
    ],
)
def test_box_that_cannot_be_used_is_refused(puck, box, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.SafetyFilter(*puck).overshoot(box)
