"""What differs from run to run, and what a law measures, on motions known in closed form."""

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy import stats

import holdfast as hf
from holdfast.errors import (
    DefinitionError,
    GainWarning,
    HoldfastError,
    ScenarioError,
    SimulationError,
)
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import BY_NAME
from holdfast.maths.expressions.functions import magnitude
from holdfast.presentation.text.runs import summary_text

X, U, D, C, G, K, S, V, SIZE = (
    hf.symbol(n) for n in ("x", "u", "d", "c", "g", "k", "s", "v", "size")
)
START, END, NOMINAL = 1.0, 1.0, 2.0
NEVER_HELD = {"sample_time": 0.01, "horizon": END, "continuous": True}

LINE = hf.System(
    "line",
    (hf.Quantity("x", "m"),),
    (hf.Quantity("u", "m/s"),),
    {"x": G * U + D},
    (
        hf.Parameter("g", "1", "what an input brings about", value=NOMINAL, above=0.0),
        hf.Parameter("limit", "m/s", "largest disturbance", value=1.0, above=0.0),
        hf.Parameter("size", "m/s", "of the disturbance", value=0.5),
    ),
    disturbances=(hf.Quantity("d", "m/s"),),
    disturbance_bounds=hf.Box((-hf.symbol("limit"),), (hf.symbol("limit"),)),
)
LAW = hf.Law(
    "to_c",
    LINE.states,
    {"u": -K / G * (X - C)},
    (
        hf.Parameter("k", "1/s", value=1.0, above=0.0),
        hf.Parameter("c", "m", value=0.0),
        LINE.parameters[0],
    ),
)
NEAR = hf.Region(
    "near",
    LINE.states,
    (hf.Inequality("near", magnitude(X) - hf.symbol("radius")),),
    (hf.Parameter("radius", "m", value=1.0),),
)
DRAWS = {"k": (0.5, 2.5), "s": (0.5, 1.5), "v": (-0.3, 0.6), "radius": (0.0, 1.5)}
VALUES, PLANT = {"c": sp.log(S) + K**2 / 4}, {"g": G * (1 + S / 2)}


def run(runs=12, law=LAW, draws=None, starts=None, **settings):
    """Runs with a k, a c = log(s) + k^2/4, a constant d = v, a goal and a plant of their own.

    One compiled program for all: ranges, numbers and conditions are no part of its text.
    """
    varied = hf.Varied(DRAWS | (draws or {}), VALUES, PLANT)
    chosen = NEVER_HELD | {"varied": varied, "disturbance": {"d": V}, "goal": NEAR}
    starts = np.full((runs, 1), START) if starts is None else starts
    return hf.simulate(LINE, law, starts=starts, **(chosen | settings))


@pytest.fixture(scope="module")
def result():
    return run(400)


def own(result, name):
    """The values that the runs had of `name`."""
    return result.dataset["varied"].sel(varied_name=name).values


def states(result):
    return result.dataset["state"].values[:, :, 0]


# -- the numbers


def test_draws_are_uniform_within_their_ranges_and_independent(result):
    drawn = np.array([own(result, n) for n in DRAWS])
    for numbers, (low, high) in zip(drawn, DRAWS.values(), strict=True):
        assert ((low < numbers) & (numbers < high)).all()
        assert stats.kstest(numbers, "uniform", (low, high - low)).pvalue > 0.01
    correlation = np.corrcoef(drawn) - np.eye(len(drawn))
    assert np.abs(correlation).max() < 0.15  # three standard deviations for 400 runs


def test_a_run_draws_the_same_in_any_batch_on_any_number_of_threads(result):
    for runs, threads in ((10, 1), (100, 2), (100, 3)):
        found = run(runs, threads=threads).dataset
        for name in ("varied", "state", "outcome"):
            assert np.array_equal(found[name].values, result.dataset[name].values[:runs])


def test_another_seed_draws_other_numbers(result):
    drawn = result.dataset["varied"].values[:12]
    assert not np.isclose(run(seed=1).dataset["varied"].values, drawn).any()


def test_draws_say_nothing_about_random_starts_and_starts_nothing_about_draws(result):
    starts = hf.Starts(random=400, box={"x": (-1.0, 1.0)})
    found = run(starts=starts, horizon=0.1)
    assert np.array_equal(found.dataset["varied"].values, result.dataset["varied"].values)
    for name in DRAWS:
        assert abs(np.corrcoef(states(found)[:, 0], own(found, name))[0, 1]) < 0.15


def test_a_range_of_one_number_is_that_number():
    assert (own(run(draws={"k": (1.25, 1.25)}), "k") == 1.25).all()


def test_values_are_computed_from_the_draws_of_their_run(result):
    k, s = own(result, "k"), own(result, "s")
    assert own(result, "c") == pytest.approx(np.log(s) + k**2 / 4, rel=1e-14)
    assert own(result, "g of the plant") == pytest.approx(NOMINAL * (1 + s / 2), rel=1e-15)


