"""Chapter 3 beyond the nominal loop: noise, held inputs, limits, changing currents."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf

CURRENT = {"Vx": hf.symbol("current_x"), "Vy": hf.symbol("current_y")}
NOISE = {"x": 0.01, "y": 0.01, "psi": 0.02}


def poses(count, seed=0):
    generator = np.random.default_rng(seed)
    return generator.uniform([-2, -2, -np.pi], [2, 2, np.pi], (count, 3))


def run(law, starts, ts, system=None, horizon=60.0, **settings):
    system = system or hf.systems.drifting_unicycle()
    chosen = {"disturbance": CURRENT, "record_every": 0.05, "seed": 1} | settings
    return hf.simulate(
        system, law, starts=starts, horizon=horizon, sample_time=ts, substeps=1, **chosen
    )


def held(result, radius=0.1, settled=30.0):
    return hf.station_statistics(result, radius, settled=settled)


def hold(system=None, **changes):
    return hf.laws.hold_station(system or hf.systems.drifting_unicycle(), **changes)


def as_printed(law):
    """Without the rule (A, 2) -> 1 that the thesis's logic lacks."""
    kept = [x for x in law.transitions if (x.source, x.target) != ("push", "approach")]
    return replace(law, transitions=tuple(kept))


def with_turn(law, change):
    """The law with another turn rate while approaching; change(r, phi's rate) gives it."""
    approach = law.modes["approach"]
    outputs = {**approach.outputs, "r": change(approach.outputs["r"])}
    printed = "as printed, the field counts in metres"
    changed = replace(approach, outputs=outputs, empirical=printed)
    return replace(law, modes={**law.modes, "approach": changed})


# -- measurement noise (Fig. 3.8)


def within_50_ms(result):
    """For each run, how many modes lasted less than 50 ms."""
    dwells = [np.diff(np.flatnonzero(np.diff(m))) * 0.01 for m in result.dataset["mode"].values]
    return [int((d < 0.0499).sum()) for d in dwells]


def test_noise_makes_the_printed_logic_switch_as_counted():
    """+-1 cm, +-.02 rad at 100 Hz: 121 switches with one radius, 48 of them within 50 ms, and
    53 with r1 = .13, none of them. Reference with one radius: 125, 51 and a tail of .219 m, above
    what we see (.15 m, at most .20 in 40 runs)."""
    settings = {"noise_uniform": NOISE, "record_every": 0.01}
    starts = [[-1, -1, 0]] * 40
    result = run(as_printed(hold(r1=0.1)), starts, 0.01, **settings)
    assert np.median(result.dataset["switches"].values) == pytest.approx(121, abs=2)
    assert np.median(within_50_ms(result)) == pytest.approx(48, abs=2)
    two_radii = run(as_printed(hold()), starts, 0.01, **settings)
    assert np.median(two_radii.dataset["switches"].values) == pytest.approx(53, abs=2)
    assert max(within_50_ms(two_radii)) == 0
    assert 0.13 < np.median(held(result)["tail_radius"]) < 0.22


def test_five_centimetres_of_noise_make_it_switch_a_thousand_times():
    """981 in the reference."""
    noise = {"x": 0.05, "y": 0.05, "psi": 0.02}
    result = run(as_printed(hold(r1=0.1)), [[-1, -1, 0]] * 20, 0.01, noise_uniform=noise)
    assert np.median(result.dataset["switches"]) == pytest.approx(981, rel=0.05)
    assert result.outcomes["chattered"] == 20


def test_noise_makes_one_radius_chatter_and_that_is_an_outcome():
    result = run(hold(r1=0.1), [[-1, -1, 0]] * 20, 0.01, noise_uniform=NOISE)
    assert result.outcomes["chattered"] == 20
    assert np.isfinite(result.dataset["exit_time"]).all()
    assert (held(result)["shortest_dwell"] == pytest.approx(0.01)).all()


def test_exit_radius_removes_the_chattering():
    """r1 = .13: tail .141 m and no dwell below 50 ms, from every start."""
    result = run(hold(), poses(500), 0.01, noise_uniform=NOISE)
    assert result.outcomes["chattered"] == 0
    found = held(result)
    assert bool(found["entered"].all())
    assert float(found["tail_radius"].max()) < 0.145
    assert float(found["shortest_dwell"].min()) >= 0.05


def test_holding_the_inputs_for_50_ms_removes_it_too():
    """The thesis's own advice, with one radius: .190 m and one dwell below 50 ms in the
    reference; here 500 of 500, at most .13 m, and no dwell is below the sample time."""
    result = run(hold(r1=0.1), poses(500), 0.05, noise_uniform=NOISE)
    found = held(result)
    assert result.outcomes["chattered"] == 0
    assert bool(found["entered"].all())
    assert float(found["tail_radius"].max()) < 0.135


def test_unknown_current_with_noise_is_held_without_chattering():
    """20 to 100 Hz with noise: tail at most .185 m in the reference, .1854 m here."""
    law = hf.laws.hold_station_unknown(hf.systems.drifting_unicycle())
    for ts in (0.01, 0.05):
        true = {"Vx": -0.1, "Vy": 0.2}
        result = run(law, poses(200), ts, noise_uniform=NOISE, disturbance=true)
        found = held(result)
        assert bool(found["entered"].all())
        assert float(found["tail_radius"].max()) < 0.19
        assert result.outcomes["chattered"] == 0


