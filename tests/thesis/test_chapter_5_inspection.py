"""What README and docs/rescue.md say of `holdfast compare inspection`: its starts, horizon, cases."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.simulation.law_comparison import Rate
from holdfast.maths.control.gain_conditions import surge_gain_limit
from holdfast.studies.comparison import variant

ROOT = Path(__file__).parents[2]
NOMINAL = "safeguard.uncertain="
STILL = ("5 N", "0.3 N", "corners", "model")


@pytest.fixture(scope="module")
def results():
    """600 starts of the box of `inspection`, 150 s, in every case of its comparison."""
    whole = ["run.record_every=150.0"]
    return {
        case: variant("inspection", "inspection", case, 600, whole).run()
        for case in (*STILL, "current")
    }


def test_every_start_stays_in_view_in_every_case_that_the_readme_names(results):
    for case, result in results.items():
        runs = 2400 if case == "model" else 600
        assert (result.viable, result.dataset.sizes["run"]) == (runs, runs), case
        assert max(result.summary()["worst_constraint"].values()) <= 1e-3, case


def test_every_corner_of_a_model_wrong_by_a_fifth_keeps_every_start(results):
    """Inertia and drag both 20 % up or down: 600 of 600 at each of the four vertices."""
    vertices = results["model"].summary()["vertices"]
    corners = sorted((v["at"]["inertia"], v["at"]["drag"]) for v in vertices)
    assert corners == [(0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2)]
    for v in vertices:
        assert (v["runs"], v["viable"], v["reached"], v["samples_relaxed"]) == (600, 600, 600, 0)


def test_an_input_is_admissible_at_every_sample_in_still_water_but_at_one_start_with_weak_thrusters(
    results,
):
    """0.3 N cannot brake at once the start that lies on two limits: 18 samples of 20 ms.

    The measured current leaves ten runs without one for every model of the box, for 1.9 s at most.
    """
    for case, result in results.items():
        samples = result.dataset["infeasible"].values
        if case == "0.3 N":
            assert np.flatnonzero(samples).tolist() == [1]
            assert samples[1] == 18
        elif case == "current":
            assert ((samples > 0).sum(), samples.max()) == (10, 94)
        else:
            assert samples.max() == 0, case


def test_vehicle_arrives_in_still_water_and_does_not_in_a_current(results):
    """It cannot move sideways: in 0.1 m/s of any direction none of 600 is at the pose at 150 s.

    Half of them are more than 7 m along the wall by then, one 86 m: the region has no limit there.
    """
    for case in STILL:
        assert results[case].success_fraction == 1, case
    assert results["current"].outcomes["reached goal"] == 0
    carried = np.abs(results["current"].dataset["state"].values[:, -1, 1])
    assert np.median(carried) == pytest.approx(7.1, abs=0.5)
    assert carried.max() == pytest.approx(86, abs=3)


def test_third_of_the_starts_goes_straight_to_the_pose_and_few_turn_back_twice(results):
    """5 N: 202 of 600 need no turn back, 361 one and 37 two; a turn ends two legs."""
    turns = (results["5 N"].dataset["switches"].values + 1) // 2
    assert np.bincount(turns).tolist() == [202, 361, 37]


def test_table_of_the_flagship_is_what_its_comparison_gives(results):
    """docs/rescue.md, case by case: viable, at the pose at the end, without an admissible input."""
    page = (ROOT / "docs" / "rescue.md").read_text("utf-8")
    section = page[page.index("## The flagship, case by case") :].split("\n## ")[0]
    lines = re.findall(r"^\|.*$", section, re.M)[2:]
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in lines]
    for row, case in zip(rows, ("5 N", "0.3 N", "corners", "model", "current"), strict=True):
        result = results[case]
        counts = {
            "runs": result.dataset.sizes["run"],
            "viable": result.viable,
            "reached": result.outcomes["reached goal"],
            "runs_relaxed": int((result.dataset["infeasible"].values > 0).sum()),
        }
        for c in result.summary()["vertices"] or [counts]:
            assert row[1:3] == [f"{c['viable']} of {c['runs']}", str(c["reached"])], case
            assert int(re.match(r"\d+", row[3])[0]) == c["runs_relaxed"], case


def test_intervals_of_the_rates_of_600_starts_are_those_stated():
    """docs/rescue.md: of .97 .95 to .98, of 1 .994 to 1."""
    low, high = Rate(582, 600).interval
    assert (low, high) == pytest.approx((0.95, 0.98), abs=0.005)
    assert Rate(600, 600).interval == pytest.approx((0.994, 1), abs=5e-4)


def test_intervals_of_the_rates_judged_by_the_kernel_are_those_stated():
    """docs/rescue.md: of .999 .997 to 1 (5 N), of 1 .996 to 1 (1 N), .02 and .04 elsewhere."""
    for count, total, least in ((2757, 2759, 0.997), (913, 913, 0.996)):
        assert Rate(count, total).interval == pytest.approx((least, 1), abs=5e-4)
    for total, rates, most in (
        (2759, (0.178, 0.884, 0.913, 0.925), 0.02),
        (913, (0.952, 0.960, 0.981), 0.02),
        (913, (0.405,), 0.041),
    ):
        for rate in rates:
            low, high = Rate(round(rate * total), total).interval
            assert max(high - rate, rate - low) < most


def test_gains_of_the_flagship_are_below_the_gain_limit_at_every_corner_of_the_model():
    """k1 mu = 0.18 1/s; the least limit of (5.18), 0.234 1/s, has more inertia and less drag."""
    scenario = hf.load_scenario("inspection")
    p = {q.name: sp.Float(q.value) for q in (*scenario.system.parameters, *scenario.law.parameters)}
    inertias = p["mass"] - p["Xudot"], p["mass"] - p["Yvdot"]
    limits = {
        (m, d): float(surge_gain_limit(d * p["Yv"], *(m * i for i in inertias), sp.Integer(3)))
        for m in (0.8, 1.2)
        for d in (0.8, 1.2)
    }
    assert float(p["k1"] * p["mu"]) == pytest.approx(0.18)
    assert min(limits, key=limits.get) == (1.2, 0.8)
    assert limits[1.2, 0.8] == pytest.approx(0.234, abs=5e-4)


def test_vehicle_that_is_told_the_current_seldom_changes_its_leg(results):
    """The law without a limit of the heading changed its mode 2,240 times a minute."""
    assert results["current"].summary()["switching"]["worst_per_minute"] < 30


@pytest.mark.heavy
def test_starts_that_a_measured_current_takes_lie_millimetres_before_a_limit():
    """Of 2,400 starts three: within 4 mm or 4 mrad of a limit, across it by 2 mm within 0.1 s.

    In 62 runs the conditions cannot all be met for up to 94 steps of 20 ms.
    """
    data = (
        variant("inspection", "inspection", "current", 2400, ["run.record_every=150.0"])
        .run()
        .dataset
    )
    lost = np.flatnonzero(data["outcome"].values == hf.Outcome.LEFT)
    assert len(lost) == 3
    assert data["exit_time"].values[lost].max() < 0.1
    assert data["constraint"].values[lost, 0].max(axis=1).min() > -4e-3
    assert data["worst_constraint"].values[lost].max() == pytest.approx(2e-3, abs=5e-5)
    unmet = data["infeasible"].values
    assert (np.count_nonzero(unmet), unmet.max(), np.count_nonzero(unmet[lost])) == (62, 94, 1)


def test_numbers_of_the_readme_are_these():
    text = " ".join((ROOT / "README.md").read_text("utf-8").split())
    (sentence,) = re.findall(r"Of 600 starts[^.]*(?:\.\d[^.]*)*\.", text)
    for words in ("0.3 N", "two constraints active", "64 corners", "0.1 m/s", "measured"):
        assert words in sentence, words


def test_legs_of_the_comparison_of_laws_are_those_of_the_flagship():
    """What docs/rescue.md says of the legs of `ch5-rescue` is said of `inspection` without its box."""
    ours, theirs = hf.load_scenario("inspection", [NOMINAL]), hf.load_scenario("ch5-rescue")
    assert ours.law == theirs.law
    assert ours.region == theirs.region


# -- the sampling of docs/rescue.md, `benchmarks/sampling.py`


@pytest.fixture(scope="module")
def sampled():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import sampling
    finally:
        sys.path.pop(0)
    return lambda *given: sampling.viable("ch5-rescue", "5 N", *given)


def test_a_tenth_of_a_second_between_samples_and_as_much_delay_cost_no_start(sampled):
    """60 starts, 150 s: 50 Hz with 0.1 s, 20 Hz with 0.05 s, 10 Hz with 0.1 s of delay."""
    for period, delay in ((0.02, 0.1), (0.05, 0.05), (0.1, 0.1)):
        assert sampled(period, delay, 60) == 60, (period, delay)


def test_a_fifth_of_a_second_between_samples_and_as_much_delay_lose_nearly_every_start(sampled):
    assert sampled(0.2, 0.0, 60) == 60
    with (
        pytest.warns(hf.GainWarning, match="beyond a delay of 0.0787 s"),
        pytest.warns(hf.GainWarning, match=r"kv\*\(delay \+ sample_time\) = 0.8 is above"),
    ):
        assert sampled(0.2, 0.2, 60) < 10


# -- the box of the model: inertia and drag of every axis


@pytest.fixture(scope="module")
def model_box():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import model_box
    finally:
        sys.path.pop(0)
    return model_box


def test_box_of_the_flagship_is_inertia_and_drag_of_every_axis_wrong_by_a_fifth():
    """9 parameters, 64 vertices of the case: no vehicle of the case is outside the filter's box."""
    scenario = hf.load_scenario("inspection")
    counted = {p.name: p.value for p in scenario.law.parameters}
    value = {p.name: p.value for p in scenario.system.parameters}
    for name, rigid in (("Xudot", "mass"), ("Yvdot", "mass"), ("Nrdot", "Iz")):
        ends = [value[rigid] - counted[name + end] for end in ("_most", "_least")]
        inertia = value[rigid] - value[name]
        assert ends == pytest.approx([0.8 * inertia, 1.2 * inertia], rel=1e-9)
    for name in ("Xu", "Xuu", "Yv", "Yvv", "Nr", "Nrr"):
        ends = [counted[name + end] for end in ("_most", "_least")]
        assert ends == pytest.approx([0.8 * value[name], 1.2 * value[name]], rel=1e-9)
    munk = [1.2 * (value["mass"] - value["Yvdot"]) - 0.8 * (value["mass"] - value["Xudot"])]
    munk.append(value["Xudot"] - value["Yvdot"])
    assert munk[0] / munk[1] - 1 == pytest.approx(0.91, abs=0.01)
    modes = scenario.law.modes.values()
    assert {len(law.safeguard.offsets) - law.safeguard.hard for law in modes} == {18}  # of 6
    case = variant("inspection", "inspection", "axes", 1, [])
    assert case.varied.turns == 64


