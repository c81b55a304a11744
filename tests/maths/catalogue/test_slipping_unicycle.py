"""Unicycle whose wheels slip: its filter against slips that are not the filter's own."""

from dataclasses import replace

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.expressions.functions import sgn

LIMITS = {"slip": "slip_limit", "skid": "skid_limit", "turn_slip": "turn_slip_limit"}
FEW = ["varied=", "disturbance=", "starts.random=60", "run.horizon=15"]


def test_wheels_that_do_not_slip_move_as_a_unicycle():
    slipping, rolling = hf.systems.slipping_unicycle(), hf.systems.unicycle()
    still = dict.fromkeys((q.symbol for q in slipping.disturbances), sp.S.Zero)
    for name, rate in slipping.rates.items():
        rolled = rate.xreplace(still | {hf.symbol("u"): hf.symbol("v")})
        assert sp.simplify(rolled - rolling.rates[name]) == 0


def test_bound_of_slip_below_zero_is_refused_and_no_slip_is_allowed():
    assert hf.systems.slipping_unicycle(slip_limit=0, skid_limit=0, turn_slip_limit=0)
    with pytest.raises(DefinitionError, match=r"skid_limit is -0.1 m/s; expected 0 or more"):
        hf.systems.slipping_unicycle(skid_limit=-0.1)


def test_laws_that_face_a_target_are_made_for_slipping_wheels_and_those_to_rest_are_not():
    said = hf.explain(hf.systems.slipping_unicycle()).text()
    assert "made for this system: face_target, inspect_target" in said
    assert "0 = skid" in said
    with pytest.raises(DefinitionError, match="acatastatic"):
        hf.laws.follow_field(hf.systems.slipping_unicycle())


@pytest.mark.heavy
def test_filter_that_counts_the_worst_slip_keeps_every_start_in_view():
    """Scenario `slipping-view`: 300 of 300 starts, 87 with a filter that knows of no slip.

    At the end 276 and 85 are within 30 cm and 30 deg of the place.
    """
    scenario = hf.load_scenario("slipping-view")
    result = scenario.run()
    assert result.viable == result.dataset.sizes["run"] == 300
    assert result.dataset["infeasible"].values.max() == 0
    assert result.outcomes["reached goal"] == 276
    unaware = hf.load_scenario("slipping-view", ["safeguard.worst="]).run()
    assert unaware.viable == 87
    assert unaware.outcomes["reached goal"] == 85
    alone = hf.load_scenario("slipping-view", ["safeguard="]).run()
    assert (alone.viable, alone.outcomes["reached goal"]) == (87, 85)


def worst_by_the_state(scenario):
    """The slips at their bounds, by the gradient of the constraint nearest to its limit."""
    system, worst = scenario.system, scenario.region.worst
    slopes = [system.derivative(worst).diff(q.symbol) for q in system.disturbances]
    return {
        q.name: hf.symbol(LIMITS[q.name]) * sgn(slope)
        for q, slope in zip(system.disturbances, slopes, strict=True)
    }


def share_of_the_speed(scenario):
    """The same as a share of what the wheels roll: none at rest."""
    rolled = {
        "slip": hf.symbol("u") / hf.symbol("speed_limit"),
        "skid": hf.symbol("u") / hf.symbol("speed_limit"),
        "turn_slip": hf.symbol("r") / hf.symbol("turn_limit"),
    }
    return {n: rolled[n] * e for n, e in worst_by_the_state(scenario).items()}


def under(scenario, law, slips):
    """The law on wheels whose slips are expressions of the time, the states and the inputs."""
    system, region = scenario.system, scenario.region
    pushed = {hf.symbol(n): e for n, e in slips.items()}
    real = replace(
        system,
        rates={n: e.xreplace(pushed) for n, e in system.rates.items()},
        parameters=tuple({p.name: p for p in (*system.parameters, *region.parameters)}.values()),
        disturbances=(),
        disturbance_bounds=None,
        pfaffian=(),
        empirical="the worst of constraints in several units",
    )
    return hf.simulate(
        real, law, starts=scenario.starts, region=region, seed=2, tolerance=1e-3,
        horizon=15, sample_time=0.02, substeps=1,
    )  # fmt: skip