# -- what (3.5b) needs


def test_leaving_out_the_rate_of_the_field_is_benign_here():
    """phidot omitted, or taken without the current: 500 of 500, tails .108 and .105."""
    system = hf.systems.drifting_unicycle()
    law = hold(r1=0.1)
    x, y, psi, vx, vy, k2 = (
        hf.symbol(n) for n in ("x", "y", "psi", "current_x", "current_y", "k2")
    )
    side = hf.parse_expression("sgn(v)", {"v": vx})
    lam, names = hf.symbol("lam"), {"x": x, "y": y, "vx": vx * side, "vy": vy * side}
    names["lam"] = lam
    phi = hf.parse_expression(
        "atan2(lam*(vx*x + vy*y)*y - vy*(1 - exp(-x**2 - y**2)), "
        "lam*(vx*x + vy*y)*x - vx*(1 - exp(-x**2 - y**2)))",
        names,
    )
    error = hf.parse_expression("wrap(a - b)", {"a": psi, "b": phi})
    u = law.modes["approach"].outputs["u"]
    own = u * (phi.diff(x) * sp.cos(psi) + phi.diff(y) * sp.sin(psi))
    for rate in (0, own):
        result = run(with_turn(law, lambda _, r=rate: -k2 * error + r), poses(500), 1e-3, system)
        found = held(result)
        assert bool(found["entered"].all())
        assert float(found["tail_radius"].max()) < 0.115


def test_unwrapped_heading_error_loses_starts():
    """1 of 500 never enters in the reference; with the error wrapped every one does."""
    law = hold(r1=0.1)
    r = law.modes["approach"].outputs["r"]
    wrapped = {e: e.args[0] for e in r.atoms(sp.Function) if type(e).__name__ == "wrap"}
    result = run(with_turn(law, lambda r: r.xreplace(wrapped)), poses(500), 1e-3)
    entered = int(held(result)["entered"].sum())
    assert entered < 500
    assert entered > 480


# -- limited rates


def cut(law):
    """The turn rate of the approach merely cut: the speed is that of unlimited turning."""
    approach = law.modes["approach"]
    ample = hold().modes["approach"]
    big = {hf.symbol("turn_limit"): sp.Float(1e6)}
    outputs = {k: e.xreplace(big) for k, e in ample.outputs.items()}
    return replace(law, modes={**law.modes, "approach": replace(approach, outputs=outputs)})


@pytest.mark.parametrize(("limit", "count", "tail"), [(1.0, 64, 0.21), (0.5, 64, 0.19)])
def test_slow_turn_needs_the_speed_to_be_scaled(limit, count, tail):
    """Merely cut to 1 rad/s or to 0.5 rad/s 64 of 500 enter, 65 and none in the reference; scaled
    500. (|u2| <= 3: 470 in the reference in continuous time; under our sampled control 500.)"""
    system = hf.systems.drifting_unicycle(turn_limit=limit)
    law = hold(system)
    merely_cut = int(held(run(cut(law), poses(500), 0.005, system))["entered"].sum())
    scaled = held(run(law, poses(500), 0.005, system))
    assert bool(scaled["entered"].all())
    assert float(scaled["tail_radius"].max()) < tail
    assert merely_cut == pytest.approx(count, abs=5)


@pytest.mark.parametrize(("limit", "entered"), [(3.0, 484), (1.0, 278)])
def test_unknown_current_and_a_slow_turn_do_not_go_together(limit, entered):
    """How the current turns the field past the vehicle is not known, so no speed scaling makes
    room for it: not every start enters."""
    system = hf.systems.drifting_unicycle(turn_limit=limit)
    law = hf.laws.hold_station_unknown(system)
    true = {"Vx": -0.1, "Vy": 0.2}
    found = held(run(law, poses(500), 0.005, system, disturbance=true))
    assert int(found["entered"].sum()) == pytest.approx(entered, abs=5)


# -- currents that are not what the law believes, or that change


def turned(degrees, size=1.0):
    a = np.deg2rad(degrees)
    x, y = CURRENT.values()
    return {
        "Vx": size * (x * np.cos(a) - y * np.sin(a)),
        "Vy": size * (x * np.sin(a) + y * np.cos(a)),
    }


@pytest.mark.parametrize(
    ("degrees", "size", "share"), [(10, 1, 1.0), (0, 1.5, 1.0), (0, 0.5, 1.0), (30, 1, 0.92)]
)
def test_known_current_may_be_wrong_by_ten_degrees_or_by_half(degrees, size, share):
    """10 degrees, half and one and a half times: all enter; from 30 degrees on some do not."""
    found = held(run(hold(), poses(100), 0.005, disturbance=turned(degrees, size)))
    assert float(found["entered"].mean()) == pytest.approx(share, abs=0.02 if share < 1 else 0)


def test_current_of_the_opposite_direction_carries_the_vehicle_away():
    found = held(run(hold(), poses(100), 0.005, disturbance=turned(180)))
    assert float(found["entered"].mean()) < 0.6
    assert float(found["tail_radius"].max()) > 10
