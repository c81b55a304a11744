"""The law of a certificate with a target arrives in the time that it says, whatever acts."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, ScenarioError, SimulationError
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.expressions.functions import sgn
from tests.adversary import starts_in
from tests.c_code import built, needs_gcc
from tests.certified_laws import MANY, answers, in_c
from tests.certified_systems import PSI, Y, rows, to_goal, vehicle

AWAY, SWINGING = -sp.Integer(1) / 20, sgn(sp.sin(7 * TIME)) / 20
ACROSS = sgn(sp.sin(PSI) * (1 - Y)) / 20


@pytest.fixture(scope="module")
def parked():
    return to_goal()


def run(found, law, starts, w, **more):
    system, room, goal = vehicle()
    return hf.simulate(
        system, law, starts=starts, region=room, goal=goal, horizon=12, sample_time=found.hold,
        record_every=found.hold, substeps=20, tolerance=1e-9, disturbance={"w": w}, **more,
    )  # fmt: skip


@pytest.mark.heavy
@pytest.mark.parametrize("w", [AWAY, SWINGING, ACROSS])
def test_thousand_starts_arrive_in_the_time_that_remains_and_leave_the_room_nowhere(parked, w):
    starts = starts_in(parked, parked.kept.members, 1000, 21)
    result = run(parked, hf.certified_law(parked), starts, w, until_goal=True)
    assert result.outcomes["reached goal"] == 1000
    says = result.arrays["signal"].values[:, 0, 0]
    took = result.arrays["goal_time"].values
    assert (took <= says + 1e-9).all()
    assert says.max() > 4
    falls = np.diff(result.arrays["signal"].values[:, :, 0], axis=1)
    assert (falls[np.isfinite(falls)] <= -parked.hold + 1e-12).all()


def test_vehicle_that_has_arrived_stays_at_the_target_or_comes_back(parked):
    """The run goes on: the law has a cell at every sample, almost all of them of the target."""
    starts = starts_in(parked, parked.kept.members, 500, 22)
    result = run(parked, hf.certified_law(parked), starts, SWINGING)
    assert [result.outcomes[k] for k in ("left grid", "left region")] == [0, 0]
    assert result.outcomes["reached goal"] > 490
    says = result.arrays["signal"].values[:, :, 0]
    there = np.cumsum(says == 0, axis=1) > 0
    assert there[np.arange(500), np.round(says[:, 0] / parked.hold).astype(int)].all()
    assert (says[there] == 0).mean() > 0.95


def test_input_is_that_of_the_entry_and_the_time_is_its_level(parked):
    low, high = parked.cells.corners(parked.kept.entries[:, 0])
    controller = hf.Controller(vehicle()[0], hf.certified_law(parked))
    for k in range(0, len(low), 1000):
        said = controller.step(0.5 * (low[k] + high[k]))
        assert said.value == parked.kept.entries[k, 2] * parked.hold
        assert np.array_equal(said.input, parked.candidates[parked.kept.entries[k, 1]])
        assert not said.outside
    arrived, lost = controller.step([2.6, 0.4, 1.0]), controller.step([1.2, 0.5, 0.0])
    assert (arrived.value, arrived.outside) == (0.0, False)
    assert (lost.value, lost.outside) == (0.0, True)


def test_run_ends_at_its_first_sample_in_the_goal(parked):
    starts = starts_in(parked, parked.kept.members, 50, 23)
    law = hf.certified_law(parked)
    ends, goes_on = (run(parked, law, starts, AWAY, until_goal=u) for u in (True, False))
    took = ends.arrays["goal_time"].values
    last = np.round(took / parked.hold).astype(int)
    states = ends.arrays["state"].values
    same = goes_on.arrays["state"].values
    for k in range(50):
        assert np.array_equal(states[k, : last[k] + 1], same[k, : last[k] + 1])
        assert np.isnan(states[k, last[k] + 1 :]).all()
    system, room, _ = vehicle()
    with pytest.raises(SimulationError, match="until_goal without a goal"):
        hf.simulate(
            system, law, starts=starts, region=room, horizon=1, sample_time=0.25,
            record_every=0.25, until_goal=True,
        )  # fmt: skip


@needs_gcc
def test_law_to_a_target_in_c_has_the_bits_of_the_simulated_one(parked, tmp_path):
    system = vehicle()[0]
    law = hf.certified_law(parked)
    c = built(tmp_path, hf.export_c(system, law, "law"), "law", MANY)
    rng = np.random.default_rng(24)
    states = rng.uniform([-0.2, -0.2, -9], [3.2, 2.2, 9], (20_000, 3))
    commands, outside = in_c(c, states, 2)
    expected, known = answers(system, law, parked, len(states))(states)
    assert np.array_equal(commands.view(np.int64), expected.view(np.int64))
    assert np.array_equal(outside == 0, known)
    assert 2000 < known.sum() < 18_000


def test_commands_that_lead_closer_pass_and_every_run_arrives_whatever_is_asked(parked):
    """Half of the commands are of the law, half are any: some of both kinds are changed or pass."""
    system = vehicle()[0]
    keep = hf.CertifiedFilter(parked, system)
    starts = starts_in(parked, parked.kept.members, 300, 25, corners=0)
    answer = answers(system, hf.certified_law(parked), parked, 300)
    rng = np.random.default_rng(26)

    def asked(t, q):
        some = rng.uniform(-1.2, 1.2, (300, 2)) * [1.0, 1.5]
        return np.where(rng.uniform(size=(300, 1)) < 0.5, some, answer(q)[0])

    result = run(parked, hf.commanded(system), starts, AWAY, command=keep.around(asked),
                 until_goal=True)  # fmt: skip
    assert result.outcomes["reached goal"] == 300
    says = keep.step_many(starts, np.zeros((300, 2))).value
    assert (result.arrays["goal_time"].values <= says + 1e-9).all()


def test_filter_says_when_the_target_is_reached_and_why_a_command_is_changed(parked):
    keep = hf.CertifiedFilter(parked, vehicle()[0])
    low, high = parked.cells.corners(parked.kept.members)
    x = 0.5 * (low + high)[len(low) // 3]
    own = hf.Controller(keep.system, hf.certified_law(parked)).step(x)
    passed = keep.step(x, own.input)
    assert (passed.status, passed.value) == (hf.Status.PASSED, own.value)
    assert "leads to the target or cells that lead to it" in passed.why
    back = keep.step(x, -own.input)
    assert back.status is hf.Status.CHANGED
    assert "closer to the target" in back.why
    there = keep.step([2.6, 0.4, 1.0], [0.0, 0.0])
    assert (there.status, there.value) == (hf.Status.PASSED, 0.0)
    lost = keep.step([1.2, 0.5, 0.0], [0.0, 0.0])
    assert (lost.status, lost.value) == (hf.Status.OUTSIDE_GRID, 0.0)


SCENARIO = """
[scenario]
title = "To a goal by its certificate"