# -- the vertices of the box of draws

CORNERED = hf.Varied(DRAWS, VALUES, PLANT, vertices=("k", "s"))


def test_every_start_is_tried_at_every_vertex():
    """Three starts at 2 x 2 vertices; what is no vertex is drawn for each of the 12 runs."""
    starts = np.array([[1.0], [0.5], [-0.5]])
    found = run(starts=starts, varied=CORNERED)
    k, s, v = (own(found, n).reshape(3, 4) for n in ("k", "s", "v"))
    assert (k == [0.5, 0.5, 2.5, 2.5]).all()
    assert (s == [0.5, 1.5, 0.5, 1.5]).all()
    assert len(np.unique(v)) == 12
    assert np.array_equal(states(found)[:, 0].reshape(3, 4), np.tile(starts, 4))
    assert own(found, "c") == pytest.approx(np.log(s.ravel()) + k.ravel() ** 2 / 4, rel=1e-14)


def test_a_part_of_the_runs_at_the_vertices_is_that_part_of_all():
    starts = np.array([[1.0], [0.5], [-0.5]])
    whole = run(starts=starts, varied=CORNERED).dataset
    for part in (range(0, 4), range(3, 7), range(5, 12)):
        found = run(starts=starts, varied=CORNERED, part=part).dataset
        for name in ("varied", "state", "outcome"):
            assert np.array_equal(found[name].values, whole[name].values[part.start : part.stop])


def test_summary_counts_the_runs_of_each_vertex():
    found = run(starts=np.array([[1.0], [0.5], [-0.5]]), varied=CORNERED)
    reached = found.dataset["outcome"].values == hf.Outcome.REACHED
    told = found.summary()["vertices"]
    assert [(v["at"]["k"], v["at"]["s"]) for v in told] == [
        (0.5, 0.5), (0.5, 1.5), (2.5, 0.5), (2.5, 1.5),
    ]  # fmt: skip
    assert [v["reached"] for v in told] == list(reached.reshape(3, 4).sum(axis=0))
    assert {v["runs"] for v in told} == {3}
    assert run(1).summary()["vertices"] == []
    shown = summary_text(found)
    assert "of 3 starts at each of 4 vertices" in shown
    assert re.search(rf"k 2\.5, s 0\.5 +reached goal {told[2]['reached']}$", shown, re.M)


