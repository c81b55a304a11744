"""Trailers stand where the rates of a system put their axles."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.expressions.numeric import evaluated
from holdfast.maths.nonholonomic.bodies import TRAILER, VEHICLE, bodies

X, Y, PSI, PHI, V, W = (hf.symbol(n) for n in ("x", "y", "psi", "phi", "v", "w"))


def rig(rate, parameters=()):
    """A car with a trailer as a user writes it."""
    return hf.System(
        "rig",
        states=(
            hf.Quantity("x", "m"), hf.Quantity("y", "m"),
            hf.Quantity("psi", "rad", angle=True), hf.Quantity("phi", "rad", angle=True),
        ),
        inputs=(hf.Quantity("v", "m/s"), hf.Quantity("w", "rad/s")),
        rates={"x": V * sp.cos(PSI), "y": V * sp.sin(PSI), "psi": W, "phi": rate},
        parameters=parameters,
    )  # fmt: skip


def places(system, state, plane=("x", "y")):
    """The axle and the heading of every body, foremost first."""
    values = {q.symbol: v for q, v in zip(system.states, state, strict=True)}
    values |= {p.symbol: p.value for p in system.parameters}
    return np.array([evaluated((*b.apex, b.heading), values) for b in bodies(system, plane)])


@pytest.mark.parametrize("length", [2.0, 0.3])
def test_trailer_is_its_length_behind_the_car(length):
    for system in (
        rig(V * sp.sin(PSI - PHI) / length),
        rig(V * sp.sin(PSI - PHI) / hf.symbol("L"), (hf.Parameter("L", "m", value=length),)),
    ):
        assert [b.role for b in bodies(system)] == [VEHICLE, TRAILER]
        wanted = [[1, 2, 0.5], [1 - length * np.cos(0.2), 2 - length * np.sin(0.2), 0.2]]
        np.testing.assert_allclose(places(system, (1, 2, 0.5, 0.2)), wanted, atol=1e-14)


def test_hitch_behind_the_axle_moves_the_trailer_back():
    hitch, length = 0.4, 1.5
    rate = (V * sp.sin(PSI - PHI) - hitch * W * sp.cos(PSI - PHI)) / length
    (_, trailer) = places(rig(rate), (0, 0, 0.3, -0.2))
    ends = -hitch * np.array([np.cos(0.3), np.sin(0.3)])
    ends -= length * np.array([np.cos(-0.2), np.sin(-0.2)])
    np.testing.assert_allclose(trailer, [*ends, -0.2], atol=1e-14)


@pytest.mark.parametrize("trailers", [1, 2, 3])
def test_no_axle_of_the_catalogue_moves_sideways(trailers):
    """The velocity of every axle is along its heading, by the rates of the system."""
    system = hf.systems.tractor_trailer(trailers, hitch_1=0.1, length_1=0.8)
    state = np.array([0.3, -0.2, *(0.1 * k * k - 0.3 for k in range(trailers + 1))])
    values = {q.symbol: v for q, v in zip(system.states, state, strict=True)}
    values |= {p.symbol: p.value for p in system.parameters}
    values |= {q.symbol: v for q, v in zip(system.inputs, (0.7, -0.4), strict=True)}
    rates = np.array(evaluated(system.rates.values(), values))
    step = 1e-6
    before, after = (places(system, state + sign * step * rates) for sign in (-1, 1))
    velocity = (after - before)[:, :2] / (2 * step)
    headings = places(system, state)[:, 2]
    assert len(headings) == trailers + 1
    sideways = -np.sin(headings) * velocity[:, 0] + np.cos(headings) * velocity[:, 1]
    np.testing.assert_allclose(sideways, 0.0, atol=1e-8)


@pytest.mark.parametrize(
    ("system", "plane"),
    [
        (rig(V / 2), ("x", "y")),  # another angle, and no axle of it
        (hf.systems.unicycle(), ("x", "y")),
        (hf.systems.car(), ("x", "y")),
        (hf.systems.unicycle(), ("x", "z")),
    ],
)
def test_other_vehicles_have_no_trailers(system, plane):
    assert bodies(system, plane) == ()
