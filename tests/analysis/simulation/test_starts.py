"""Starts as texts with units, those that are no values of a state, and disturbances as texts."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError


def turner():
    states = (hf.Quantity("x", "m"), hf.Quantity("psi", "rad", angle=True))
    return hf.System(
        "turner", states, (hf.Quantity("w", "rad/s"),), {"x": "0.5*cos(psi)", "psi": "w"}
    )


def turned(starts):
    system = turner()
    law = hf.Law("none", system.states, {"w": 0})
    return hf.simulate(system, law, starts=starts, horizon=0.1).dataset["state"].values[:, 0]


def test_starts_take_texts_with_units():
    given = turned(hf.Starts(states=[{"x": "50 cm", "psi": "90 deg"}]))
    assert given == pytest.approx(np.array([[0.5, np.pi / 2]]))
    drawn = turned(hf.Starts(random=20, box={"psi": ("-90 deg", "90 deg")}))
    assert np.abs(drawn[:, 1]).max() <= np.pi / 2


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ({"states": [{"psi": "90 kg"}]}, "a start has psi = '90 kg'; expected a number in rad"),
        ({"random": 5, "box": {"x": "0,1"}}, "the box of 'x' is '0,1'; expected two values"),
        ({"random": 5, "box": {"x": (0,)}}, r"the box of 'x' is \(0,\); expected two values"),
        ({"random": 5, "box": {"psi": None}}, "the box of 'psi' is None; expected two values"),
        ({"states": [{"z": 1}]}, "'z' is not a state of system 'turner'"),
    ],
)
def test_starts_that_are_no_values_of_a_state_are_refused(starts, message):
    with pytest.raises(HoldfastError, match=message):
        turned(hf.Starts(**starts))


def test_a_disturbance_is_no_program(tmp_path):
    system = hf.System(
        "pushed", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": "u + d"},
        disturbances=(hf.Quantity("d", "m/s"),),
    )  # fmt: skip
    law = hf.Law("none", system.states, {"u": 0})
    made = tmp_path / "made"
    with pytest.raises(HoldfastError):
        hf.simulate(
            system, law, starts=[[0.0]], horizon=0.1,
            disturbance={"d": f"__import__('os').mkdir('{made}')"},
        )  # fmt: skip
    assert not made.exists()