@pytest.mark.heavy
@pytest.mark.parametrize(("slips", "unaware"), [(worst_by_the_state, 25), (share_of_the_speed, 53)])
def test_view_is_kept_under_slips_that_depend_on_the_state(slips, unaware):
    """60 starts at limits of the region; those that a filter keeps that knows of no slip."""
    scenario = hf.load_scenario("slipping-view", FEW)
    run = under(scenario, scenario.law, slips(scenario))
    assert run.viable == 60
    assert run.dataset["infeasible"].values.max() == 0
    other = hf.load_scenario("slipping-view", [*FEW, "safeguard.worst="])
    assert under(scenario, other.law, slips(scenario)).viable == unaware


def at_corners(*changes):
    """Every start by 8 corners: each slip constant at one of its bounds."""
    draws = ", ".join(f"{n}_sign = {{ range = [-1, 1], unit = '1' }}" for n in LIMITS)
    slips = ", ".join(f"{n} = '{n}_sign*{limit}'" for n, limit in LIMITS.items())
    vertices = f"varied={{ vertices = true, draws = {{ {draws} }} }}"
    return hf.load_scenario("slipping-view", [vertices, f"disturbance={{ {slips} }}", *changes])


def test_view_is_kept_under_every_corner_of_the_bounds_of_slip():
    run = at_corners(*FEW[2:]).run()
    assert run.viable == run.dataset.sizes["run"] == 480
    assert run.dataset["infeasible"].values.max() == 0
    assert at_corners(*FEW[2:], "safeguard.worst=").run().viable == 216


@pytest.mark.heavy
def test_view_is_kept_from_24_000_starts_and_corners_and_is_lost_from_some_farther_along_the_wall():
    lost = 0
    for seed in (1, 2, 3):
        many = ["starts.random=1000", "run.horizon=60", f"run.seed={seed}"]
        assert at_corners(*many).run().viable == 8000
        lost += 8000 - at_corners(*many, "starts.box.y=[-1.0, 1.0]").run().viable
    assert lost == 4


@pytest.mark.heavy
def test_kernel_of_the_worst_slip_lies_in_that_of_no_slip_and_its_states_are_kept():
    """Scenario `slipping-kernel` on 31 nodes an axis, for 10 s."""
    few = ["grid.nodes=31", "march.horizon=10", "promise.runs=60", "promise.horizon=10"]
    slipping = hf.load_scenario("slipping-kernel", few).run()
    none = [f"system.{limit}=0" for limit in LIMITS.values()]
    rolling = hf.load_scenario("slipping-kernel", [*few, *none, "promise=", "law="]).run()
    assert (slipping.value.values() <= rolling.value.values() + 1e-12).all()
    assert slipping.promise.held


@pytest.mark.heavy
def test_kernel_of_the_worst_slip_is_kept():
    """Scenario `slipping-kernel` as shipped: 91.8 % of the view; outside it 208 of 500 stay."""
    scenario = hf.load_scenario("slipping-kernel")
    found = scenario.run()
    assert found.promise.held
    assert found.promise.inside[0].kept.count == 500
    assert found.promise.outside.kept.count == 208
    share = found.value.fraction() / scenario.begun.fraction()
    assert share == pytest.approx(0.918, abs=5e-4)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("limit", "low", "high"),
    [
        ("slip_limit", 0.3741, 0.3750),
        ("skid_limit", 0.1444, 0.1453),
        ("turn_slip_limit", 0.9609, 0.9633),
    ],
)
def test_slip_that_is_too_much_is_found_by_the_margin(limit, low, high):
    """Against a wheel that can no longer roll away, or turn, faster than it slips: 0.4 m/s, 1 rad/s."""
    found = hf.disturbance_margin(
        "slipping-kernel", f"system.{limit}", keep=[{"x": -0.6, "y": 0, "psi": 0}]
    )
    assert found.low == pytest.approx(low, abs=1e-4)
    assert found.high == pytest.approx(high, abs=1e-4)
