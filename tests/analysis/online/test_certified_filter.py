"""A filter by proof: it keeps what its certificate keeps, and lets pass what surely does no harm."""

import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.certificates.certified_law import Proof
from holdfast.errors import DefinitionError, SimulationError
from tests.adversary import CORNERS, most, moved, starts_in, worst_of
from tests.certified_systems import AHEAD, BOX, CART, LEFT, camera, cart, view


@pytest.fixture(scope="module")
def seen():
    return hf.certify(camera(), view(camera()), box=BOX, cells=61, sample_time=0.1)


@pytest.fixture(scope="module")
def keep(seen):
    return hf.CertifiedFilter(seen, camera())


def outwards(states, rng):
    """Commands that lose the target: at full speed from it or at it, or turning from it."""
    wished = np.stack([np.sign(states[:, 0] - 1.2) * -0.5, np.sign(states[:, 1]) * -0.8], axis=1)
    drawn = rng.uniform([-0.6, -1.0], [0.6, 1.0], states.shape)
    return np.where(np.arange(len(states))[:, None] % 2 == 0, wished, drawn)


def test_no_target_leaves_the_view_whatever_is_commanded_and_whatever_pushes(seen, keep):
    """A thousand runs of 5 s against commands that lose the target and corners of the disturbance."""
    rng, counted = np.random.default_rng(1), []

    def answer(states):
        told = keep.step_many(states, outwards(states, rng))
        counted.extend(told.status)
        assert np.isinf(told.value).all()
        return told.input

    worst = worst_of(seen, answer, 1000, 50, 10, 2)
    assert -0.005 < worst <= 0
    assert hf.Status.OUTSIDE_GRID not in counted
    passed = counted.count(hf.Status.PASSED) / len(counted)
    assert 0.2 < passed < 0.8


def test_filter_without_commands_that_lose_the_target_lets_nearly_all_pass(seen, keep):
    starts = starts_in(seen, seen.kept.members, 2000, 3)
    slow = np.random.default_rng(4).uniform([-0.1, -0.2], [0.1, 0.2], starts.shape)
    told = keep.step_many(starts, slow)
    passed = np.array([s is hf.Status.PASSED for s in told.status])
    assert passed.mean() > 0.75
    assert (told.input[passed] == slow[passed]).all()
    assert not told.overruled[passed].any()


def test_command_that_is_changed_may_lose_the_target_and_the_input_may_not(seen, keep):
    """For many changed commands a disturbance is found after which no cell is certified."""
    starts = starts_in(seen, seen.kept.members, 4000, 5)
    rng = np.random.default_rng(6)
    wished = rng.uniform([-0.5, -0.8], [0.5, 0.8], starts.shape)
    told = keep.step_many(starts, wished)
    changed = np.flatnonzero([s is hf.Status.CHANGED for s in told.status])
    assert len(changed) > 200
    z = (starts[:, 0] + 1j * starts[:, 1])[changed, None]

    def lost(inputs):
        ends = moved(z, inputs[changed, :1], inputs[changed, 1:], CORNERS, 0.1)
        after = np.stack([ends.real, ends.imag], axis=2).reshape(-1, 2)
        kept = Proof(seen).looked_up(after)[0].reshape(ends.shape) > 0
        return ~kept.all(axis=1)

    assert lost(wished).mean() > 0.9
    assert not lost(told.input).any()


def test_input_is_the_nearest_of_those_that_lead_back(seen, keep):
    """A search through the inputs with the enclosures, one by one."""
    proof = Proof(seen)
    for state, command in (([1.98, 0.1], [-0.5, 0.3]), ([0.36, 0.0], [0.5, -0.8])):
        decision = keep.step(state, command)
        assert decision.status is hf.Status.CHANGED
        assert decision.overruled
        assert "need not lead to certified cells" in decision.why
        leads = [
            u for u in seen.candidates
            if proof.leads(np.array([state]), u[np.newaxis], np.zeros(1, dtype=np.int64))[0]
        ]  # fmt: skip
        far = [math.hypot((u[0] - command[0]) / 0.5, (u[1] - command[1]) / 0.8) for u in leads]
        assert decision.input.tolist() == leads[int(np.argmin(far))].tolist()


