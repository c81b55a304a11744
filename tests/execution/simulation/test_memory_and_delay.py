"""What a controller remembers, and what it sees too late, against loops written by hand."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, SimulationError

X, V, A, W, Z = (hf.symbol(n) for n in "xvawz")
H, STEPS = 0.05, 80
STATE = (hf.Quantity("x"),)
FELT = hf.Quantity("w", "m/s")
INPUT = hf.Quantity("a", "m/s")
LIMIT = hf.Parameter("limit", "m/s", value=1.0, above=0)
BAND = hf.Parameter("band", "1/s", value=3.0, above=0)
TWO = (hf.Quantity("x"), hf.Quantity("v"))

# -- memory

MOVER = hf.System(
    "mover",
    STATE,
    (INPUT,),
    {"x": A + W},
    parameters=(LIMIT,),
    disturbances=(FELT,),
    input_bounds=hf.Box((-LIMIT.symbol,), (LIMIT.symbol,)),
)
REMEMBERED = {  # name -> (first value, following value)
    "z": (X, Z + hf.SAMPLE_TIME * BAND.symbol * (X - Z)),  # x, filtered
    "given": (0, hf.symbol("given") + hf.SAMPLE_TIME * A),  # the inputs, integrated
    "drift": (0, hf.symbol("drift") + hf.SAMPLE_TIME * W),  # the disturbance, integrated
    "count": (7, hf.symbol("count") + 1),
    "when": (-1, hf.TIME),
}


def remembering(**changes):
    """a = -4 z of the filtered position, and what else is remembered among the signals."""
    kept = tuple(hf.Quantity(n) for n in REMEMBERED)
    chosen = {
        "quantities": kept,
        "initial": {n: first for n, (first, _) in REMEMBERED.items()},
        "following": {n: following for n, (_, following) in REMEMBERED.items()},
        "reads": (*STATE, FELT),
        "inputs": (INPUT,),
        "parameters": (BAND,),
    } | changes
    law = hf.Law("filtered", (*STATE, FELT, *kept), {"a": -4 * Z})
    signals = {"seen": X, "felt": W, **{f"its_{n}": hf.symbol(n) for n in REMEMBERED}}
    return hf.Switching("filtered", {"filtered": law}, signals=signals, memory=hf.Memory(**chosen))


def run(system, law, start, *, horizon=STEPS * H, **settings):
    chosen = {"sample_time": H, "record_every": H, "substeps": 1} | settings
    return hf.simulate(system, law, starts=[start], horizon=horizon, **chosen).dataset


def signal(data, name):
    return data["signal"].sel(signal_name=name).values[0]


def remembered(data):
    """What each is by the recorded measurements and inputs: z(0), then z(k+1) from sample k."""
    seen, felt, given = signal(data, "seen"), signal(data, "felt"), data["input"].values[0, :, 0]
    z = [seen[0]]
    for x in seen[:-1]:
        z.append(z[-1] + H * 3.0 * (x - z[-1]))
    time = np.arange(STEPS + 1) * H
    return {
        "z": np.array(z),
        "given": np.concatenate([[0.0], H * np.cumsum(given[:-1])]),
        "drift": np.concatenate([[0.0], H * np.cumsum(felt[:-1])]),
        "count": 7.0 + np.arange(STEPS + 1),
        "when": np.concatenate([[-1.0], time[:-1]]),
    }


def test_remembered_values_are_the_sequence_worked_out_by_hand():
    """x(k+1) = x + h a, z(k+1) = z + 3 h (x - z), a = clip(-4 z): everything from the start alone."""
    data = run(MOVER, remembering(), [0.9])
    x = z = 0.9
    for k in range(STEPS + 1):
        a = min(max(-4 * z, -1.0), 1.0)
        assert data["state"].values[0, k, 0] == pytest.approx(x, abs=1e-12)
        assert signal(data, "its_z")[k] == pytest.approx(z, abs=1e-12)
        assert data["input"].values[0, k, 0] == pytest.approx(a, abs=1e-12)
        x, z = x + H * a, z + 3 * H * (x - z)
    for name, expected in remembered(data).items():
        assert signal(data, f"its_{name}") == pytest.approx(expected, abs=1e-12)


def test_noise_is_remembered_with_the_measurement():
    data = run(MOVER, remembering(), [0.9], noise_uniform={"x": 0.2}, seed=4)
    noise = signal(data, "seen") - data["state"].values[0, :, 0]
    assert 0.1 < np.abs(noise).max() <= 0.2
    assert abs(noise[0]) > 1e-3  # in the first value too
    for name, expected in remembered(data).items():
        assert signal(data, f"its_{name}") == pytest.approx(expected, abs=1e-12)


def test_disturbance_that_is_told_is_remembered_as_it_was_felt():
    told = sp.Rational(3, 10) * sp.sin(2 * hf.TIME)
    data = run(MOVER, remembering(), [0.9], disturbance={"w": told})
    felt = 0.3 * np.sin(2 * H * np.arange(STEPS + 1))
    assert signal(data, "felt") == pytest.approx(felt, abs=1e-14)
    for name, expected in remembered(data).items():
        assert signal(data, f"its_{name}") == pytest.approx(expected, abs=1e-12)


def test_controller_remembers_the_input_within_the_limits_it_knows():
    """The vehicle's actuator gives 0.4 at most, its controller believes 1."""
    data = run(MOVER, remembering(), [0.9], plant={"limit": 0.4})
    assert data["input"].values[0, 0, 0] == -0.4
    believed = np.clip(-4 * signal(data, "its_z"), -1, 1)
    expected = np.concatenate([[0.0], H * np.cumsum(believed[:-1])])
    assert signal(data, "its_given") == pytest.approx(expected, abs=1e-12)


