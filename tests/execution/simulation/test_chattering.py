"""Chattering as an outcome: when it counts, since when, and what it does not hide."""

import json

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.maths.expressions.functions import least, magnitude
from tests.command_line import called

X, U = hf.symbol("x"), hf.symbol("u")
STEEPNESS, DWELL, REST, UNTIL, GROWTH = (
    hf.symbol(n) for n in ("steepness", "dwell", "rest", "until", "growth")
)
TS = 1e-3

LINE = hf.System(
    "line",
    (hf.Quantity("x", "m"),),
    (hf.Quantity("u", "m/s"),),
    {"x": U + GROWTH * X**3},
    (hf.Parameter("growth", "1/(m^2 s)", value=0.0),),
)
AROUND = hf.Region(
    "around",
    LINE.states,
    (hf.Inequality("edge", magnitude(X) - hf.symbol("edge"), "m"),),
    (hf.Parameter("edge", "m", value=10.0),),
)
NEAR = hf.Region("near", LINE.states, (hf.Inequality("near", magnitude(X) - 0.01, "m"),))


def switching(steepness, dwell, rest, until):
    """Down at -1 m/s where x > 0, up at 1 m/s where x < 0; at least `dwell` s up and `rest` s
    down, no change after `until`. With steepness = 0 it changes as soon as it may, wherever x is.
    """
    parameters = (
        hf.Parameter("steepness", "1", value=steepness),
        hf.Parameter("dwell", "s", value=dwell),
        hf.Parameter("rest", "s", value=rest),
        hf.Parameter("until", "s", value=until),
    )

    def guard(level, dwell):
        return least(STEEPNESS * level, least(hf.TIME_IN_MODE - dwell, UNTIL - hf.TIME))

    return hf.Switching(
        "bang_bang",
        {
            "down": hf.Law("down", LINE.states, {"u": -sp.S.One}, parameters),
            "up": hf.Law("up", LINE.states, {"u": sp.S.One}, parameters),
        },
        (
            hf.Transition("down", "up", guard(-X, REST)),
            hf.Transition("up", "down", guard(X, DWELL)),
        ),
    )


def run(
    *starts, dwell=0.0, rest=None, until=100.0, steepness=1.0, edge=10.0, growth=0.0, **settings
):
    """One compiled program: every number above is a parameter of it."""
    chosen = {"horizon": 0.5, "record_every": TS} | settings
    system = hf.System(
        LINE.name,
        LINE.states,
        LINE.inputs,
        LINE.rates,
        (hf.Parameter("growth", "1/(m^2 s)", value=growth),),
    )
    region = hf.Region(
        AROUND.name, LINE.states, AROUND.inequalities, (hf.Parameter("edge", "m", value=edge),)
    )
    return hf.simulate(
        system,
        switching(steepness, dwell, dwell if rest is None else rest, until),
        starts=[[x] for x in starts],
        region=region,
        goal=NEAR,
        sample_time=TS,
        substeps=1,
        **chosen,
    )


def sliding(*starts, **given):
    """At 1 ms x falls from x(0) until it is 0 or less, then the mode changes in every sample."""
    return run(*(starts or (0.0995,)), **given)


def clock(dwell, **given):
    return run(0.0, steepness=0.0, dwell=dwell - TS / 2, **given)


def first(result, name):
    return result.dataset[name].values[0]


def outcome(result):
    return hf.Outcome(int(first(result, "outcome")))


def changes(result, at=0):
    """The times at which the recorded mode of a run changed, every sample being recorded."""
    data = result.dataset
    mode = np.concatenate([[0], data["mode"].values[at]])
    return data["time"].values[np.flatnonzero(np.diff(mode))]


def test_sliding_law_chatters_from_its_eleventh_change_on():
    """From x = 99.5 mm: x(0.1) = -0.5 mm, a change at 100 ms and at every sample after it, the
    eleventh at 110 ms."""
    result = sliding()
    assert outcome(result) == hf.Outcome.CHATTERED
    assert first(result, "exit_time") == pytest.approx(0.110, abs=1e-12)
    assert first(result, "exit_constraint") == -1
    assert changes(result) == pytest.approx(np.arange(100, 501) * TS)
    assert first(result, "switches") == 401
    assert changes(result)[10] == pytest.approx(first(result, "exit_time"))
    assert first(result, "shortest_dwell") == pytest.approx(TS, rel=1e-9)
    assert result.outcomes["chattered"] == 1
    assert np.isfinite(result.dataset["state"].values).all()  # it is simulated to the end