def test_step_and_step_many_give_the_same(seen, keep):
    rng = np.random.default_rng(7)
    states = rng.uniform([0.2, -1.3], [2.2, 1.3], (300, 2))
    commands = rng.uniform([-0.7, -1.0], [0.7, 1.0], (300, 2))
    told = keep.step_many(states, commands)
    for k in range(300):
        one = keep.step(states[k], commands[k])
        assert one.status is told.status[k]
        assert (one.input == told.input[k]).all()
        assert (one.actuators == told.actuators[k]).all()
        assert (one.value, one.overruled) == (told.value[k], told.overruled[k])
    assert {s.name for s in told.status} == {"PASSED", "CHANGED", "OUTSIDE_GRID"}


def test_state_in_no_certified_cell_may_still_be_led_into_one(seen, keep):
    """Cells that the view cuts are not certified, and most of their states in it are kept."""
    rng = np.random.default_rng(8)
    states = rng.uniform([0.3, -1.2], [2.1, 1.2], (4000, 2))
    cut = (most(states @ np.array([1, 1j])) <= 0) & (Proof(seen).looked_up(states)[0] < 0)
    states = states[cut]
    assert len(states) > 50
    told = keep.step_many(states, np.zeros_like(states))
    found = np.array([s is not hf.Status.OUTSIDE_GRID for s in told.status])
    assert found.mean() > 0.5
    z = (states @ np.array([1, 1j]))[found, None]
    for part in np.linspace(0.01, 0.1, 10):
        ends = moved(z, told.input[found, :1], told.input[found, 1:], CORNERS, part)
        assert most(ends).max() <= 0
    beyond = keep.step([1.2, 1.1], [0.0, 0.0])
    assert beyond.status is hf.Status.OUTSIDE_GRID
    assert beyond.value == 0.0
    assert "nothing is promised" in beyond.why


def test_command_beyond_the_bounds_and_what_is_no_number(keep):
    beyond = keep.step({"ahead": 1.2, "left": 0.0}, {"u": 0.7, "r": 0.0})
    assert beyond.status is hf.Status.CHANGED
    assert not beyond.overruled
    assert beyond.input.tolist() == [0.5, 0.0]
    assert "beyond the bounds" in beyond.why
    blind = keep.step([math.nan, 0.0], [0.1, 0.2])
    assert blind.status is hf.Status.NOT_A_NUMBER
    assert blind.input.tolist() == [0.0, 0.0] == keep.fallback.tolist()
    assert "ahead is nan" in blind.why
    assert math.isnan(blind.value)
    with pytest.raises(SimulationError, match="the state lacks left"):
        keep.step({"ahead": 1.0}, [0.0, 0.0])
    with pytest.raises(SimulationError, match="the commands have the shape"):
        keep.step_many([[1.0, 0.0]], [[1.0]])


def test_filter_for_a_while_keeps_for_as_long_as_it_says():
    """In a current too strong for ever: commands that lose the target, worst corners, 0.5 s."""
    system = camera(0.6)
    found = hf.certify(system, view(system), box=BOX, cells=41, horizon=0.5)
    keep = hf.CertifiedFilter(found, system)
    starts = starts_in(found, np.unique(found.kept.entries[:, 0]), 1500, 9)
    z, rng = starts @ np.array([1, 1j]), np.random.default_rng(10)
    corners = np.array([complex(a, b) for a in (-0.6, 0.6) for b in (-0.65, 0.65)])
    first = keep.step_many(starts, outwards(starts, rng)).value
    assert {round(v / 0.1) for v in first} == {1, 2, 3, 4, 5}
    for sample in range(5):
        states = np.stack([z.real, z.imag], axis=1)
        told = keep.step_many(states, outwards(states, rng))
        left = first - 0.1 * sample > 0.05
        assert (told.value[left] >= first[left] - 0.1 * sample - 1e-9).all()
        for _ in range(10):
            ends = moved(z[:, None], told.input[:, :1], told.input[:, 1:], corners, 0.01)
            z = ends[np.arange(len(z)), most(ends).argmax(axis=1)]
            assert most(z[left]).max() <= 0