[system]
states = {{ x = {{ unit = "m" }}, y = {{ unit = "m" }}, psi = {{ unit = "rad" }} }}
inputs = {{ u = {{ unit = "m/s", bounds = [-1, 1] }}, r = {{ unit = "rad/s", bounds = [-1.5, 1.5] }} }}
disturbances = {{ w = {{ unit = "m/s", bounds = [-{most}, {most}] }} }}
rates = {{ x = "u*cos(psi) + w", y = "u*sin(psi)", psi = "r" }}

[law]
certificate = "{file}"

[goal]
constraints = {{ far = {{ expression = "{far} - x", unit = "m" }}, low = {{ expression = "y - 0.8", unit = "m" }} }}

[starts]
random = 50
box = {{ x = [0.2, 0.8], y = [0.4, 1.6], psi = [-1, 1] }}

[run]
horizon = 12
sample_time = 0.25
record_every = 0.25
until_goal = true

[disturbance]
w = {w}
"""


@pytest.mark.heavy
def test_scenario_of_a_certificate_with_a_target_arrives(parked, tmp_path):
    file = parked.write(tmp_path / "parked.holdfast")

    def loaded(far="2.2", most=0.05, w="-0.05"):
        path = tmp_path / "to_goal.toml"
        path.write_text(SCENARIO.format(file=file, far=far, most=most, w=w))
        return hf.load_scenario(str(path))

    assert loaded().run().outcomes["reached goal"] == 50
    with pytest.raises(ScenarioError, match="'far' of the goal is not what the certificate leads"):
        loaded(far="2.3")
    with pytest.raises(ScenarioError, match=r"'w' of system 'system' is -0\.2 to 0\.2"):
        loaded(most=0.2, w='"0.01*t"')
    assert loaded(most=0.2, w="0.03").run().outcomes["reached goal"] == 50  # it is known
    with pytest.raises(ScenarioError, match=r"'w' of system 'system' is 0\.1 to 0\.1"):
        loaded(most=0.2, w="0.1")


def test_target_that_no_input_keeps_has_inputs_that_lead_back_or_those_of_a_neighbour():
    """A current that always carries a boat through its target: it is known there, for no time."""
    x, u = hf.symbol("x"), hf.symbol("u")
    boat = hf.System(
        "boat", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": 1 + u},
        input_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    river = rows("river", boat, (-x, x - 2))
    found = hf.certify(boat, river, target=rows("quay", boat, (1 - x, x - 1.5)), box={"x": (0, 2)},
                       cells=20, sample_time=0.2)  # fmt: skip
    controller = hf.Controller(boat, hf.certified_law(found))
    assert [controller.step([q]).outside for q in (0.5, 1.05, 1.45, 1.7)] == [False] * 3 + [True]
    first, last = controller.step([1.05]), controller.step([1.45])
    assert first.value == last.value == 0.0
    assert first.input == [0.0]  # leads to the target again
    assert last.input == controller.step([1.35]).input  # none that does


def test_certificate_of_a_law_has_no_other_law(parked):
    system, room, goal = vehicle()
    ahead = hf.Law("ahead", system.states, {"u": sp.Integer(1), "r": sp.Integer(0)})
    found = hf.certify(
        system, room, target=goal, law=ahead, sample_time=0.25, cells=12,
        box={"x": (0, 3), "y": (0, 2), "psi": (-1, 1)},
    )  # fmt: skip
    with pytest.raises(DefinitionError, match=r"is of a law|has no cell"):
        hf.certified_law(found)


@pytest.mark.heavy
def test_shipped_capture_basin_is_reached_by_its_certificate_whatever_the_sway(tmp_path):
    """A thousand starts, the sway at its bounds, changing sides in time and with the heading."""
    from holdfast.studies.certification import certified

    shipped = hf.load_scenario("ch7-capture-basin")
    found = certified("ch7-capture-basin", sample_time=0.2)
    assert round(found.kept.share, 3) == 0.359
    law = hf.certified_law(found, shipped.system, disturbance={"Vx": 0, "Vy": 0.2})
    starts = starts_in(found, found.kept.members, 1000, 27)
    for v in (0.1, -0.1, sgn(sp.sin(7 * TIME)) / 10, sgn(PSI) / 10, -sgn(Y) / 10):
        result = hf.simulate(
            shipped.system, law, starts=starts, region=shipped.region, goal=shipped.goal,
            horizon=8, sample_time=0.2, record_every=0.2, substeps=20, until_goal=True,
            tolerance=1e-9, disturbance={"Vx": 0, "Vy": 0.2, "v": v},
        )  # fmt: skip
        assert result.outcomes["reached goal"] == 1000
        says = result.arrays["signal"].values[:, 0, 0]
        assert (result.arrays["goal_time"].values <= says + 1e-9).all()
