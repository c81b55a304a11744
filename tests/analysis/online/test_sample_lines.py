"""A filter that is told its samples as lines of JSON."""

import json
import math

import pytest

import holdfast as hf
from holdfast.analysis.online.relay import SampleLines
from holdfast.errors import SimulationError
from tests.decisions import NAMES, camera_filter, pd


def line(state=(-1.3, 0.75, -0.35, 0.0, 0.0, 0.0), command=None, **more):
    said = {"state": dict(zip(NAMES, state, strict=True))}
    push, turn = pd(state) if command is None else command
    said["command"] = {"tau_r": turn, "tau_u": push}  # by name, in any order
    return json.dumps(said | more).encode()


def test_lines_are_answered_with_the_decisions_of_the_filter():
    vehicle, keep = camera_filter()
    samples = SampleLines(keep)
    _, alone = camera_filter()
    boat = hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0])
    for k in range(200):
        found = samples.answer(line([float(v) for v in boat.state]))
        wanted = alone.step(boat.state, pd(boat.state))
        assert found.t == k * 0.02
        assert list(found.actuators.values()) == wanted.actuators.tolist()
        assert (found.status, found.value) == (wanted.status.value, wanted.value)
        boat.step(wanted.input)


@pytest.mark.few(
    '{"state": {"x"-is no table of JSON',
    '{"t": 4.0}-t is 4 s after 5 s; expected a time that goes on',
)
@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (b"", "'' is no table of JSON"),
        (b'{"state": {"x"', "is no table of JSON"),
        (b"\xff\xfe", "is no table of JSON"),
        (b"[" * 5000, "is no table of JSON"),
        (b"[1, 2]", "is no table of JSON"),
        (b'{"stat": {}}', "unknown key 'stat'; .*did you mean 'state'"),
        (b'{"state": [1, 2, 3, 4, 5, 6]}', r"the state is \[1, 2, 3, 4, 5, 6\]; .*by name"),
        (b'{"state": {"x": 1}}', "the state lacks y, psi, u, v, r"),
        (b'{"command": {"tau_u": "5", "tau_r": 0}}', "the command is .*numbers by name"),
        (b'{"command": {"tau_u": true, "tau_r": 0}}', "the command is .*numbers by name"),
        (b'{"command": {"push": 1}}', "unknown command 'push'"),
        (b'{"command": {"tau_u": 1%s, "tau_r": 0}}' % (b"0" * 400), "the command is"),
        (b'{"disturbance": {"Vx": 1}}', "unknown disturbance 'Vx'"),
        (b'{"t": "soon"}', "t is 'soon'; expected a number of seconds"),
        (b'{"t": NaN}', "t is nan"),
        (b'{"t": 4.0}', r"t is 4 s after 5 s; expected a time that goes on"),
    ],
)
def test_line_that_is_no_sample_gives_the_fallback_and_says_why(bad, said):
    """Also no part of it is believed, and no command before it is taken again."""
    _, keep = camera_filter(fallback=[-1.0, 0.0])
    samples = SampleLines(keep)
    samples.answer(line(t=5.0))
    found = samples.answer(bad)
    assert found.status == "not a number"
    assert found.input == {"tau_u": -1.0, "tau_r": 0.0}
    assert found.t == pytest.approx(5.02)
    assert found.why == "line 2 is no sample: the input is the fallback"
    with pytest.raises(SimulationError, match=said):
        raise SimulationError(samples.refused)
    after = samples.answer(line())
    assert (after.status, after.t, samples.refused) == ("changed", pytest.approx(5.04), "")


def test_first_line_that_is_no_sample_is_refused_with_an_example():
    _, keep = camera_filter()
    with pytest.raises(SimulationError, match=r"line 1 is no sample: .*\{\"state\": \{\"x\": 0.0"):
        SampleLines(keep).answer(b'{"x": 1, "tau_u": 2}')
    example = SampleLines(keep).example().encode()
    assert SampleLines(keep).answer(example).state["x"] == 0.0


def test_command_or_state_that_does_not_come_is_lost_after_the_patience():
    _, keep = camera_filter()
    samples = SampleLines(keep, patience=0.1)
    whole = json.loads(line(command=(0.0, 0.0)))
    samples.answer(json.dumps(whole).encode())
    only = json.dumps({"state": whole["state"]}).encode()
    lost = [samples.answer(only).lost for _ in range(7)]
    assert lost == ["", "", "", "", "", "command", "command"]
    samples.answer(json.dumps(whole).encode())
    only = json.dumps({"command": whole["command"], "state": None}).encode()
    found = [samples.answer(only) for _ in range(7)]
    assert [r.lost for r in found] == ["", "", "", "", "", "measurement", "measurement"]
    assert found[-1].status == "no measurement"


def test_null_is_a_number_that_is_not_known():
    _, keep = camera_filter()
    samples = SampleLines(keep)
    whole = json.loads(line())
    whole["state"]["x"] = None
    found = samples.answer(json.dumps(whole).encode())
    assert (found.status, samples.refused) == ("not a number", "")
    assert math.isnan(found.state["x"])
    assert "x is nan" in found.why
    whole = json.loads(line())
    whole["command"]["tau_r"] = None
    assert SampleLines(keep).answer(json.dumps(whole).encode()).status == "not a number"


def test_disturbance_that_the_filter_measures_has_to_come_with_the_state():
    cart = hf.System(
        "cart", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),),
        {"x": hf.symbol("u") + hf.symbol("d")}, disturbances=(hf.Quantity("d", "m/s"),),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-0.5,), (0.5,)),
    )  # fmt: skip
    end = hf.Region("end", cart.states, (hf.Inequality("end", hf.symbol("x") - 1),))
    samples = SampleLines(hf.SafetyFilter(cart, end, disturbance_measured=True))
    said = {"state": {"x": 0.9}, "command": {"u": 1.0}}
    with pytest.raises(SimulationError, match="the disturbance lacks d"):
        samples.answer(json.dumps(said).encode())
    samples = SampleLines(samples.keep)
    felt = [
        samples.answer(json.dumps(said | {"disturbance": {"d": d}}).encode()).input["u"]
        for d in (-0.2, 0.2)
    ]
    assert felt[0] == pytest.approx(felt[1] + 0.4)
    assert samples.answer(b"{}").status == "changed"
    assert samples.answer(b"nothing").status == "not a number"


@pytest.mark.few("t1", "t2")
@pytest.mark.parametrize("t", ["1e13", "9" * 400, "-" + "9" * 400, "1e999"])
def test_time_that_is_no_time_is_refused(t):
    _, keep = camera_filter()
    samples = SampleLines(keep)
    samples.answer(line(t=5.0))
    bad = line(t=5.0).replace(b"5.0", t.encode())
    assert samples.answer(bad).status == "not a number"
    assert "t is" in samples.refused


def test_time_of_a_refused_line_is_not_believed():
    _, keep = camera_filter()
    samples = SampleLines(keep)
    samples.answer(line(t=5.0))
    assert samples.answer(b'{"t": 1e9, "state": {"y": 0}}').status == "not a number"
    after = samples.answer(line(t=5.04))
    assert (after.t, samples.refused) == (5.04, "")


def test_sample_before_a_bad_line_counts_for_its_patience():
    _, keep = camera_filter()
    samples = SampleLines(keep)
    samples.answer(line(command=(0.0, 0.0)))
    assert samples.answer(b"garbage").status == "not a number"
    assert samples.answer(b"{}").status == "passed"
