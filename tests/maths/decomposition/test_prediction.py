"""Lagged actuators that are predicted."""

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.decomposition.prediction import lags, predicted
from holdfast.maths.definitions.extension import lagged
from tests.parted_systems import cart, late_cart, symbols


def test_the_lags_of_both_thrusters_are_found():
    vehicle = lagged(hf.systems.marine_vehicle(), {"port": 0.1, "starboard": 0.2})
    found = lags(vehicle)
    assert [a.state.name for a in found] == ["actual_port", "actual_starboard"]
    values = {q.symbol: q.value for q in vehicle.parameters}
    assert [float(a.constant.subs(values)) for a in found] == [0.1, 0.2]


def test_a_predicted_double_integrator_is_one_without_a_lag():
    v, a, u = symbols("v actual_u u")
    found = predicted(late_cart(0.2), 1.0)
    assert sp.simplify(found.shift["x"] - 0.2 * v) == 0
    assert sp.simplify(found.shift["v"] - 0.2 * a) == 0
    assert sp.simplify(found.rates["x"] - v) == 0
    assert sp.simplify(found.rates["v"] - u) == 0


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_the_predicted_rates_are_those_along_the_true_motion(share):
    vehicle = lagged(hf.systems.marine_vehicle(), {"port": 0.1, "starboard": 0.15})
    found = predicted(vehicle, share)
    numbers = {q.symbol: sp.Float(q.value) for q in vehicle.parameters}
    at = {s: sp.Float(0.1 + 0.07 * k) for k, s in enumerate(symbols(
        "x y psi u v r actual_port actual_starboard tau_u tau_r Vx Vy"))}  # fmt: skip
    command = {hf.symbol(n): e.xreplace(at) for n, e in found.command.items()}
    truth = {
        n: r.xreplace(numbers).xreplace(command).xreplace(at) for n, r in vehicle.rates.items()
    }
    place = dict(at)
    for q in found.states:
        place[q.symbol] = sp.N((q.symbol + found.shift[q.name]).xreplace(at))
    for q in found.states:
        along = sum(
            sp.diff(q.symbol + found.shift[q.name], s.symbol).xreplace(at) * truth[s.name]
            for s in vehicle.states
        )
        assert float(found.rates[q.name].xreplace(place) - along) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("share", [0.2, 0.5, 1.0])
def test_no_command_leaves_the_range_and_no_actuator_its_share(share):
    found = predicted(late_cart(), share)
    low, high = found.intervals[0]
    for a in (low, high):
        for w in (low, high):
            u = found.command["u"].xreplace({hf.symbol("u"): w, hf.symbol("actual_u"): a})
            assert -1 - 1e-12 <= u <= 1 + 1e-12
            assert u >= low - 1e-12 if a == low else u <= high + 1e-12


def test_systems_without_a_lag_or_with_other_inputs_are_refused():
    with pytest.raises(DefinitionError, match="first-order lag"):
        predicted(cart(), 0.5)
    u, w, a = symbols("u w actual_u")
    both = hf.System(
        "both", (hf.Quantity("x"), hf.Quantity("actual_u")), (hf.Quantity("u"), hf.Quantity("w")),
        {"x": a + w, "actual_u": u - a}, input_bounds=hf.Box((-1, -1), (1, 1)),
    )  # fmt: skip
    with pytest.raises(DefinitionError, match="as many of each"):
        predicted(both, 0.5)
    with pytest.raises(DefinitionError, match="above 0, at most 1"):
        predicted(late_cart(), 0.0)


def test_a_slew_limit_is_no_first_order_lag():
    with pytest.raises(DefinitionError, match="first-order lag"):
        predicted(lagged(cart(), {"u": 0.1}, {"u": 2.0}), 0.5)