def test_every_vertex_of_the_model_keeps_a_few_starts(model_box):
    """5 starts, 150 s, all 64 vertices; the filter of the nominal model loses some of them."""
    result = model_box.vertices(31, 5).run()
    assert (result.viable, result.dataset.sizes["run"]) == (320, 320)
    assert result.dataset["infeasible"].values.max() == 0


@pytest.mark.heavy
@pytest.mark.parametrize("seed", [7, 20261126])
@pytest.mark.parametrize("starts", [203, 600])
def test_every_vertex_of_the_model_keeps_every_start(model_box, starts, seed):
    """203 and 600 starts, 150 s, 5 N, 64 vertices: all stay, an input is admissible throughout."""
    result = model_box.vertices(seed, starts).run()
    runs = 64 * starts
    assert (result.viable, result.dataset.sizes["run"]) == (runs, runs)
    assert result.outcomes["reached goal"] == runs
    assert result.dataset["infeasible"].values.max() == 0
    assert max(result.summary()["worst_constraint"].values()) <= 1e-3


@pytest.mark.heavy
def test_filter_of_the_nominal_model_loses_the_far_limit_where_surge_is_light_and_sway_heavy(
    model_box,
):
    """203 starts, seed 1: 12,698 of 12,992, the fewest 162, all lost across the far limit."""
    result = model_box.vertices(1, 203, NOMINAL).run()
    vertices = {tuple(v["at"].values()): v["viable"] for v in result.summary()["vertices"]}
    assert (result.viable, result.dataset.sizes["run"]) == (12_698, 12_992)
    assert min(vertices.values()) == 162
    assert min(vertices, key=vertices.get)[:2] == (0.8, 1.2)
    crossed = {n for n, c in result.summary()["worst_constraint"].items() if c > 1e-3}
    assert crossed == {"too_far"}


@pytest.mark.heavy
def test_weak_thrusters_keep_every_start_at_every_vertex_with_a_slower_law(model_box):
    """0.3 N, 203 starts, seed 1, 64 vertices: 12,975 of 12,992, and all with k1 = 0.14 m/s."""
    weak = "system.thrust_limit=0.3"
    assert model_box.vertices(1, 203, weak).run().viable == 12_975
    assert model_box.vertices(1, 203, weak, "law.k1=0.14").run().viable == 12_992


@pytest.mark.heavy
def test_table_of_what_no_box_counts_is_what_the_benchmark_gives(model_box):
    """docs/rescue.md: 200 starts, 150 s, of both filters in every case beyond the box."""
    header = "| case | filter of the nominal model | filter of the box |"
    page = (ROOT / "docs" / "rescue.md").read_text("utf-8").split(header)[1]
    for case in model_box.BEYOND:
        nominal, box = (model_box.beyond(case, 200, 1, *o).viable for o in ((NOMINAL,), ()))
        assert f"| {case} | {nominal} | {box} |" in page