def test_every_run_begins_with_a_memory_of_its_own():
    starts = [[0.9], [-0.4], [0.9]]
    settings = {"horizon": 1.0, "sample_time": H, "record_every": H, "substeps": 1, "threads": 1}
    together = hf.simulate(MOVER, remembering(), starts=starts, **settings).dataset
    alone = hf.simulate(MOVER, remembering(), starts=[[-0.4]], **settings).dataset
    values = together["signal"].values
    assert (values[0] == values[2]).all()
    assert (values[1] == alone["signal"].values[0]).all()


# -- delay

CART = hf.System("cart", TWO, (hf.Quantity("a", "m/s^2"),), {"x": V, "v": A})


def late_law():
    return hf.Law(
        "late",
        TWO,
        {"a": -2 * X - V + sp.sin(3 * hf.TIME) / 2},
        signals={"seen": X},
    )


def by_hand(start, late):
    """x'' = a, exact between samples; the law sees the state of sample k - late, or the first."""
    x, v = start
    states, inputs = [(x, v)], []
    for k in range(STEPS + 1):
        then = states[max(k - late, 0)]
        a = -2 * then[0] - then[1] + math.sin(3 * k * H) / 2
        inputs.append(a)
        x, v = x + H * v + H * H * a / 2, v + H * a
        states.append((x, v))
    return np.array(states[:-1]), np.array(inputs)


@pytest.mark.parametrize("late", [0, 1, 3, 20])
def test_delay_is_the_law_at_the_state_so_many_samples_ago(late):
    data = run(CART, late_law(), [1.0, -0.5], delay=late * H)
    states, inputs = by_hand((1.0, -0.5), late)
    assert data["state"].values[0] == pytest.approx(states, abs=1e-9)
    assert data["input"].values[0, :, 0] == pytest.approx(inputs, abs=1e-9)
    if late:
        on_time, _ = by_hand((1.0, -0.5), 0)
        assert np.abs(states - on_time).max() > 0.05


def test_law_without_delay_sees_the_state_of_its_sample_to_the_last_digit():
    """Whether the delay is left out or zero; with one of a sample it sees the state before."""
    for settings in ({}, {"delay": 0.0}):
        data = run(CART, late_law(), [1.0, -0.5], **settings)
        assert np.array_equal(signal(data, "seen"), data["state"].values[0, :, 0])
    data = run(CART, late_law(), [1.0, -0.5], delay=H)
    assert np.array_equal(signal(data, "seen")[1:], data["state"].values[0, :-1, 0])


def test_delay_as_long_as_the_run_holds_the_first_state():
    data = run(CART, late_law(), [1.0, -0.5], delay=STEPS * H)
    assert (signal(data, "seen") == 1.0).all()


def test_noise_comes_with_the_sample_it_belongs_to():
    """What is seen late is what was measured then, not measured anew."""
    settings = {"noise_normal": {"x": 0.1}, "seed": 2}
    late = 4
    data = run(CART, late_law(), [1.0, -0.5], delay=late * H, **settings)
    true, seen = data["state"].values[0, :, 0], signal(data, "seen")
    noise = seen[late:] - true[: STEPS + 1 - late]
    still = run(CART, late_law(), [1.0, -0.5], **settings)
    assert noise == pytest.approx(
        (signal(still, "seen") - still["state"].values[0, :, 0])[: STEPS + 1 - late], abs=1e-12
    )
    assert (seen[:late] == seen[late]).all()
    assert noise.std() > 0.05