@pytest.mark.parametrize(
    ("vertices", "complaint"),
    [
        (("k", "q"), "vertices of 'q', which is not drawn"),
        (("k", "k"), "names of draws, each once"),
        ("ks", "names of draws, each once"),
    ],
)
def test_vertices_of_anything_but_draws_are_refused(vertices, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.Varied(DRAWS, vertices=vertices)


def test_more_vertices_than_anyone_can_wait_for_are_refused():
    draws = {f"a{i}": (0.0, 1.0) for i in range(11)}
    assert len(hf.Varied(draws, vertices=[*draws][:10]).corners) == 1024
    with pytest.raises(DefinitionError, match=r"11 draws have 2,048 vertices.*at most 1,024"):
        hf.Varied(draws, vertices=[*draws])


# -- what they do


def test_law_keeps_the_nominal_value_where_the_plant_has_its_own(result):
    """x' = -(g_i/g) k_i (x - c_i) + v_i, and the input is -(k_i/g) (x - c_i)."""
    k, c, v, g = (own(result, n)[:, None] for n in ("k", "c", "v", "g of the plant"))
    time = result.dataset["time"].values
    rate = k * g / NOMINAL
    rest = c + v / rate
    exact = rest + (START - rest) * np.exp(-rate * time)
    assert states(result) == pytest.approx(exact, abs=1e-9)
    commanded = result.dataset["input"].values[:, :, 0]
    assert commanded == pytest.approx(-k / NOMINAL * (exact - c), abs=1e-9)
    assert result.dataset["peak_input"].values[:, 0] == pytest.approx(
        np.abs(commanded).max(axis=1), rel=0.01
    )


def test_goal_that_differs_from_run_to_run_is_judged_by_that_of_the_run(result):
    reached = np.abs(states(result)[:, -1]) <= own(result, "radius")
    assert 50 < reached.sum() < 350
    wanted = np.where(reached, hf.Outcome.REACHED, hf.Outcome.STAYED)
    assert np.array_equal(result.dataset["outcome"].values, wanted)
    assert result.outcomes["reached goal"] == reached.sum()


def test_what_varies_is_saved_with_its_names(result, tmp_path):
    found = hf.load(result.save(tmp_path / "result.nc"))
    names = ["k", "s", "v", "radius", "c", "g of the plant"]
    assert [str(n) for n in found.dataset["varied_name"].values] == names
    for name in names:
        assert np.array_equal(own(found, name), own(result, name))
    assert json.loads(found.dataset.attrs["parameters"])["k"] == 1.0  # the nominal one


def test_parameter_of_the_plant_alone_may_be_drawn_where_its_law_has_it_too():
    """Both get it: with g_i = g in law and plant the motion does not depend on g."""
    varied = hf.Varied(DRAWS | {"g": (0.5, 4.0)}, VALUES, {"g": G * (1 + S / 2)})
    found = run(varied=varied)
    k, c, v, s = (own(found, n) for n in ("k", "c", "v", "s"))
    assert own(found, "g of the plant") == pytest.approx(own(found, "g") * (1 + s / 2), rel=1e-15)
    rate = k * (1 + s / 2)
    rest = c + v / rate
    assert states(found)[:, -1] == pytest.approx(
        rest + (START - rest) * np.exp(-rate * END), abs=1e-9
    )


def test_new_name_is_a_parameter_with_the_middle_of_its_range():
    varied = hf.Varied({"k": (0.0, 1.0), "v": (-1.0, 3.0)}, units={"v": "m/s"})
    (new,) = varied.new_parameters({"k": None})
    assert (new.name, new.unit, new.value) == ("v", "m/s", 1.0)
    assert varied
    assert not hf.Varied()


def test_value_that_follows_from_another_value_uses_that_of_the_run():
    varied = hf.Varied({"s": (1.0, 2.0)}, {"c": S, "k": 2 * C})
    program = program_of(varied=varied)
    s, c, k = ClosedLoop(program).varied(5, 0).T
    assert np.array_equal(c, s)
    assert np.array_equal(k, 2 * c)


# -- what is refused, and warned of


def program_of(law=LAW, **given):
    chosen = {"region": None, "goal": None, "disturbance": {}, "stepper": BY_NAME["rk4"]}
    return closed_loop_program(LINE, law, **(chosen | given))


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (({"s": (2.0, 1.0)},), r"'s' is drawn from \[2, 1\]; .*lowest first"),
        (({"s": (np.nan, 1.0)},), r"'s' is drawn from \[nan, 1\]"),
        (({"s": (0.0, np.inf)},), r"'s' is drawn from \[0, inf\]"),
        (({"k": (0.0, 1.0)}, {"k": S}), "'k' is both drawn and given a value"),
    ],
)
def test_ranges_that_are_none_are_refused(given, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        hf.Varied(*given)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (({}, {"kk": S}), "unknown parameter 'kk'; did you mean 'k'"),
        (({}, {"x": S}), "unknown parameter 'x'"),
        (({}, {"k": hf.symbol("sp")}), "'k' uses 'sp'; expected an expression of parameters"),
        (({}, {"k": X}), "'k' uses 'x'"),
        (({}, {"k": hf.TIME}), "'k' uses 't'"),
        (({}, {}, {"k": S}), "unknown parameter 'k' of the system"),
        (({}, {}, {"g": X}), "'g' uses 'x'"),
        (({"t": (0.0, 1.0)},), "'t' cannot name a quantity"),
    ],
)
def test_names_that_mean_nothing_are_refused(given, complaint):
    draws, *tables = given
    with pytest.raises(DefinitionError, match=complaint):
        run(varied=hf.Varied({"s": (0.0, 1.0)} | draws, *tables))


@pytest.mark.parametrize("name", ["x", "u", "d"])
def test_draw_that_is_named_as_something_that_moves_is_refused(name):
    with pytest.raises(HoldfastError, match=f"'{name}'"):
        program_of(varied=hf.Varied({name: (0.0, 1.0)}))


def test_varied_value_below_the_limit_of_its_parameter_is_refused():
    with pytest.raises(SimulationError, match=r"'k' is -0\.\d+ in run 0; expected above 0"):
        run(draws={"k": (-1.0, -0.5)})
    backwards = hf.Varied(DRAWS, VALUES, {"g": -G})
    with pytest.raises(SimulationError, match=r"'g of the plant' is -2 in run 0; expected above 0"):
        run(varied=backwards)


def test_first_run_with_a_forbidden_value_is_named(result):
    """The same numbers with the range moved down by 0.6: some k are negative, not the first."""
    shifted = own(result, "k") - 0.6
    first = int(np.argmax(shifted <= 0))
    assert first > 0
    with pytest.raises(SimulationError, match=f"'k' is {shifted[first]:g} in run {first};"):
        run(400, draws={"k": (-0.1, 1.9)})


def test_varied_value_that_is_not_a_number_is_refused():
    with pytest.raises(SimulationError, match=r"'c' is nan in run 0"):
        run(draws={"s": (-0.5, -0.4)})  # c = log(s) + ...


