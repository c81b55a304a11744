"""What is said of a held input contains what trajectories do, with any disturbance."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.arithmetic.steps import Steps
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals.enclosure import Interval
from holdfast.execution.intervals.enclosures import enclosures
from holdfast.execution.intervals.held_flow import HeldFlow, Sampling
from holdfast.execution.leaf import compiled_leaves
from holdfast.maths.catalogue.signature import example

STEPS = 40


def runs(rate, q, u, disturbances, hold, generator):
    """Trajectories by Runge-Kutta steps, their disturbances drawn anew at every one."""
    path, h = [q], hold / STEPS
    for _ in range(STEPS):
        d = generator.uniform(*disturbances, (len(q), disturbances[0].size))
        if generator.random() < 0.5:  # the worst is often at a corner
            d = np.where(d > disturbances.mean(axis=0), disturbances[1], disturbances[0])
        a = rate(q, u, d)
        b = rate(q + h / 2 * a, u, d)
        c = rate(q + h / 2 * b, u, d)
        q = q + h / 6 * (a + 2 * b + 2 * c + rate(q + h * c, u, d))
        path.append(q)
    return np.array(path)


TURNING = hf.System(
    "pendulum",
    (hf.Quantity("x", "rad"), hf.Quantity("v", "rad/s")),
    (hf.Quantity("u", "1/s^2"),),
    {"x": hf.symbol("v"), "v": -9 * sp.sin(hf.symbol("x")) + hf.symbol("u") + hf.symbol("d")},
    disturbances=(hf.Quantity("d", "1/s^2"),),
)


@pytest.mark.few("12-parallelepiped", "12-zonotope")
@pytest.mark.parametrize("name", enclosures())
@pytest.mark.parametrize("steps", [1, 3, 12])
def test_every_enclosure_holds_ten_thousand_trajectories_of_a_pendulum(name, steps):
    """Of 100 boxes 100 trajectories each, with disturbances that jump; the rate has a sine."""
    generator = np.random.default_rng(4)
    low = generator.uniform(-1, 1, (100, 2))
    high, u = low + 0.05, generator.uniform(-1, 1, (100, 1))
    symbols = [[q.symbol for q in m] for m in (TURNING.states, TURNING.inputs)]
    hold, d = 0.15 if steps == 1 else 0.8, TURNING.disturbances[0].symbol
    flow = HeldFlow(
        list(TURNING.rates.values()), [symbols[0][0] - 9], *symbols, {d: (-0.2, 0.2)}, {},
        Sampling(hold, steps=steps, enclosure=name),
    )  # fmt: skip
    held = flow.held(low, high, u)
    rate = compiled(TURNING.rates.values(), *symbols, [d])
    inside = np.repeat(low, 100, 0) + 0.05 * generator.uniform(0, 1, (10_000, 2))
    path = runs(rate, inside, np.repeat(u, 100, 0), np.array([[-0.2], [0.2]]), hold, generator)
    ends = [np.repeat(m, 100, 0) for m in (held.low, held.high, held.way_low, held.way_high)]
    sure = np.repeat(held.kept, 100)
    assert sure.mean() > 0.9
    assert ((ends[0] <= path[-1]) & (path[-1] <= ends[1]))[sure].all()
    assert ((ends[2] <= path) & (path <= ends[3]))[:, sure].all()


@pytest.mark.heavy
def test_zonotope_of_what_turns_is_narrower():
    """A pendulum that is held for 0.8 s in 12 steps: by a tenth in the mean at least."""
    low = np.random.default_rng(4).uniform(-1, 1, (100, 2))
    symbols = [[q.symbol for q in m] for m in (TURNING.states, TURNING.inputs)]
    widths = {}
    for name in enclosures():
        flow = HeldFlow(
            list(TURNING.rates.values()), [], *symbols,
            {TURNING.disturbances[0].symbol: (-0.2, 0.2)}, {},
            Sampling(0.8, steps=12, enclosure=name),
        )  # fmt: skip
        held = flow.held(low, low + 0.05, np.zeros((100, 1)))
        widths[name] = (held.high - held.low).mean(axis=0)
    assert (widths["zonotope"] < 0.9 * widths["parallelepiped"]).all()


def compiled(rates, states, inputs, disturbances):
    names = {"sgn": lambda x: np.where(x >= 0, 1, -1), "magnitude": np.abs}
    found = sp.lambdify([*states, *inputs, *disturbances], list(rates), [names, "numpy"])

    def rate(q, u, d):
        values = found(*q.T, *u.T, *d.T)
        return np.stack([np.broadcast_to(v, len(q)) for v in values], axis=1)

    return rate


SYSTEMS = [
    hf.systems.unicycle(),
    hf.systems.drifting_unicycle(),
    hf.systems.front_axle_car(),
    hf.systems.tractor_trailer(trailers=1),
    hf.load_vehicle("videoray_pro_iii"),
    hf.load_vehicle("otter"),
]


@pytest.mark.few("0.3-unicycle", "0.3-drifting_unicycle")
@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.name)
@pytest.mark.parametrize("hold", [0.05, 0.3])
def test_no_trajectory_leaves_what_is_said_of_it(system, hold):
    generator = np.random.default_rng(3)
    numbers = {p.symbol: p.value for p in system.parameters}
    states, inputs, disturbances = (
        [q.symbol for q in g] for g in (system.states, system.inputs, system.disturbances)
    )
    bound = dict.fromkeys(disturbances, (-0.2, 0.1))
    flow = HeldFlow(
        list(system.rates.values()), [states[0] - 0.1], states, inputs, bound,
        {s: (v, v) for s, v in numbers.items()}, hold,
    )  # fmt: skip
    rates = [sp.sympify(r).xreplace({s: sp.Float(v) for s, v in numbers.items()})
             for r in system.rates.values()]  # fmt: skip
    rate = compiled(rates, states, inputs, disturbances)
    low = generator.uniform(-0.7, 0.7, (30, len(states)))
    high = low + generator.uniform(0.001, 0.1, low.shape)
    u = generator.uniform(-1, 1, (30, len(inputs)))
    said = flow.held(low, high, u)
    ends = np.array([[-0.2] * len(disturbances), [0.1] * len(disturbances)])
    assert np.isfinite(said.low).all()
    for _ in range(20):
        share = generator.random(low.shape)
        corner = generator.random(low.shape) < 0.5
        q = np.where(corner, np.round(share), share) * (high - low) + low
        path = runs(rate, q, u, ends, hold, generator)
        room = 1e-9  # of the Runge-Kutta steps
        assert (path[-1] >= said.low - room).all()
        assert (path[-1] <= said.high + room).all()
        assert (path >= said.way_low - room).all()
        assert (path <= said.way_high + room).all()
        held = (path[:, :, 0] <= 0.1).all(axis=0)
        both = (path[0, :, 0] <= 0.1) & (path[-1, :, 0] <= 0.1)
        assert (held | ~both | ~said.kept).all()


def test_end_of_a_rotation_is_as_narrow_as_the_turned_box():
    """With r held the box turns: its hull is cos + sin times as wide, and no wider."""
    a, b, r = sp.symbols("a b r", real=True)
    flow = HeldFlow([r * b, -r * a], [], [a, b], [r], {}, {}, 0.1)
    low = np.array([[1.0, 0.2]])
    said = flow.held(low, low + 0.01, np.array([[0.8]]))
    width = said.high - said.low
    assert (width < 0.01 * (np.cos(0.08) + np.sin(0.08)) * 1.005).all()
    assert (width > 0.01 * (np.cos(0.08) + np.sin(0.08)) * 0.9999).all()


def test_drag_makes_a_box_narrower():
    v, f = sp.symbols("v f", real=True)
    flow = HeldFlow([-2 * v + f], [], [v], [f], {}, {}, 0.1)
    said = flow.held(np.array([[1.0]]), np.array([[1.1]]), np.array([[0.5]]))
    assert float((said.high - said.low)[0, 0]) < 0.1 * np.exp(-0.2) * 1.01


def test_constraint_may_be_left_between_two_samples_that_keep_it():
    """A ball that is thrown up under a ceiling at 1: at both ends below, between above."""
    x, v, g = sp.symbols("x v g", real=True)
    throw = HeldFlow([v, -g], [x - 1], [x, v], [g], {}, {}, 1.0)
    at = np.array([[0.9, 1.0], [0.1, 1.0], [0.9, -0.1]])
    said = throw.held(at, at + 1e-6, np.full((3, 1), 2.0))
    assert said.kept.tolist() == [False, True, True]  # highest at 1.15 and 0.35, and falling


def test_uncertain_parameter_is_every_number_between_its_ends():
    v, f, drag = sp.symbols("v f drag", real=True)
    flow = HeldFlow([f - drag * v], [], [v], [f], {}, {drag: (1.0, 2.0)}, 0.1)
    said = flow.held(np.array([[1.0]]), np.array([[1.0]]), np.array([[0.0]]))
    assert said.low[0, 0] <= np.exp(-0.2)
    assert said.high[0, 0] >= np.exp(-0.1)
    assert said.high[0, 0] - said.low[0, 0] < 0.115


def test_rate_that_jumps_is_enclosed_without_its_slope():
    x, u = sp.symbols("x u", real=True)
    jump = hf.parse_expression("u*sgn(x)", {"x": x, "u": u})
    flow = HeldFlow([jump], [], [x], [u], {}, {}, 0.1)
    said = flow.held(np.array([[-0.01], [0.1]]), np.array([[0.01], [0.2]]), np.full((2, 1), 0.5))
    assert said.low[0, 0] <= -0.06
    assert said.high[0, 0] >= 0.06
    assert said.low[1, 0] == pytest.approx(0.15)


def test_way_that_cannot_be_proved_is_not_kept():
    """q' = q^2 from 5 leaves every bound within 0.2 s."""
    q = sp.Symbol("q", real=True)
    flow = HeldFlow([q**2], [q - 1e300], [q], [], {}, {}, 0.3)
    said = flow.held(np.array([[5.0], [0.1]]), np.array([[5.1], [0.2]]), np.empty((2, 0)))
    assert said.kept.tolist() == [False, True]


