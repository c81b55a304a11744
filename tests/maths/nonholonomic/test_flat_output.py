"""Chained coordinates from a declared flat output: trailers off the axle, a car by its front axle."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.definitions.system import NODES, Antiderivative, FlatOutput
from holdfast.maths.nonholonomic.chained_search import derived_flag
from holdfast.maths.nonholonomic.structure import kinematic_system, structure

GAINS = {"k1": 0.2, "poles": -0.4, "threshold": 2.0, "escape_speed": 0.5, "escape_time": 8.0}
x, y, psi, delta, base = (hf.symbol(n) for n in ("x", "y", "psi", "delta", "wheelbase"))


def drawn(trailer, hitch, angles):
    """The flat output on paper: Y of the trailer with its axle at the origin, by quadrature."""
    rear, front = angles
    b, h, length = front - rear, hitch, trailer
    beam = h * np.exp(1j * front) + length * np.exp(1j * rear)
    share = h * (h + length * np.cos(b)) / abs(beam) ** 2
    mu = mpmath.quad(
        lambda s: (h * length * mpmath.sin(s)) ** 2
        / (h**2 + length**2 + 2 * h * length * mpmath.cos(s)) ** 1.5,
        [0, b],
    )  # fmt: skip
    return share * beam + 1j * float(mu) * beam / abs(beam)


@pytest.mark.parametrize("hitch", [-0.25, 0.2, 0.5])
def test_flat_output_moves_along_the_line_between_the_axles_whatever_the_inputs(hitch):
    """Finite differences of the drawing along random inputs: the angle of Y' is that of n."""
    system = hf.systems.tractor_trailer(1, hitch_1=hitch)
    symbols = [*(q.symbol for q in system.states), hf.symbol("v"), hf.symbol("r")]
    rates = Evaluator(list(system.rates.values()), symbols, system.parameters)
    flat = system.flat_output
    written = {a.symbol: a.value for a in flat.antiderivatives}
    z = [e.xreplace(written) for e in (flat.first, *flat.last)]
    coordinates = Evaluator(z, symbols[:4], system.parameters)
    generator, step = np.random.default_rng(0), 1e-5
    for _ in range(10):
        rear, b = generator.uniform(-0.6, 0.6, 2)
        q = np.array([0.0, 0.0, rear, rear + b])
        speed = rates.values(np.array([[*q, *generator.uniform(-1, 1, 2)]]))[0]
        ends = [
            complex(*(s * step * speed[:2])) + drawn(0.5, hitch, q[2:] + s * step * speed[2:])
            for s in (-1, 1)
        ]
        beam = hitch * np.exp(1j * q[3]) + 0.5 * np.exp(1j * q[2])
        slope = (ends[1] - ends[0]) / (2 * step)
        assert (slope / beam).imag == pytest.approx(0, abs=1e-8 * abs(1 / beam))
        # and the coordinates of the system are those of the drawing
        z = coordinates.values(q[None])[0]
        here = drawn(0.5, hitch, q[2:])
        assert (z[0] + hitch, z[3]) == pytest.approx((here.real, here.imag), abs=1e-14)
        assert z[2] == pytest.approx(beam.imag / beam.real, rel=1e-13)


@pytest.mark.parametrize(
    ("share", "error"), [(-0.95, 2e-14), (-0.9, 1e-15), (-0.5, 1e-16), (1, 2e-16), (20, 1e-16)]
)
def test_quadrature_of_the_arc_has_the_accuracy_of_its_numbers(share, error):
    """To the largest angle of each hitch, in lengths of the trailer; at 16 nodes."""
    assert NODES == 16
    system = hf.systems.tractor_trailer(1, hitch_1=share, length_1=1.0)
    (mu,) = system.flat_output.antiderivatives
    p = {q.symbol: q.value for q in system.parameters}
    f = sp.lambdify(mu.variable, mu.integrand.xreplace(p), "mpmath")
    bound = {-0.95: 4.4, -0.9: 9.0, -0.5: 49.8, 1: 112.9, 20: 92.7}[share]
    b = np.radians(np.linspace(0.1, 1, 5) * bound)
    found = Evaluator([mu.value], [hf.symbol("psi0"), hf.symbol("psi1")], system.parameters)
    values = found.values(np.stack([b, 0 * b], axis=1))[:, 0]
    exact = [float(mpmath.quad(f, [0, e / 2, e])) for e in b]
    assert np.abs(values - exact).max() <= error


@pytest.mark.parametrize(
    ("share", "degrees"),
    [(-0.5, 49.9), (-0.2, 76.7), (0.2, 99.7), (0.5, 108.7), (1.0, 112.9), (2.0, 108.7)],
)
def test_hitch_angle_at_which_the_flat_output_stops_is_the_stated_one(share, degrees):
    """The curvature z2 changes sides there."""
    system = hf.systems.tractor_trailer(1, hitch_1=share, length_1=1.0)
    flat = system.flat_output
    curvature = flat.last[0].xreplace({a.symbol: a.value for a in flat.antiderivatives})
    z2 = Evaluator([curvature], [hf.symbol("psi0"), hf.symbol("psi1")], system.parameters)
    # the beam between the axles kept at the angle zero
    b = np.radians(np.array([degrees - 0.1, degrees + 0.1]))
    rear = -np.angle(share * np.exp(1j * b) + 1)
    signs = np.sign(z2.values(np.stack([rear + b, rear], axis=1))[:, 0])
    assert signs.tolist() == [1, -1]