def test_region_stays_the_same_in_every_run():
    wall = hf.Region("wall", LINE.states, (hf.Inequality("wall", X - 2 * G * K),), LAW.parameters)
    for name, varied in (
        ("k", hf.Varied({"k": (1.0, 2.0)})),
        ("k", hf.Varied({"s": (1.0, 2.0)}, {"k": S})),
        ("g", hf.Varied({"s": (1.0, 2.0)}, {}, {"g": S})),
    ):
        with pytest.raises(SimulationError, match=f"'{name}' is varied, and the region depends"):
            run(varied=varied, region=wall, disturbance={})


def test_disturbance_that_leaves_its_bounds_in_one_run_names_that_run(result):
    """|d| <= 1: v up to 0.6 is admitted, the same numbers stretched to 1.2 are not."""
    v = 2 * own(result, "v")
    worst = int(np.argmax(v))
    assert v[worst] > 1
    with pytest.raises(SimulationError) as caught:
        run(400, draws={"v": (-0.6, 1.2)})
    assert f"at t = 0 s of run {worst}: d = {v[worst]:.4g}" in str(caught.value)
    assert "raise the bound of system 'line'" in str(caught.value)
    allowed = run(400, draws={"v": (-0.6, 1.2), "limit": (1.2, 1.2)})
    assert own(allowed, "v") == pytest.approx(v)


def test_bound_of_the_disturbance_that_varies_is_that_of_the_run(result):
    """v is up to 0.6, and every run has a limit of 0.1."""
    assert np.abs(own(result, "v")[:12]).max() > 0.3
    with pytest.raises(SimulationError, match="leaves its bounds"):
        run(draws={"limit": (0.1, 0.1)})


def test_number_of_the_plant_is_not_lost_to_a_draw_of_the_same_name():
    """Two numbers for g of the plant are refused; a g of the plant beside other draws is obeyed."""
    draws = {"k": DRAWS["k"]}
    with pytest.raises(SimulationError, match="'g' of the plant is both varied and given a number"):
        run(varied=hf.Varied(draws | {"g": (2.0, 2.0)}), plant={"g": 4.0}, disturbance={})
    found = run(varied=hf.Varied(draws), plant={"g": 4.0}, disturbance={})
    assert states(found)[:, -1] == pytest.approx(np.exp(-2 * own(found, "k") * END), abs=1e-9)