@pytest.mark.parametrize(("dwell", "chatters"), [(0.099, True), (0.100, False), (0.250, False)])
def test_more_than_ten_changes_within_a_second_are_too_many(dwell, chatters):
    """Every 100 ms: the eleventh is one second after the first, and the second is over."""
    result = clock(dwell, horizon=3.0)
    assert changes(result) == pytest.approx(np.arange(1, len(changes(result)) + 1) * dwell)
    assert (outcome(result) == hf.Outcome.CHATTERED) == chatters
    if chatters:
        assert first(result, "exit_time") == pytest.approx(11 * dwell)
    else:
        assert np.isnan(first(result, "exit_time"))


def test_as_many_changes_as_allowed_do_not_count_and_one_more_does():
    """After 109.5 ms no mode changes: ten changes from 99.5 mm, eleven from 98.5 mm. Runs that
    share a thread do not share their counts."""
    result = sliding(*[0.0985, 0.0995] * 4, until=0.1095, threads=1)
    assert list(result.dataset["switches"].values) == [11, 10] * 4
    chattered, stayed = hf.Outcome.CHATTERED, hf.Outcome.STAYED
    assert list(result.dataset["outcome"].values) == [chattered, stayed] * 4
    assert result.dataset["exit_time"].values[::2] == pytest.approx(0.109)
    assert np.isnan(result.dataset["exit_time"].values[1::2]).all()


@pytest.mark.few("999-1.099", "1000-None")
@pytest.mark.parametrize(
    ("limit", "began"), [(1, 0.101), (2, 0.102), (40, 0.140), (999, 1.099), (1000, None)]
)
def test_raised_limit_reports_later_or_not_at_all(limit, began):
    """At 1 kHz any second holds 1000 changes; the limit changes the outcome, not the motion."""
    result, usual = (sliding(horizon=2.0, **s) for s in ({"switch_limit": limit}, {}))
    if began is None:
        assert outcome(result) == hf.Outcome.REACHED
        assert np.isnan(first(result, "exit_time"))
    else:
        assert outcome(result) == hf.Outcome.CHATTERED
        assert first(result, "exit_time") == pytest.approx(began)
    for name in ("state", "mode", "switches", "shortest_dwell"):
        assert np.array_equal(result.dataset[name].values, usual.dataset[name].values)


@pytest.mark.parametrize("limit", [0, -1, 2.5])
def test_limit_that_is_no_number_of_changes_is_refused(limit):
    with pytest.raises(SimulationError, match=r"switch_limit is .* expected a whole number >= 1"):
        sliding(switch_limit=limit)


def test_dwell_time_cures_the_chattering():
    """At least 120 ms in a mode: |x| stays within 120 mm, and no second has eleven changes."""
    cured = sliding(dwell=0.1195, horizon=4.0)
    assert outcome(cured) == hf.Outcome.STAYED
    assert first(cured, "shortest_dwell") >= 0.12 - 1e-9
    assert first(cured, "switches") > 10
    arrived = cured.dataset["time"].values >= 0.1
    assert np.abs(cured.dataset["state"].values[0, arrived]).max() < 0.121
    assert outcome(sliding(dwell=0.0195, horizon=4.0)) == hf.Outcome.CHATTERED


def test_shortest_dwell_is_between_changes_not_from_the_start_or_to_the_end():
    """The first change after 5 ms, the others every 30 ms, the last 25 ms before the end."""
    result = sliding(0.0045, dwell=0.0295, rest=0.0, horizon=0.21)
    assert changes(result) == pytest.approx(0.005 + 0.03 * np.arange(7))
    assert first(result, "shortest_dwell") == pytest.approx(0.03, rel=1e-9)


def test_shortest_dwell_is_that_of_the_shorter_mode():
    """Up for 10 ms, down for 30 ms, in turn."""
    result = clock(0.010, rest=0.0295)
    assert np.diff(changes(result))[:4] == pytest.approx([0.01, 0.03, 0.01, 0.03])
    assert first(result, "shortest_dwell") == pytest.approx(0.01, rel=1e-9)


def test_one_change_of_mode_has_no_dwell_between_changes():
    result = sliding(until=0.1005)
    assert (first(result, "switches"), first(result, "shortest_dwell")) == (1, np.inf)


def test_run_without_a_change_of_mode_has_no_shortest_dwell():
    result = sliding(5.0)
    assert first(result, "switches") == 0
    assert np.isinf(first(result, "shortest_dwell"))
    assert result.summary()["switching"] == {
        "median_per_minute": 0.0,
        "worst_per_minute": 0.0,
        "shortest_dwell": None,
    }