def test_filter_stands_around_a_law_in_a_simulation(seen, keep):
    """A law that drives away from the target: alone it loses all, behind the filter none."""
    system, region = camera(), view(camera())
    turning = {"u": -0.2 + 0 * AHEAD, "r": LEFT / 10}
    away = hf.Law("away", system.states, turning, empirical="a gain is a number")
    run = {
        "starts": starts_in(seen, seen.kept.members, 200, 11), "region": region, "horizon": 8.0,
        "sample_time": 0.1, "substeps": 10, "disturbance": {"wa": -0.1, "wb": 0.15},
    }  # fmt: skip
    assert hf.simulate(system, away, **run).outcomes["left region"] == 200
    around = keep.around(away)
    kept = hf.simulate(system, hf.commanded(system), command=around, **run)
    assert kept.outcomes["stayed"] == 200
    assert around.counts[hf.Status.PASSED] > 0
    assert around.counts.keys() == {hf.Status.PASSED, hf.Status.CHANGED}
    function = keep.around(lambda t, q: np.tile([-0.2, 0.0], (len(q), 1)))
    run["sample_time"], run["record_every"] = 0.05, 0.1
    with pytest.raises(SimulationError, match=r"samples of 0\.1 s; expected sample_time=0\.1"):
        hf.simulate(system, hf.commanded(system), command=function, **run)


def test_relay_of_streams_asks_the_filter_by_proof(keep):
    """A command that is late is the fallback, a measurement that is late a refusal."""
    relay = hf.Relay(keep, patience=0.15)
    relay.measured([1.2, 0.0], 0.0)
    relay.commanded([0.1, 0.0], 0.0)
    assert relay.decide(0.0).status == "passed"
    relay.measured([1.99, 0.0], 0.2)
    late = relay.decide(0.2)
    assert (late.status, late.lost) == ("changed", "command")
    assert "need not lead to certified cells" in late.why
    assert relay.decide(0.5).status == "no measurement"
    assert hf.DecisionRecord.read(late.line()).input == late.input
    with pytest.raises(SimulationError, match="measures none"):
        keep.step([1.2, 0.0], [0.0, 0.0], disturbance=[0.0, 0.0])


def test_file_alone_is_a_filter_of_inputs_with_known_bounds(seen, tmp_path):
    read = hf.read_certificate(seen.write(tmp_path / "view.holdfast"))
    alone, own = hf.CertifiedFilter(read), hf.CertifiedFilter(seen, camera())
    states = starts_in(seen, seen.kept.members, 500, 12)
    commands = outwards(states, np.random.default_rng(13))
    assert (alone.step_many(states, commands).input == own.step_many(states, commands).input).all()


def test_uncertain_cart_is_kept_for_every_drag_in_its_range():
    system, walls = cart()
    found = hf.certify(
        system, walls, box=CART, cells=41, sample_time=0.2, uncertain={"drag": (0.1, 0.3)}
    )
    keep = hf.CertifiedFilter(found, system, scales={"a": 1.0})
    starts = starts_in(found, found.kept.members, 300, 14)
    wild = keep.around(lambda t, q: np.sign(np.sin(7 * t + q[:, :1])))
    for drag in (0.1, 0.3):
        result = hf.simulate(
            system, hf.commanded(system), command=wild, starts=starts, region=walls, horizon=6.0,
            sample_time=0.2, record_every=0.2, substeps=10, plant={"drag": drag},
            disturbance={"w": 0.2},
        )  # fmt: skip
        assert result.outcomes["stayed"] == 300
    with pytest.raises(SimulationError, match="scales of 'b'"):
        hf.CertifiedFilter(found, system, scales={"b": 1.0})
    with pytest.raises(DefinitionError, match="drag = 0"):
        hf.CertifiedFilter(found, other_drag(system))


def test_cart_at_rest_in_the_middle_may_stay_there():
    """A state is enclosed by a box with a width: without one no way from rest is enclosed."""
    system, walls = cart()
    found = hf.certify(system, walls, box=CART, cells=41, sample_time=0.2)
    keep = hf.CertifiedFilter(found, system)
    for state in ([0.0, 0.0], [0.3, 0.0], [0.0, 0.2]):
        assert keep.step(state, [0.0]).status is hf.Status.PASSED


def other_drag(system):
    changed = hf.Parameter("drag", "1/s", value=0.5)
    return hf.System(
        system.name, system.states, system.inputs, system.rates, disturbances=system.disturbances,
        parameters=(changed,), disturbance_bounds=system.disturbance_bounds,
        input_bounds=system.input_bounds,
    )  # fmt: skip