def test_gain_warning_counts_the_runs_that_violate_the_condition(result):
    def warned(value, **consequence):
        condition = hf.GainCondition(value, sp.Integer(1), "it does", "the test", **consequence)
        return run(400, replace(LAW, conditions=(condition,)))

    with pytest.warns(GainWarning, match=f"in {(own(result, 'k') >= 1).sum()} of 400 runs"):
        warned(K)
    with pytest.warns(GainWarning, match=f"in {(own(result, 'c') >= 1).sum()} of 400 runs"):
        warned(C)
    with pytest.warns(GainWarning) as caught:  # one for all runs where none differs
        warned(hf.symbol("size") + 1)
    assert "runs" not in str(caught[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warned(G / (NOMINAL + 1e-6))  # the plant has more, but no law knows of it


def test_gain_condition_is_judged_at_the_sample_time():
    """k sample_time <= 1/2, the equality included: k = 2.5 at 0.2 s, and no limit if not held."""
    condition = hf.GainCondition(
        K * hf.SAMPLE_TIME, sp.Rational(1, 2), "it overshoots", "the test", closed=True
    )
    law = replace(LAW, conditions=(condition,))
    draws = {"k": (2.5, 2.5)}
    held = {"continuous": False, "record_every": 0.5}
    run(1, law, draws, sample_time=0.02)
    run(1, law, draws, **(held | {"horizon": 2.0, "sample_time": 0.2, "record_every": 0.2}))
    with pytest.warns(GainWarning, match=r"0\.625 is above its limit 0\.5: it overshoots"):
        run(1, law, draws, **(held | {"sample_time": 0.25}))
    run(1, law, draws, sample_time=0.25, record_every=0.5)


def test_condition_that_is_open_is_violated_by_its_limit_and_a_closed_one_is_not():
    values = {K: 0.1 * 3}  # 0.30000000000000004
    limit = sp.Float(0.3)
    assert hf.GainCondition(K, limit, "c", "s", closed=True).violation(values) is None
    assert "not below its limit 0.3" in hf.GainCondition(K, limit, "c", "s").violation(values)
    assert "above" in hf.GainCondition(K, limit, "c", "s", closed=True).violation({K: 0.301})


# -- what a law measures


SEES = {"u": -(K * X + D) / G}
MEASURING = hf.Switching(
    "cancels",
    {
        name: hf.Law(name, (*LINE.states, *LINE.disturbances), SEES, LAW.parameters[::2])
        for name in ("ahead", "astern")
    },
    (hf.Transition("ahead", "astern", -D), hf.Transition("astern", "ahead", D)),
    signals={"felt": D},
)
TIDE = {"d": SIZE * sp.sin(3 * hf.TIME + 1)}


def tide(law=MEASURING, runs=4, **settings):
    """A disturbance size sin(3 t + 1) that the law reads and cancels: x = exp(-k t)."""
    chosen = NEVER_HELD | {"disturbance": TIDE} | settings
    return hf.simulate(LINE, law, starts=np.full((runs, 1), START), **chosen)


def test_law_that_reads_a_disturbance_gets_its_true_value():
    """In outputs, signals and guards, at every instant, also where it varies from run to run."""
    found = tide(varied=hf.Varied({"size": (0.2, 0.9), "k": (0.5, 2.0)}))
    time = found.dataset["time"].values
    felt = own(found, "size")[:, None] * np.sin(3 * time + 1)
    exact = START * np.exp(-own(found, "k")[:, None] * time)
    assert states(found) == pytest.approx(exact, abs=1e-9)
    assert found.dataset["signal"].values[:, :, 0] == pytest.approx(felt, abs=1e-12)
    modes = (felt < 0).astype(int)
    assert 0 < modes[0].sum() < len(time)
    assert np.array_equal(found.dataset["mode"].values, modes)


def test_law_that_reads_a_disturbance_holds_it_for_a_sample():
    """Without noise, and with noise of the state: what is told of the disturbance has none."""
    held = {"continuous": False, "sample_time": 0.1, "noise_uniform": {"x": 0.5}}
    found = tide(**held)
    time = found.dataset["time"].values
    felt = 0.5 * np.sin(3 * time + 1)
    assert found.dataset["signal"].values[:, :, 0] == pytest.approx(np.tile(felt, (4, 1)))
    commanded = found.dataset["input"].values[:, :, 0]
    seen = -commanded * NOMINAL - felt  # what it took x for
    off = seen - states(found)
    assert 0.2 < np.abs(off).max() < 0.5
    carried = np.diff(-0.5 * np.cos(3 * time + 1) / 3)  # the disturbance over a sample
    moved = np.diff(states(found))
    assert moved == pytest.approx(0.1 * NOMINAL * commanded[:, :-1] + carried, abs=1e-7)


def test_law_measures_the_disturbance_of_the_plant_not_the_one_it_believes_in():
    found = tide(plant={"size": 0.9})
    exact = START * np.exp(-found.dataset["time"].values)
    assert states(found)[0] == pytest.approx(exact, abs=1e-9)


def test_disturbance_of_the_plant_must_keep_its_bounds_too():
    with pytest.raises(SimulationError, match="leaves its bounds"):
        tide(plant={"size": 5.0})  # 5 sin(3 t + 1) where 1 is allowed


def test_disturbance_that_varies_in_time_is_checked_in_every_run():
    """size is uniform over [0.9, 1.1] and |d| <= 1: the run of the largest size is named, at
    a time where |sin(3 t + 1)| is largest."""
    varied = hf.Varied({"size": (0.9, 1.1)})
    with pytest.raises(SimulationError) as caught:
        tide(varied=varied, runs=30)
    loop = ClosedLoop(program_of(MEASURING, varied=varied, disturbance=TIDE))
    size = loop.varied(30, 0)[:, 0]
    assert f"of run {size.argmax()}: d = {size.max():.4g}" in str(caught.value)
    assert "at t = 0.19 s" in str(caught.value)  # (pi/2 - 1) / 3 = 0.1903, every 2.5 ms


def test_law_that_reads_neither_state_nor_disturbance_is_refused():
    z = hf.Quantity("z", "m/s")
    with pytest.raises(
        DefinitionError, match=r"reads 'z', which is neither a state nor a disturbance"
    ):
        run(law=hf.Law("stranger", (z,), {"u": z.symbol}))


# -- tracking the velocities of a law that measures


W, A = hf.symbol("w"), hf.symbol("a")
CARRIED = hf.System(
    "carried",
    (hf.Quantity("x", "m"), hf.Quantity("w", "m/s")),
    (hf.Quantity("a", "m/s^2"),),
    {"x": W + D, "w": A},
    disturbances=(hf.Quantity("d", "m/s"),),
)


def tracked(*reads, **believed):
    law = hf.Law(
        "go", (CARRIED.states[0], *reads), {"w": -K * X}, LAW.parameters[:2], believed=believed
    )
    return hf.track_velocity(CARRIED, law, {"w": 4.0})


TOLD = CARRIED.disturbances[0]


def test_feedforward_takes_the_disturbance_for_what_its_law_does():
    """gamma = -k x: d/dt gamma is -k (w + d) with d as read, as a parameter c, or as zero."""
    rate = -hf.symbol("k_w") * (W + K * X)
    for law, taken_for in ((tracked(TOLD, d=D), D), (tracked(d=C), C), (tracked(), 0)):
        assert sp.expand(law.outputs["a"] - (rate - K * (W + taken_for))) == 0
    assert [q.name for q in tracked(TOLD, d=D).reads] == ["x", "w", "d"]
    assert [q.name for q in tracked(d=C).reads] == ["x", "w"]


def test_feedforward_uses_the_disturbance_that_its_law_reads():
    rate = -hf.symbol("k_w") * (W + K * X)
    assert sp.expand(tracked(TOLD).outputs["a"] - (rate - K * (W + D))) == 0


def test_law_cannot_believe_in_what_it_does_not_read():
    with pytest.raises(DefinitionError, match="belief of 'd' of law 'go' uses the undeclared"):
        tracked(d=D)


def test_belief_of_no_disturbance_of_the_system_is_refused():
    with pytest.raises(DefinitionError, match="'current'"):
        tracked(current=C)


def test_velocity_follows_a_measuring_law_exactly_in_a_disturbance_that_varies():
    """w - gamma = (w(0) - gamma(0)) exp(-k_w t), whatever d(t) is."""
    found = hf.simulate(
        CARRIED,
        tracked(TOLD, d=D),
        starts=[[0.5, 2.0]],
        disturbance={"d": sp.sin(5 * hf.TIME)},
        **NEVER_HELD,
    ).dataset
    x, w = found["state"].values[0].T
    time = found["time"].values
    assert w + x == pytest.approx(2.5 * np.exp(-4 * time), abs=1e-7)
    assert np.abs(x - x[0]).max() > 0.1


def test_law_that_believes_in_what_it_measures_can_be_simulated():
    """As every mode of hold_station(disturbance_measured=True) does."""
    law = replace(MEASURING.modes["ahead"], believed={"d": D})
    program = program_of(law, disturbance=TIDE)
    assert program.states == LINE.states


# -- the same in a scenario file


TEXT = """
[scenario]
title = "A line"

[system]
states = {{ x = {{ unit = "m" }} }}
inputs = {{ u = {{ unit = "m/s" }} }}
disturbances = {{ d = {{ unit = "m/s", bounds = [-1, 1] }} }}
parameters = {{ g = {{ value = 2.0, unit = "m/s" }} }}
empirical = "numbers"
rates = {{ x = "g*u + d" }}

[law]
parameters = {{ k = {{ value = 1.0, unit = "1/s" }} }}
outputs = {{ u = "-k*x/g" }}

[varied.draws]
{draws}

{tables}

[disturbance]
d = "{d}"

[starts]
states = [{{ x = 1 }}, {{ x = 1 }}, {{ x = 1 }}]

[run]
horizon = 1
continuous = true
"""
DIRECTION = 'direction = { range = ["-180 deg", "180 deg"], unit = "rad" }'


@pytest.fixture
def load(tmp_path):
    def load(draws=DIRECTION, tables="", d="0.2*cos(direction)", overrides=(), **given):
        file = tmp_path / "line.toml"
        file.write_text(TEXT.format(draws=draws, tables=tables, d=d))
        return hf.load_scenario(str(file), overrides, **given)

    return load


def test_scenario_draws_in_units(load):
    varied = load(
        DIRECTION + '\ng = ["50 cm/s", 3]\nspeed = { range = [0, "1 knot"], unit = "m/s" }'
    ).varied
    assert varied.draws["direction"] == pytest.approx((-np.pi, np.pi))
    assert varied.draws["g"] == pytest.approx((0.5, 3.0))
    assert varied.draws["speed"] == pytest.approx((0.0, 1852 / 3600))
    assert varied.units == {"direction": "rad", "g": "m/s", "speed": "m/s"}


def test_scenario_names_its_vertices_or_means_all_of_them(load):
    draws = DIRECTION + "\ng = [0.5, 3]"
    for tables, names in (
        ("[varied]\nvertices = true", ("direction", "g")),
        ('[varied]\nvertices = ["g"]', ("g",)),
        ("", ()),
    ):
        scenario = load(draws=draws, tables=tables)
        assert scenario.varied.vertices == names
        assert scenario.runs == scenario.run().dataset.sizes["run"] == 3 * 2 ** len(names)
    with pytest.raises(ScenarioError, match=r"line\.toml: varied.*vertices of 'gg'.*mean 'g'"):
        load(draws=draws, tables='[varied]\nvertices = ["gg"]')


def test_scenario_with_values_of_every_run_is_simulated_and_overridden(load):
    tables = '[varied.values]\nk = "1 + direction**2/10"\n[varied.plant]\ng = "3*g/2"'
    for overrides, low, high in (
        ((), -np.pi, np.pi),
        (('varied.draws.direction.range=["30 deg", "90 deg"]',), np.pi / 6, np.pi / 2),
        (("varied.draws.direction=[0.5, 0.75]",), 0.5, 0.75),
    ):
        found = load(tables=tables, overrides=overrides, seed=3).run()
        direction, k, g = found.dataset["varied"].values.T
        assert ((low < direction) & (direction < high)).all()
        assert k == pytest.approx(1 + direction**2 / 10, rel=1e-14)
        assert g == pytest.approx(3.0)
        rate = 1.5 * k  # the law divides by g = 2
        rest = 0.2 * np.cos(direction) / rate
        assert states(found)[:, -1] == pytest.approx(rest + (1 - rest) * np.exp(-rate), abs=1e-9)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"tables": "[varied.vlues]\nk = 1"}, r"varied\.vlues: unknown key; did you mean 'values'"),
        ({"draws": "k = [2, 1]"}, r"varied\.draws\.k: .*lowest first"),
        ({"draws": "k = [nan, 1]"}, r"varied\.draws\.k: got nan; expected a finite number"),
        ({"draws": "k = [1]"}, r"varied\.draws\.k: "),
        ({"draws": "k = 3"}, r"varied\.draws\.k: got 3"),
        ({"draws": "k = { rnge = [1, 2] }"}, r"varied\.draws\.k\.rnge: unknown key"),
        ({"draws": 'k = { unit = "1/s" }'}, r"varied\.draws\.k\.range: missing key"),
        (
            {"draws": 'k = { range = [1, 2], unit = "wink" }'},
            r"varied\.draws\.k: 'wink' is not a unit",
        ),
        (
            {"draws": 'g = ["1 kg", 2]'},
            r"varied\.draws\.g: the unit 'kg' does not fit; expected 'm/s'",
        ),
        ({"draws": "t = [1, 2]"}, r"varied\.draws\.t: 't' cannot name a quantity"),
        (
            {"tables": '[varied.values]\nk = "direcion"'},
            r"varied\.values\.k: .*did you mean 'direction'",
        ),
        ({"tables": '[varied.values]\nk = "x"'}, r"varied\.values\.k: unknown name 'x'"),
        ({"tables": '[varied.plant]\ng = "2*t"'}, r"varied\.plant\.g: unknown name 't'"),
        (
            {"tables": "[varied.values]\ndirection = 1"},
            "varied: 'direction' is both drawn and given",
        ),
        ({"draws": "", "d": "direction"}, r"disturbance\.d: unknown name 'direction'"),
        (
            {"overrides": ["varied.draws.direction=[1, 0]"]},
            r"varied\.draws\.direction: .*lowest first",
        ),
    ],
)
def test_scenario_that_varies_nonsense_is_refused_by_file_and_key(load, given, complaint):
    with pytest.raises(ScenarioError, match=rf"line\.toml: {complaint}"):
        load(**({"d": "0"} | given)).run()


