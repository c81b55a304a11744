"""Lagging actuators under inputs that are held."""

import math
from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.decomposition.parts_law import check_parts, default_parts_promise, overshoot
from holdfast.errors import SimulationError
from tests.parted_systems import box, late_cart, walls

LAG, SHARE = 0.2, 0.3
GAIN = (1 + SHARE) / (2 * SHARE)
LONGEST = LAG * math.log(GAIN / (GAIN - 1))


@cache
def kernel():
    parted = hf.decompose(
        late_cart(LAG), walls("x"), lag_share=SHARE, box=box("x", "v", at=1.5, speed=1.5)
    )
    return hf.solve_parts(parted, None, 31, 2.0)


def command():
    return hf.commanded(late_cart(LAG))


def margin(**options):
    law = hf.parts_law(kernel(), command(), **options)
    return next(float(p.value) for p in law.parameters if p.name == "safety_margin")


def furthest(held, late):
    """The largest share of |w| <= 1 that a thrust reaches in a run with random w."""
    rng, thrust, fine = np.random.default_rng(0), [0.0], 20
    fade, back = math.exp(-held / fine / LAG), round(late / held * fine)
    for _ in range(4000):
        seen = thrust[max(len(thrust) - 1 - back, 0)]
        u = GAIN * rng.choice([-1.0, 1.0]) + (1 - GAIN) * seen
        for _ in range(fine):
            thrust.append(fade * thrust[-1] + (1 - fade) * u)
    return max(map(abs, thrust))


@pytest.mark.slow("0.02-0.02")
@pytest.mark.parametrize(("held", "late"), [(0.99 * LONGEST, 0.0), (0.02, 0.02)])
def test_a_thrust_that_does_not_overshoot_stays_in_its_share(held, late):
    assert overshoot(LAG, GAIN, held, late) == 0.0
    assert furthest(held, late) <= 1 + 1e-12
    hf.parts_law(kernel(), command(), rate=1.0, margin=0.1, sample_time=held, delay=late)


@pytest.mark.parametrize(("held", "late"), [(1.2 * LONGEST, 0.0), (0.02, 0.1)])
def test_a_sample_time_or_a_delay_with_which_it_overshoots_is_refused(held, late):
    assert furthest(held, late) > 1.001
    with pytest.raises(SimulationError, match=r"2\.167 times faster, would leave its share"):
        hf.parts_law(kernel(), command(), rate=1.0, margin=0.1, sample_time=held, delay=late)


def test_optimal_inputs_are_refused_for_a_sample_time_that_is_too_long():
    whole = {"x": (-1, 1), "v": (-1, 1), "actual_u": (-SHARE, SHARE)}
    assert hf.parts_law(kernel(), sample_time=0.99 * LONGEST).lookup is not None
    with pytest.raises(SimulationError, match="would leave its share"):
        hf.parts_law(kernel(), sample_time=1.2 * LONGEST)
    with pytest.raises(SimulationError, match="would leave its share"):
        check_parts(kernel(), walls("x"), whole, sample_time=1.2 * LONGEST)


@pytest.mark.heavy
def test_the_margin_counts_what_the_thrust_adds_while_an_input_is_held():
    part = kernel().parts[0][0]
    for held in (0.01, 0.05):
        own = hf.sampled_margin(part.part.system, part.value, held)
        assert own < margin(sample_time=held) < 3 * own


@pytest.mark.few("10", "11")
@pytest.mark.parametrize("seed", range(12))
def test_grid_of_a_lagged_cart_is_its_own_whatever_the_lag_and_the_box(seed):
    """Walls of x are slanted in the predicted place, and go on beyond the box of many of these."""
    rng = np.random.default_rng(seed)
    lag, share = rng.uniform(0.05, 0.5), rng.uniform(0.1, 0.9)
    interval = {
        "x": (-rng.uniform(1, 1.3), rng.uniform(1, 1.3)),
        "v": (-rng.uniform(0.5, 3), rng.uniform(0.5, 3)),
    }
    parted = hf.decompose(late_cart(lag), walls("x"), lag_share=share, box=interval)
    found = hf.solve_parts(parted, None, 31, 1.0)
    late = lag * 2 * share / (1 + share)  # predicted x is x - late v - late^2 a, with |a| <= share
    goes_on = any(
        1 - late**2 * share + late * abs(v) > abs(x)
        for x, v in zip(interval["x"], interval["v"], strict=True)
    )
    said = any("predicted x is kept within its box" in reason for reason in parted.reasons)
    assert ("x" in parted.within) is said is goes_on
    if seed < 3:
        assert default_parts_promise(found).held