def test_run_that_leaves_after_it_chattered_has_left():
    """It slides at zero up to 200 ms and goes up from there, -0.5 mm, to the edge at 200 mm."""
    result = sliding(until=0.2005, edge=0.2)
    assert first(result, "switches") == 101
    assert outcome(result) == hf.Outcome.LEFT
    assert first(result, "exit_time") == pytest.approx(0.4005, abs=1e-9)
    assert first(result, "exit_constraint") == 0
    assert result.viable == 0
    assert result.outcomes["chattered"] == 0


def test_run_that_left_before_it_chatters_keeps_when_it_left():
    """The edge is at 50 mm, the start at 99.5 mm."""
    result = sliding(edge=0.05, start_outside=True)
    assert outcome(result) == hf.Outcome.LEFT
    assert first(result, "exit_time") == 0.0
    assert first(result, "switches") == 401


def test_run_that_chatters_and_then_diverges_has_diverged_at_that_time():
    """After 200 ms x grows from +-0.5 mm at 1 m/s, and x' = 1 + 1e6 x^3 blows up at
    2 pi / (3 sqrt 3) 1e-2 s; the start is within the equilibrium at 10 mm."""
    result = sliding(0.0055, growth=1e6, until=0.2005, edge=1e12)
    assert outcome(result) == hf.Outcome.DIVERGED
    assert 0.2 < first(result, "exit_time") < 0.22
    assert result.outcomes["chattered"] == 0


def test_chattering_in_the_goal_is_not_reaching_it():
    """|x| <= 10 mm from 90 ms on, for good."""
    result = sliding()
    assert first(result, "goal_time") == pytest.approx(0.090, abs=1e-9)
    assert result.success_fraction == 0.0
    assert result.viable == 1
    summary = result.summary()
    assert summary["in_goal_since"] == {
        "median": first(result, "goal_time"),
        "worst": first(result, "goal_time"),
    }
    assert summary["outcomes"] == {
        "reached goal": 0,
        "stayed": 0,
        "chattered": 1,
        "left grid": 0,
        "left region": 0,
        "diverged": 0,
    }


def test_summary_counts_changes_by_the_minute():
    """401 changes in 0.5 s and none in the other run."""
    switched = sliding(0.0995, 5.0).summary()["switching"]
    assert switched["worst_per_minute"] == pytest.approx(401 * 120)
    assert switched["median_per_minute"] == pytest.approx(401 * 60)
    assert switched["shortest_dwell"] == pytest.approx(TS)


def test_result_without_what_an_older_version_did_not_count_has_a_summary():
    """load() takes results of an older version; what they lack is not counted."""
    older = hf.Result(sliding().dataset.drop_vars(["shortest_dwell", "varied", "varied_name"]))
    assert older.summary()["outcomes"]["chattered"] == 1


# -- on the command line


TEXT = """
[scenario]
title = "Sliding"

[system]
states = { x = { unit = "m" } }
inputs = { u = { unit = "m/s" } }
rates = { x = "u" }

[law]
modes = { down = { outputs = { u = "-1" } }, up = { outputs = { u = "1" } } }
transitions = [
    { from = "down", to = "up", when = "x <= 0" },
    { from = "up", to = "down", when = "x >= 0" },
]

[starts]
states = [{ x = 0.0995 }, { x = 5 }]

[run]
horizon = 0.5
sample_time = 0.001
record_every = 0.01
"""


def test_command_line_says_that_a_run_chattered_and_exits_with_one(tmp_path):
    (tmp_path / "sliding.toml").write_text(TEXT)

    run = ("run", "sliding.toml", "--no-figures", "--set")
    answer = called(*run, "run.switch_limit=12", cwd=tmp_path)
    assert answer.returncode == 1, answer.stderr
    said = "1 run chattered: more than 12 changes of mode within a second"
    assert answer.stderr.count(said) == 1
    assert "Traceback" not in answer.stderr
    assert "chattered      1 of 2 runs (50.0 %)" in answer.stdout
    folder = tmp_path / "runs" / "sliding"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["outcomes"]["chattered"] == 1
    times = hf.load(folder / "result.nc").dataset["exit_time"].values
    assert times == pytest.approx([0.112, np.nan], nan_ok=True)

    answer = called(*run, "run.switch_limit=1000", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "chattered" not in answer.stdout + answer.stderr