@pytest.mark.parametrize(("table", "name"), [("values", "kk"), ("plant", "k")])
def test_scenario_that_varies_no_parameter_is_refused_by_its_key(load, table, name):
    with pytest.raises(ScenarioError, match=rf"line\.toml: varied.*'{name}'"):
        load(tables=f"[varied.{table}]\n{name} = 1", d="0").run()


def test_misspelt_key_of_a_draw_is_answered_with_the_right_one(load):
    with pytest.raises(ScenarioError, match="did you mean 'range'"):
        load("k = { rnge = [1, 2] }", d="0")


@pytest.mark.parametrize("name", ["x", "u", "d"])
def test_scenario_that_draws_what_moves_is_refused_by_its_key(load, name):
    with pytest.raises(ScenarioError, match=r"line\.toml: varied"):
        load(f"{name} = [1, 2]", d="0")


def test_scenario_draws_a_parameter_of_its_law_in_units(load):
    assert load('k = ["60 1/min", "2 1/s"]', d="0").varied.draws["k"] == pytest.approx((1.0, 2.0))


def test_scenario_never_takes_one_unit_for_another(load):
    """60 1/min as a unit of its own is refused; as numbers with their unit it is 1 1/s."""
    with pytest.raises(ScenarioError, match=r"varied\.draws\.k: 'k' has the unit 1/s"):
        load('k = { range = [60, 60], unit = "1/min" }', d="0")
    assert load('k = ["60 1/min", "60 1/min"]', d="0").varied.draws["k"] == pytest.approx((1, 1))


