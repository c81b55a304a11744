"""Marches by the kernels of a graphics processor, compiled as C++, beside those of the processor."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.execution.device.program import HostDevice, whole_text
from holdfast.execution.level_set.device_sweeping import march_text
from holdfast.execution.level_set.march import March, Method
from holdfast.execution.level_set.sweeping import Within
from tests.devices import accepted_by_cuda, needs_cpp, needs_nvcc
from tests.drift_on_axes import KINDS, hamiltonian

pytestmark = needs_cpp
X, Y, U, V, T = (*(hf.symbol(n) for n in ("x", "y", "u", "v")), hf.TIME)
PLANE = (hf.Quantity("x"), hf.Quantity("y"))
ROUNDING = {"float64": 1e-12, "float32": 1e-5}
"""Of values up to 4 m, after some 100 steps; where a march chooses between two equal slopes it may
amplify a last place."""


def cart(drift=sp.S.Zero):
    """x' = y + a(t), y' = u + sin y, with a disturbance."""
    return hf.System(
        "cart", PLANE, (hf.Quantity("u"),), {"x": Y + drift, "y": U + V + sp.sin(Y) / 9},
        disturbances=(hf.Quantity("v"),), input_bounds=hf.Box((-1,), (1,)),
        disturbance_bounds=hf.Box((-0.2,), (0.2,)),
    )  # fmt: skip


def region(name, *expressions):
    rows = tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate(expressions))
    return hf.Region(name, PLANE, rows)


WALLS = region("walls", X**2 - 1)
DOCK = region("dock", X**2 + Y**2 - sp.Rational(1, 9))
MOVING = region("moving", T / 8 - 1 - X, X - 1)
FREE = {"x": "extrapolated", "y": "extrapolated"}


def both(problem, system, *about, **options):
    over = hf.grid(system, {"x": (-1.5, 1.5), "y": (-1.5, 1.5)}, {"x": 41, "y": 61}, FREE)
    return [problem(system, *about, over, 1.0, device=d, **options) for d in ("cpu", "c++")]


@pytest.mark.few("forward_reachable_set-system6-about6-options6")
@pytest.mark.parametrize(
    ("problem", "system", "about", "options"),
    [
        (hf.discriminating_kernel, cart(), (WALLS,), {}),
        (hf.discriminating_kernel, cart(), (WALLS,), {"precision": "float32", "skip": False}),
        (hf.viability_kernel, cart(), (WALLS,), {"disturbance": {"v": 0.1}, "scheme": "upwind",
                                                 "symmetry": None, "band": 0.3}),
        (hf.backward_reachable_tube, cart(), (DOCK,), {"scheme": "eno2", "times": [0.3, 1.0]}),
        (hf.capture_basin, cart(), (DOCK, WALLS), {"scheme": "eno3"}),
        (hf.discriminating_kernel, cart(sp.cos(T)), (MOVING,), {"order": 2}),
        (hf.forward_reachable_set, cart(), (DOCK,), {"dissipation": "global"}),
    ],
)  # fmt: skip
def test_every_problem_has_the_answer_of_the_processor(problem, system, about, options):
    here, there = both(problem, system, *about, **options)
    rounding = ROUNDING[options.get("precision", "float64")]
    np.testing.assert_allclose(there.values(), here.values(), rtol=0, atol=rounding)
    assert (np.sign(here.values()) == np.sign(there.values())).all()
    for name in ("steps", "converged", "reached_s", "ends_reached"):
        assert getattr(here.report, name) == getattr(there.report, name)
    if "arrival" in here.dataset:
        arrivals = [v.dataset["arrival"].values for v in (here, there)]
        np.testing.assert_allclose(*arrivals, rtol=0, atol=1e-9)


def test_half_of_a_symmetric_grid_suffices_there_too():
    still = hf.System(
        "still", PLANE, (hf.Quantity("u"),), {"x": Y, "y": U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    here, there = both(hf.viability_kernel, still, WALLS, symmetry={"x": -1, "y": -1})
    np.testing.assert_allclose(there.values(), here.values(), rtol=0, atol=1e-12)
    assert there.report.computed_share < 0.7


def test_what_is_settled_is_left_out_and_the_answer_is_the_same():
    over = hf.grid(cart(), {"x": (-1.5, 1.5), "y": (-1.5, 1.5)}, {"x": 41, "y": 600}, FREE)
    given = {"band": 0.1, "scheme": "upwind", "device": "c++"}
    some, every = (
        hf.discriminating_kernel(cart(), WALLS, over, 1.0, skip=skip, **given)
        for skip in (True, False)
    )
    assert (some.values() == every.values()).all()
    assert some.report.computed_share < 0.8
    assert every.report.computed_share == 1


@pytest.mark.heavy
def test_only_the_dissipation_of_optimal_inputs_may_tell_roundings_apart():
    """On a ridge the sign of a slope is that of its rounding: docs/gpu.md."""
    x, y, th, u, w = (hf.symbol(n) for n in ("x", "y", "th", "u", "w"))
    states = (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("th", "rad", angle=True))
    robot = hf.System(
        "robot", states, (hf.Quantity("u", "m/s"), hf.Quantity("w", "rad/s")),
        {"x": u * sp.cos(th), "y": u * sp.sin(th), "th": w}, input_bounds=hf.Box((0.5, -1), (1, 1)),
    )  # fmt: skip
    square = hf.Region("square", states[:2], tuple(
        hf.Inequality(n, e, "m") for n, e in (("a", x - 1), ("b", -1 - x), ("c", y - 1), ("d", -1 - y))
    ))  # fmt: skip
    box = {"x": (-1.2, 1.2), "y": (-1.2, 1.2), "th": (-np.pi, np.pi)}
    over = hf.grid(robot, box, {"x": 21, "y": 19, "th": 16})
    for dissipation, most in (("local", 1e-14), ("local-local", 0.02)):
        here, there = (
            hf.viability_kernel(robot, square, over, 0.2, dissipation=dissipation, device=d)
            for d in ("cpu", "c++")
        )
        np.testing.assert_allclose(there.values(), here.values(), rtol=0, atol=most)
        assert (np.sign(here.values()) == np.sign(there.values())).all()


def march(shape, scheme, device, precision="float64"):
    axes = [np.linspace(-1, 1 + 0.3 * i, m) for i, m in enumerate(shape)]
    return March(
        hamiltonian(len(shape)), (), axes, [a[1] - a[0] for a in axes],
        [KINDS[i % 3] for i in range(len(shape))], method=Method(scheme, order=3),
        limit="shrink", precision=precision, device=device,
    )  # fmt: skip


@pytest.mark.few("(300,)-weno5-float64")
@pytest.mark.parametrize(
    ("shape", "scheme", "precision"),
    [
        ((300,), "weno5", "float64"),
        ((9, 600), "eno2", "float32"),
        ((8, 9, 11), "upwind", "float64"),
        ((7, 8, 9, 13), "weno5", "float32"),
    ],
    ids=str,
)
def test_rough_values_and_all_ends_differ_by_roundings(shape, scheme, precision):
    rng = np.random.default_rng(1)
    start = rng.normal(size=shape).astype(precision)
    found = []
    for device in (None, HostDevice()):
        m = march(shape, scheme, device, precision)
        values = start.ravel().copy()
        done = m.run(
            values, [1.3 * m.longest_step, 4 * m.longest_step], within=Within(nearest=1e-9)
        )
        found.append((values, done))
    (here, one), (there, other) = found
    np.testing.assert_allclose(there, here, rtol=0, atol=ROUNDING[precision] / 10)
    assert (np.sign(here) == np.sign(there)).all()
    assert other.last == pytest.approx(one.last, rel=1e-4)
    assert one.steps == other.steps


def test_a_value_that_is_not_finite_is_named_with_its_node():
    m = march((9, 20), "upwind", HostDevice())
    values = np.zeros(180)
    values[45] = np.nan
    with pytest.raises(hf.errors.SimulationError, match="not finite at q0 ="):
        m.run(values, [m.longest_step])


@needs_nvcc
def test_cuda_takes_the_same_text(tmp_path):
    m = march((7, 8, 9, 13), "weno5", HostDevice(), "float32")
    stage = m.leaves.stage(lower=True, upper=True)
    accepted_by_cuda(whole_text(march_text(stage, m.scheme, "float32", 13)), tmp_path)