@pytest.mark.heavy
@pytest.mark.parametrize(
    "system",
    [
        hf.systems.tractor_trailer(1, hitch_1=0.2),
        *(
            pytest.param(system, marks=pytest.mark.heavy)
            for system in (
                hf.systems.tractor_trailer(1, hitch_1=-0.2),
                hf.systems.tractor_trailer(1, hitch_1=0.5),
                hf.systems.tractor_trailer(2, hitch_2=0.2),
            )
        ),
    ],
    ids=lambda s: ", ".join(f"{p.name} {p.value:g}" for p in s.parameters),
)
def test_every_start_of_a_tractor_with_a_trailer_off_its_axle_arrives(system):
    """500 of 500, within 6 m along and 1 m beside, angles to 17 deg."""
    box = {"x": (-6, 6), "y": (-1, 1)} | {q.name: (-0.3, 0.3) for q in system.states[2:]}
    result = hf.simulate(
        system,
        hf.laws.steer_by_chained_form(system, **GAINS),
        starts=hf.Starts(random=500, box=box),
        goal=hf.regions.near_origin(system),
        horizon=60, sample_time=0.01, substeps=1, record_every=60, seed=1,
    )  # fmt: skip
    assert result.outcomes["reached goal"] == 500


@pytest.mark.few("{'trailers': 2, 'hitch_1': 0.2}-(2, 3, 5)")
@pytest.mark.parametrize(
    ("arguments", "flag"),
    [
        ({"trailers": 2}, (2, 3, 4, 5)),
        ({"trailers": 2, "hitch_2": 0.2}, (2, 3, 4, 5)),
        ({"trailers": 2, "hitch_1": 0.2}, (2, 3, 5)),
        ({"trailers": 2, "hitch_1": 0.2, "hitch_2": 0.1}, (2, 3, 5)),
    ],
    ids=str,
)
def test_derived_flag_tells_the_trailers_that_are_flat(arguments, flag):
    assert derived_flag(structure(hf.systems.tractor_trailer(**arguments))) == flag


def test_two_trailers_whose_first_hitch_is_off_the_axle_are_refused_with_the_reason():
    with pytest.raises(DefinitionError, match=r"derived flag .+ \(2, 3, 5\), .+ \(2, 3, 4, 5\)"):
        hf.laws.steer_by_chained_form(hf.systems.tractor_trailer(2, hitch_1=0.2))


def test_derived_flag_stays_where_a_constraint_can_be_integrated():
    """d(x y + z) = 0: no bracket leads off the surface."""
    states = tuple(hf.Quantity(n) for n in ("x", "y", "z"))
    row = hf.PfaffianRow({"x": y, "y": x, "z": 1})
    assert derived_flag(structure(kinematic_system("given", states, (row,)))) == (2,)


CAR = hf.systems.front_axle_car()


@pytest.mark.parametrize(
    ("flat", "complaint"),
    [
        (FlatOutput(x, (sp.tan(psi), y)), "not what differentiation of the next one gives"),
        (FlatOutput(x + 1, (y,)), "a coordinate is not zero at the origin"),
        (FlatOutput(x, (y,)), "moved by the second input too early"),
        (FlatOutput(y - base * sp.sin(psi), (x,)), "the first does not move at the origin"),
    ],
)
def test_flat_output_that_is_none_is_refused(flat, complaint):
    with pytest.raises(
        DefinitionError, match=f"declared flat output begins no chain: .*{complaint}"
    ):
        hf.laws.steer_by_chained_form(replace(CAR, flat_output=flat))


@pytest.mark.parametrize(
    ("flat", "complaint"),
    [
        (lambda: FlatOutput(x, ()), "has no last coordinate"),
        (lambda: FlatOutput(hf.symbol("a"), (y,)), "flat output of .+ undeclared name 'a'"),
        (
            lambda: FlatOutput(x, (y,), (Antiderivative("psi", delta, delta, psi),)),
            "declares 'psi' twice",
        ),
        (
            lambda: FlatOutput(x, (y,), (Antiderivative("mu", hf.symbol("a"), delta, psi),)),
            "'mu' of .+ undeclared name 'a'",
        ),
    ],
)
def test_flat_output_with_unknown_names_is_refused(flat, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        replace(CAR, flat_output=flat())


def test_front_axle_car_arrives_by_the_position_of_its_rear_axle():
    law = hf.laws.steer_by_chained_form(
        CAR, k1=0.5, poles=-1.0, threshold=2.0, escape_speed=0.5, escape_time=4.0
    )
    result = hf.simulate(
        CAR, law, goal=hf.regions.near_origin(CAR),
        starts=hf.Starts(random=200, box={"x": (-4, 4), "y": (-1, 1), "psi": (-0.7, 0.7), "delta": (-0.4, 0.4)}),
        horizon=40, sample_time=0.01, substeps=1, record_every=40, seed=1,
    )  # fmt: skip
    assert result.outcomes["reached goal"] == 200


@pytest.mark.heavy
def test_derivation_shows_the_antiderivative_and_where_its_coordinates_come_from():
    derived = hf.explain(hf.systems.tractor_trailer(1, hitch_1=0.2))
    text = " ".join(derived.text().split())
    assert "Derived from the flat output (z1, z4) that the system declares: with" in text
    assert "arc = " in text
    assert "\\int" in derived.latex()