@pytest.mark.parametrize("draw", ["[0.4, 0.5]", '{ range = [0.4, 0.5], unit = "1/s" }'])
def test_scenario_draws_a_gain_of_a_catalogue_law_beside_a_goal_of_its_own(tmp_path, draw):
    file = tmp_path / "vane.toml"
    file.write_text(f"""
[scenario]
title = "Weathervane"
[system]
name = "drifting_unicycle"
[law]
name = "weathervane"
k1 = 0.5
[goal]
constraints = {{ distance = "x**2 + y**2 - 1" }}
[varied.draws]
k1 = {draw}
[starts]
states = [{{ x = 1 }}]
[run]
horizon = 1
""")
    scenario = hf.load_scenario(str(file))
    program = closed_loop_program(
        scenario.system,
        scenario.law,
        region=None,
        goal=scenario.goal,
        disturbance={},
        stepper=BY_NAME["rk4"],
        varied=scenario.varied,
    )
    assert {p.name: p.unit for p in program.parameters}["k1"] == "1/s"


@pytest.mark.few("changes2-both varied and given a number")
@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        (["varied.draws.port=[0, 0]"], "'port' is a state, an input, an actuator"),
        (["varied.draws.speeed=[0, 1]"], "nothing depends on it; did you mean"),
        (["plant.mass=6", "varied.plant.mass='mass*1.5'"], "both varied and given a number"),
    ],
)
def test_scenario_that_varies_what_it_may_not_is_refused(changes, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        hf.load_scenario("ch3-dynamic", changes, runs=2).run()


def test_limit_of_switches_may_be_any_number(tmp_path):
    scenario = hf.load_scenario(
        "ch3-noise", ["run.switch_limit=1000000000000", "run.horizon=1"], runs=2
    )
    assert scenario.run().outcomes["chattered"] == 0


def test_limits_of_a_varied_thrust_are_those_of_every_run():
    """What differs from run to run has a row for each; the rest is one number."""
    push, force = hf.symbol("push"), hf.symbol("force")
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"),), (hf.Quantity("push", "m/s"), hf.Quantity("tilt", "m/s")),
        {"x": push}, parameters=(hf.Parameter("force", "m/s", value=1.0),),
        input_bounds=hf.Box((-force, -sp.oo), (2 * force, 3)),
    )  # fmt: skip
    law = hf.Law("full", cart.states, {"push": sp.Float(9), "tilt": sp.Float(0)})
    drawn = hf.Varied(draws={"force": (1, 2)})
    each = hf.simulate(cart, law, starts=[[0.0]] * 3, horizon=0.1, varied=drawn).dataset
    own = each["varied"].sel(varied_name="force")
    assert np.array_equal(each["input_high"].sel(input_name="push"), 2 * own)
    assert np.array_equal(each["input_low"].sel(input_name="push"), -own)
    assert np.array_equal(each["peak_input"].sel(input_name="push"), 2 * own)
    one = hf.simulate(cart, law, starts=[[0.0]], horizon=0.1).dataset
    assert one["input_low"].values.tolist() == [-1.0, -np.inf]
    assert one["input_high"].values.tolist() == [2.0, 3.0]


