"""A law that others hand its command gives, bit for bit, what the same law gives alone."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast.execution.leaf import Evaluator


def by_hand(system, law):
    """The law as a function of the measured states, compiled alone."""
    states = [q.symbol for q in system.states]
    of = Evaluator([law.outputs[n] for n in system.input_names], states, law.parameters)
    return lambda t, q: of.values(np.ascontiguousarray(q))


@pytest.fixture(scope="module")
def wanted(vehicle):
    return hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})


STARTS = hf.Starts(
    random=37, box={"x": (-2, -0.3), "y": (-1.0, 1.0), "psi": (-1, 1), "u": (-0.1, 0.3)}
)
NAMES = ("state", "input", "actuator", "constraint", "outcome", "exit_time", "worst_constraint")


@pytest.mark.few("alone-few records", "safeguarded-few records")
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"record_every": 0.1},
        {"delay": 0.08, "noise_normal": {"x": 0.01}, "noise_uniform": {"psi": 0.02}},
        {"stepper": "dormand-prince"},
    ],
    ids=["plain", "few records", "late and noisy", "adaptive"],
)
@pytest.mark.parametrize("guarded", [False, True], ids=["alone", "safeguarded"])
def test_handed_law_is_the_law(vehicle, wanted, settings, guarded):
    view = hf.regions.camera_view()
    laws = [wanted, hf.commanded(vehicle)]
    if guarded:
        laws = [hf.safeguard(vehicle, law, view, gains=(1.5, 8)) for law in laws]
    shared = {
        "starts": STARTS, "region": view, "goal": hf.regions.near_pose(goal_x=-0.5), "horizon": 3.0,
        "seed": 2, "disturbance": {"Vx": 0.05, "Vy": -0.02}, **{"record_every": 0.02, **settings},
    }  # fmt: skip
    alone = hf.simulate(vehicle, laws[0], **shared).dataset
    handed = hf.simulate(vehicle, laws[1], command=by_hand(vehicle, wanted), **shared).dataset
    for name in NAMES:
        np.testing.assert_array_equal(alone[name].values, handed[name].values, err_msg=name)
    if guarded:
        assert alone["overruled"].values.sum() > 50
        for name in ("nominal", "overruled", "largest_slack"):
            np.testing.assert_array_equal(alone[name].values, handed[name].values, err_msg=name)


def test_runs_that_end_are_commanded_no_more(double_integrator):
    """A command that grows without bound: every run diverges, and the rest is NaN."""
    asked = []

    class Growing:
        most = 5

        def begin(self, runs):
            asked.append(runs)

        def command(self, t, states, alive):
            return np.where(alive, 10.0**t, 0.0)[:, np.newaxis]

        def end(self):
            asked.append("end")

    import dataclasses

    free = dataclasses.replace(double_integrator, input_bounds=None)
    result = hf.simulate(
        free, hf.commanded(free), starts=np.zeros((7, 2)), horizon=20.0, command=Growing()
    )
    assert result.outcomes["diverged"] == 7
    assert np.isnan(result.dataset["state"].values[:, -1]).all()
    assert asked == [range(5), "end", range(5, 7), "end"]


def test_what_does_not_fit_is_refused(vehicle, wanted):
    law = hf.commanded(vehicle)
    common = {"starts": [[0.0] * 6], "horizon": 0.1}
    with pytest.raises(SimulationError, match=r"of the shape \(2,\); expected \(1, 2\): command_"):
        hf.simulate(vehicle, law, command=lambda t, q: np.zeros(2), **common)
    with pytest.raises(SimulationError, match="commands no array of numbers"):
        hf.simulate(vehicle, law, command=lambda t, q: "x", **common)
    with pytest.raises(SimulationError, match="the command is 5; expected a function"):
        hf.simulate(vehicle, law, command=5, **common)
    with pytest.raises(SimulationError, match="a command of another controller needs sampled"):
        hf.simulate(vehicle, law, command=lambda t, q: np.zeros((1, 2)), continuous=True, **common)
    with pytest.raises(SimulationError, match="a command is given, and the law is not handed any"):
        hf.simulate(vehicle, wanted, command=lambda t, q: q, **common)
    with pytest.raises(SimulationError, match="is handed command_tau_u, command_tau_r by others"):
        hf.simulate(vehicle, law, **common)


def test_states_that_a_command_changes_are_its_own(vehicle):
    def pure(t, q):
        return -np.stack([q[:, 0] + 0.5, q[:, 2]], axis=1)

    def careless(t, q):
        q[:, 0] += 0.5
        return -np.stack([q[:, 0], q[:, 2]], axis=1)

    law = hf.safeguard(vehicle, hf.commanded(vehicle), hf.regions.camera_view())
    found = [
        hf.simulate(vehicle, law, starts=STARTS, horizon=2.0, command=f).dataset["state"].values
        for f in (pure, careless)
    ]
    assert np.array_equal(*found)
