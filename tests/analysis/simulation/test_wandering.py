"""A Wiener process as a disturbance: its law, its independence, what is refused."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.expressions.functions import wiener
from holdfast.scenario.kinds.closed_loop import no_rest, resting_places
from tests.devices import needs_cpp

x, u = hf.symbol("x"), hf.symbol("u")


@pytest.fixture(scope="module")
def walker():
    """xdot = d_0, ydot = d_1 + u."""
    return hf.System(
        "walker", (hf.Quantity("x", "m"), hf.Quantity("y", "m")), (hf.Quantity("u", "m/s"),),
        {"x": hf.symbol("dx"), "y": u + hf.symbol("dy")},
        disturbances=(hf.Quantity("dx", "m/s"), hf.Quantity("dy", "m/s")),
        parameters=(hf.Parameter("roughness", "m/s^1.5", value=0.3),),
        input_bounds=hf.Box((-9,), (9,)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def still(walker):
    return hf.Law("still", walker.states, {"u": 0 * x})


def walked(system, law, runs=2000, **options):
    disturbance = {"dx": hf.wiener_process(hf.symbol("roughness")), "dy": hf.wiener_process(0.2)}
    options = {"horizon": 4.0, "sample_time": 0.1, "seed": 3, "disturbance": disturbance} | options
    return hf.simulate(system, law, starts=np.zeros((runs, 2)), **options).dataset


def test_values_have_the_law_of_a_wiener_process(walker, still):
    """Increments of 40 samples: normal, of variance s^2 h, and independent of one another."""
    felt = walked(walker, still)["disturbance"].values
    assert (felt[:, 0] == 0).all()
    steps = np.diff(felt, axis=1) / (np.array([0.3, 0.2]) * np.sqrt(0.1))
    count = steps.size  # 160,000 numbers; bounds of five standard deviations
    assert abs(steps.mean()) < 5 / np.sqrt(count)
    assert abs(steps.var() - 1) < 5 * np.sqrt(2 / count)
    assert abs((steps**4).mean() - 3) < 5 * np.sqrt(96 / count)
    for other in (steps[:, 1:, 0] * steps[:, :-1, 0], steps[:, :, 0] * steps[:, :, 1]):
        assert abs(other.mean()) < 5 / np.sqrt(other.size)


def test_state_is_the_integral_of_what_is_held(walker, still):
    """The variance of x_n = h sum W_k is s^2 h^3 sum k^2, to five standard deviations."""
    data = walked(walker, still)
    felt, x = data["disturbance"].values[:, :, 0], data["state"].values[:, -1, 0]
    np.testing.assert_allclose(x, 0.1 * felt[:, :-1].sum(axis=1), atol=1e-12)
    expected = 0.3**2 * 0.1**3 * sum(k**2 for k in range(40))
    assert x.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / len(x)))


def test_a_run_has_its_process_whoever_is_beside_it(walker, still):
    whole = walked(walker, still, runs=40)["disturbance"].values
    part = walked(walker, still, runs=40, part=range(17, 40), threads=1)["disturbance"].values
    np.testing.assert_array_equal(whole[17:], part)
    other = walked(walker, still, runs=40, seed=4)["disturbance"].values
    assert (whole[:, 1:] != other[:, 1:]).all()


@needs_cpp
def test_every_target_has_the_same_process(walker, still):
    one, other = (walked(walker, still, runs=40, device=d) for d in ("cpu", "c++"))
    np.testing.assert_array_equal(one["disturbance"].values, other["disturbance"].values)
    np.testing.assert_array_equal(one["state"].values, other["state"].values)


def test_a_law_that_measures_the_disturbance_measures_the_process(walker):
    against = hf.Law("against", (*walker.states, walker.disturbances[1]), {"u": -hf.symbol("dy")})
    data = walked(walker, against, runs=20)
    assert np.abs(data["state"].values[:, :, 1]).max() < 1e-12
    assert np.abs(data["state"].values[:, -1, 0]).min() > 1e-3


def test_a_law_that_sees_a_process_late_is_refused(walker):
    against = hf.Law("against", (*walker.states, walker.disturbances[1]), {"u": -hf.symbol("dy")})
    with pytest.raises(hf.HoldfastError, match="a stochastic process, and sees it late"):
        walked(walker, against, runs=2, delay=0.3)


def test_a_process_is_that_of_its_disturbance_whatever_the_others_have(walker, still):
    both = walked(walker, still, runs=5)["disturbance"].values
    alone = walked(walker, still, runs=5, disturbance={"dy": hf.wiener_process(0.2)})
    np.testing.assert_array_equal(both[:, :, 1], alone["disturbance"].values[:, :, 1])


def test_the_intensity_may_be_drawn(walker, still):
    drawn = hf.Varied(draws={"roughness": (0.1, 0.5)})
    data = walked(walker, still, runs=500, varied=drawn)
    ends, roughness = data["disturbance"].values[:, -1, 0], data["varied"].values[:, 0]
    scaled = ends / (roughness * 2.0)  # after 4 s
    assert scaled.var() == pytest.approx(1, rel=5 * np.sqrt(2 / len(ends)))


def test_a_process_is_no_constant_current():
    """Commands that look for a place at rest say so."""
    scenario = hf.load_scenario(
        "ch5-current", ["disturbance.Vx=clip(wiener(0.02), -0.05, 0.05)", "starts.random=2"]
    )
    assert no_rest(scenario) == ""
    with pytest.raises(hf.HoldfastError, match="its disturbance is not constant in a run"):
        resting_places(scenario, 1)


def test_a_process_beyond_the_bounds_of_the_system_is_refused(walker, still):
    from dataclasses import replace

    narrow = replace(walker, disturbance_bounds=hf.Box((-0.5, -0.5), (0.5, 0.5)))
    with pytest.raises(
        hf.HoldfastError, match=r"leaves its bounds where run \d+ is at t = .* of 2000"
    ):
        walked(narrow, still)
    clipped = {"dx": hf.parse_expression("clip(wiener(0.3), -0.5, 0.5)", {})}
    walked(narrow, still, disturbance=clipped)


def test_a_process_anywhere_else_is_refused(walker, still):
    with pytest.raises(hf.HoldfastError, match="uses 'x'; expected an expression of declared"):
        walked(walker, still, disturbance={"dx": hf.wiener_process(x)})
    for wrong in (hf.wiener_process(hf.wiener_process(0.1)), wiener(sp.oo)):
        with pytest.raises(hf.HoldfastError, match="is no process; expected finite numbers"):
            walked(walker, still, disturbance={"dx": wrong})
    with pytest.raises(hf.HoldfastError, match="uses 'wiener', which cannot be compiled"):
        hf.Law("drunk", walker.states, {"u": hf.wiener_process(0.1)})
    with pytest.raises(hf.HoldfastError, match=r"'wiener' is not allowed .* only .disturbance. of"):
        hf.load_scenario("ch7-discriminating", ["disturbance.Vx=wiener(0.1)"])
