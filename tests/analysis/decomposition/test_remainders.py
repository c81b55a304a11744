"""Affine forms with a proved rest."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.decomposition.decompose import lag_free
from holdfast.analysis.decomposition.guaranteed import affine_in
from holdfast.errors import SimulationError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.expressions.functions import magnitude
from tests.parted_systems import symbols

P, Q, A, B, W = symbols("p q a b w")
SWUNG = {A: (-0.3, 0.3), B: (-0.1, 0.4)}
FREE = {W: (-1.0, 1.0)}
BOX = {P: (-1.0, 1.0), Q: (-2.0, 2.0)}
ROWS = {
    "smooth": sp.sin(P + A) * Q + A * B,
    "drag": -magnitude(Q - A) * (Q - A) + B,
    "kink": magnitude(P + A) + Q,
    "driven": W * sp.cos(P + B) + A * W,
    "apart": P * Q + W,
}


def drawn(count, *tables, seed=0):
    ends = np.array([i for table in tables for i in table.values()])
    return np.random.default_rng(seed).uniform(ends[:, 0], ends[:, 1], (count, len(ends)))


@pytest.mark.parametrize("name", ROWS)
def test_what_is_left_out_is_within_the_rest(name):
    found = affine_in({name: ROWS[name]}, SWUNG, FREE, BOX)[name]
    middle = [A, B - sp.Float(0.15)]
    form = found.still + sum(g * m for g, m in zip(found.gains, middle, strict=True))
    gap = Evaluator([ROWS[name] - form], [*BOX, *SWUNG, *FREE], ())
    largest = np.abs(gap.values(drawn(20_000, BOX, SWUNG, FREE))).max()
    assert largest <= found.rest
    assert found.rest <= 8 * largest + 1e-12


def test_what_does_not_depend_on_the_swung_symbols_has_no_rest():
    assert affine_in({"apart": ROWS["apart"]}, SWUNG, FREE, BOX)["apart"].rest == 0


def test_a_drag_is_followed_and_a_kink_is_all_rest():
    found = affine_in(ROWS, SWUNG, FREE, BOX)
    assert found["drag"].gains[0] != 0
    assert found["kink"].gains == (0, 0)


def test_a_rate_without_a_bound_is_refused():
    with pytest.raises(SimulationError, match="nothing bounds"):
        affine_in({"pole": 1 / (P + A)}, SWUNG, FREE, BOX)


def test_the_inequalities_of_a_predicted_vehicle_hold_for_every_thrust():
    """A unicycle whose turn rate lags and drags, before a wall that it looks at."""
    x, psi, r, a, u = symbols("x psi r actual_u u")
    system = hf.lagged(
        hf.System(
            "rover", tuple(hf.Quantity(n) for n in ("x", "psi", "r")), (hf.Quantity("u"),),
            {"x": sp.cos(psi) - 1, "psi": r, "r": u - magnitude(r) * r},
            input_bounds=hf.Box((-1,), (1,)),
        ),
        {"u": 0.2},
    )  # fmt: skip
    numbers = {q.symbol: sp.Float(q.value) for q in system.parameters}
    wall = hf.Inequality("wall", x * sp.cos(psi) + magnitude(sp.sin(psi)) - 1)
    box = {"x": (-1, 1), "psi": (-1, 1), "r": (-1, 1)}
    free = lag_free(system, [wall], 0.5, box, numbers)
    tight = next(c.expression for c in free.inequalities if c.name == "wall")
    moved = wall.expression.xreplace(dict(free.prediction.back))
    over = {hf.symbol(n): i for n, i in box.items()} | {a: (-0.5, 0.5)}
    gap = Evaluator([tight - moved], list(over), ()).values(drawn(20_000, over))
    assert gap.min() >= 0
    assert gap.max() < 0.1
    ((low, high),) = free.prediction.bounds.ranges()
    rests = [q for q in free.system.disturbances if q.name.startswith("rest_of_")]
    ends = free.system.disturbance_bounds.upper[-len(rests) :]
    for rest, end in zip(rests, ends, strict=True):
        name = rest.name.removeprefix("rest_of_")
        form = free.system.rates[name].xreplace({rest.symbol: sp.S.Zero})
        both = {**over, u: (float(low), float(high))}
        error = Evaluator([free.prediction.rates[name] - form], list(both), ())
        assert np.abs(error.values(drawn(20_000, both))).max() <= float(end)