def test_memory_gets_what_is_seen_late():
    """Position, disturbance and first value are those of three samples ago."""
    told = sp.Rational(3, 10) * sp.sin(2 * hf.TIME)
    data = run(MOVER, remembering(), [0.9], disturbance={"w": told}, delay=3 * H)
    back = np.maximum(np.arange(STEPS + 1) - 3, 0)
    assert signal(data, "seen") == pytest.approx(data["state"].values[0, back, 0], abs=1e-14)
    assert signal(data, "felt") == pytest.approx(0.3 * np.sin(2 * H * back), abs=1e-14)
    for name, expected in remembered(data).items():
        assert signal(data, f"its_{name}") == pytest.approx(expected, abs=1e-12)


# -- refusals


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"continuous": True, "delay": H}, "a delay with continuous control"),
        ({"delay": 1.5 * H}, "expected delay a whole multiple of sample_time"),
        ({"delay": H / 1000}, "expected delay a whole multiple of sample_time"),
        ({"delay": -H}, "expected 0 s up to the horizon"),
        ({"delay": 2 * STEPS * H}, "expected 0 s up to the horizon"),
        ({"delay": math.nan}, "delay is nan"),
        ({"delay": "0.1"}, "delay is '0.1'"),
    ],
)
def test_delays_that_cannot_be_are_refused(settings, complaint):
    with pytest.raises(SimulationError) as caught:
        run(CART, late_law(), [1.0, -0.5], **settings)
    assert complaint in str(caught.value)


def test_memory_has_no_place_in_continuous_control():
    with pytest.raises(SimulationError, match="a law with memory needs sampled control"):
        run(MOVER, remembering(), [0.9], continuous=True)


FIRST = {n: first for n, (first, _) in REMEMBERED.items()}
NEXT = {n: following for n, (_, following) in REMEMBERED.items()}


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"initial": {n: e for n, e in FIRST.items() if n != "z"}}, "'z' has no first value"),
        ({"following": {n: e for n, e in NEXT.items() if n != "z"}}, "'z' has no following value"),
        ({"initial": FIRST | {"y": 0}}, "'y' is not remembered"),
        ({"following": NEXT | {"y": 0}}, "'y' is not remembered"),
        ({"initial": FIRST | {"z": V}}, "uses the undeclared name 'v'"),
        ({"initial": FIRST | {"z": hf.symbol("count")}}, "uses the undeclared name 'count'"),
        ({"initial": FIRST | {"z": A}}, "uses the undeclared name 'a'"),
        ({"following": NEXT | {"z": V}}, "uses the undeclared name 'v'"),
        ({"inputs": ()}, "uses the undeclared name 'a'"),
        ({"reads": STATE}, "uses the undeclared name 'w'"),
    ],
)
def test_memory_that_contradicts_itself_is_refused(changes, complaint):
    with pytest.raises(DefinitionError) as caught:
        remembering(**changes)
    assert complaint in str(caught.value)


@pytest.mark.parametrize("name", ["x", "a", "w"])
def test_what_the_system_has_is_not_remembered_under_the_same_name(name):
    memory = hf.Memory((hf.Quantity(name),), {name: 0}, {name: 1}, reads=())
    law = hf.Law("go", STATE, {"a": -X})
    switching = hf.Switching("go", {"go": law}, memory=memory)
    with pytest.raises(
        DefinitionError, match=f"'{name}' is both a quantity of system 'mover' and in"
    ):
        run(MOVER, switching, [0.9])


def test_memory_of_what_nobody_has_is_refused():
    """By the law, and by the memory itself."""
    law = hf.Law("go", (*STATE, hf.Quantity("z")), {"a": -Z})
    with pytest.raises(DefinitionError, match="reads 'z', which is neither a state"):
        run(MOVER, law, [0.9])
    memory = hf.Memory((hf.Quantity("z"),), {"z": 0}, {"z": V}, reads=(hf.Quantity("v"),))
    switching = hf.Switching("go", {"go": hf.Law("go", STATE, {"a": -X})}, memory=memory)
    with pytest.raises(DefinitionError, match="reads 'v', which is neither a state"):
        run(MOVER, switching, [0.9])