# -- cases: the same runs with other numbers


def _decay(**more):
    """x' = -k x + d, with d drawn for every run."""
    x, k, d = (hf.symbol(n) for n in ("x", "k", "d"))
    u = hf.symbol("u")
    system = hf.System(
        "decay", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": u + d},
        parameters=(hf.Parameter("d", value=0.0),),
    )  # fmt: skip
    law = hf.Law("law", system.states, {"u": -k * x}, (hf.Parameter("k", "1/s", value=1.0),))
    starts = hf.Starts(random=3, box={"x": (1.0, 2.0)})
    varied = hf.Varied({"d": (0.0, 1.0)}, **more)
    return hf.simulate(system, law, starts=starts, horizon=1.0, varied=varied, seed=3)


def test_cases_are_the_same_runs_with_other_numbers():
    """Every start has the same draws in every case; a case alone is the same to the bit."""
    found = _decay(cases={"k": [1.0, 2.0, 4.0]}).arrays["state"].values.reshape(3, 3, -1)
    for place, k in enumerate((1.0, 2.0, 4.0)):
        alone = _decay(cases={"k": [k]}).arrays["state"].values
        assert (found[:, place].ravel() == alone.ravel()).all()
    usual = _decay().arrays["state"].values  # k = 1
    assert (found[:, 0].ravel() == usual.ravel()).all()


def test_cases_and_vertices_are_combined():
    data = _decay(cases={"k": [1.0, 2.0]}, vertices=("d",)).arrays
    rows = data["varied"].values.reshape(3, 2, 2, 2)  # start, case, vertex, (d, k)
    assert [str(n) for n in data["varied_name"].values] == ["d", "k"]
    assert (rows[:, :, :, 0] == [0.0, 1.0]).all()
    assert (rows[:, 0, :, 1] == 1.0).all()
    assert (rows[:, 1, :, 1] == 2.0).all()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"cases": {"k": [1.0], "d2": [1.0, 2.0]}}, "different numbers of values"),
        ({"cases": {"k": []}}, "expected at least one finite number"),
        ({"cases": {"k": [float("nan")]}}, "expected at least one finite number"),
        ({"cases": {"d": [1.0]}}, "'d' has cases and is drawn"),
        ({"cases": {"q": [1.0]}}, "unknown parameter 'q'"),
    ],
)
def test_cases_that_are_none_are_refused(given, says):
    with pytest.raises(hf.HoldfastError, match=says):
        _decay(**given)