def test_catalogue_has_a_flow_where_it_has_enclosures():
    system = example(hf.systems.leader_follower)
    states, inputs = ([q.symbol for q in g] for g in (system.states, system.inputs))
    bounds = {d.symbol: (-0.1, 0.1) for d in system.disturbances}
    numbers = {p.symbol: (p.value, p.value) for p in system.parameters}
    flow = HeldFlow(list(system.rates.values()), [], states, inputs, bounds, numbers, 0.1)
    low = np.full((1, len(states)), 1.0)
    said = flow.held(low, low + 0.01, np.zeros((1, len(inputs))))
    assert np.isfinite(said.high).all()


def test_slopes_that_are_one_expression_are_no_square():
    """Of x' = x y, y' = x^2/2 two slopes are x, at places and instants that differ."""
    x, y = sp.symbols("x y", real=True)
    flow = HeldFlow([x * y, x**2 / 2], [], [x, y], [], {}, {}, 0.5)
    rate = compiled([x * y, x**2 / 2], [x, y], [], [])
    low, high = np.array([[-0.4, -0.3]]), np.array([[0.4, 0.5]])
    said = flow.held(low, high, np.empty((1, 0)))
    generator = np.random.default_rng(1)
    q = low + (high - low) * np.round(generator.random((200, 2)) * 4) / 4
    path = runs(rate, q, np.empty((200, 0)), np.empty((2, 0)), 0.5, generator)
    assert (path[-1] >= said.low - 1e-9).all()
    assert (path[-1] <= said.high + 1e-9).all()


def test_product_of_two_quantities_of_one_interval_is_no_square():
    steps = Steps(expanded=True)
    q = Interval(steps.input("low"), steps.input("high"))
    ends = [end for found in (q * q, q * q.copy()) for end in (found.low, found.high)]
    leaves = compiled_leaves({"product": Leaf(steps, {"q": ["low", "high"]}, ends)})
    found = leaves.values("product", 1, 4, np.array([[-1.0, 2.0]]))[0]
    assert found == pytest.approx([0, 4, -2, 4])


def test_undeclared_symbol_of_a_rate_is_named():
    x, y = sp.symbols("x y", real=True)
    with pytest.raises(DefinitionError, match="uses 'y'"):
        HeldFlow([x * y], [], [x], [], {}, {}, 0.1)
