"""Functions of SymPy in definitions: the same values, and derivatives that compile, or a refusal."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.expressions.functions import angle, length
from holdfast.maths.expressions.traversal import canonical, parts
from holdfast.maths.expressions.written import FUNCTIONS

X, Y, U, W = (hf.symbol(n) for n in ("x", "y", "u", "w"))
STATES = (hf.Quantity("x"), hf.Quantity("y"))

EXPRESSIONS = {
    "Abs": sp.Abs(X - Y) * abs(Y),
    "Max": sp.Max(X - 1, -X - 1, Y - 1, -Y - 1, X * Y),
    "Min": sp.Min(X, Y, sp.cos(X)),
    "Max of Abs": -sp.Max(sp.Abs(X) - 1, sp.Abs(Y) - 1),
    "sign": sp.sign(X - Y) * X + sp.sign(Y),
    "Heaviside": sp.Heaviside(X) * Y + sp.Heaviside(Y, 0) * X,
    "atan2": sp.atan2(Y, X + 3),
    "Piecewise": sp.Piecewise((1 - X, X > 0), (1 + X, True)),
    "several cases": sp.Piecewise((X, X >= 1), (Y, X < -1), (X * Y, X <= Y), (X + Y, True)),
    "And, Or, Not": sp.Piecewise(
        (X, sp.And(X > 0, Y > 0)), (Y, sp.Or(X < -1, Y <= -1)), (1, sp.Not(sp.Eq(X, Y))), (7, True)
    ),
    "cases that are all": sp.Piecewise((X**2, X < 0), (sp.Max(X, Y), X >= 0)),
    "nested": sp.Max(sp.Piecewise((sp.Abs(X), Y > 0), (sp.Min(X, Y), True)), sp.sign(X)),
    "ratios": sp.cot(X + 5) + sp.sec(X) * sp.csc(Y + 9) + sp.sech(X) - sp.csch(Y + 9) * sp.coth(9),
}


def points():
    """Some of them where cases meet."""
    generator = np.random.default_rng(0)
    corners = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    return np.vstack([corners, generator.uniform(-2, 2, (60, 2))])


@pytest.mark.few("sign", "Heaviside", "Piecewise", "several cases", "cases that are all")
@pytest.mark.parametrize("name", EXPRESSIONS)
def test_value_is_that_of_sympy_where_cases_meet_too(name):
    found = Evaluator([canonical(EXPRESSIONS[name])], [X, Y], ()).values(points(), {})[:, 0]
    wanted = [float(EXPRESSIONS[name].subs({X: x, Y: y})) for x, y in points()]
    assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_derivatives_compile_and_are_those_of_the_case_taken(name):
    expression = canonical(EXPRESSIONS[name])
    slopes = Evaluator([expression.diff(X), expression.diff(Y)], [X, Y], ())
    second = Evaluator([expression.diff(X, Y)], [X, Y], ())
    inside, step = points()[9:], 1e-6
    value = Evaluator([expression], [X, Y], ())
    for k in range(2):
        moved = np.zeros(2)
        moved[k] = step
        ahead, behind = (value.values(inside + s * moved, {})[:, 0] for s in (1, -1))
        exact = slopes.values(inside, {})[:, k]
        smooth = np.abs(ahead - behind) < 1e-3  # no jump between the two
        assert smooth.sum() > 50
        assert ((ahead - behind) / (2 * step))[smooth] == pytest.approx(exact[smooth], abs=1e-4)
    assert np.isfinite(second.values(inside, {})).all()


def test_derivatives_of_all_that_a_definition_may_use_are_made_of_the_same():
    """So whatever is derived from a definition that was accepted compiles."""
    of_numbers = {
        "nearest_on_walls",
        "nearest_face",
        "nearest_to_sight",
        "separating_sides",
        "passing",
    }  # with walls: elsewhere
    for name, function in FUNCTIONS.items():
        if name in of_numbers:
            continue
        counts = {angle: 3, length: 3, FUNCTIONS["select"]: 3}
        two = name in ("Add", "Mul", "Pow", "least", "greatest", "Min", "Max", "atan2")
        inner = [X * Y, X - Y**2, sp.Float(1e-12)]
        if name == "select":
            inner[2] = X + Y
        made = canonical(function(*inner[: counts.get(function, 2 if two else 1)]))
        for slope in (made.diff(X), made.diff(X, Y), made.diff(Y, 2)):
            odd = [p for p in parts([slope]) if p.args and type(p) not in FUNCTIONS.values()]
            assert not odd, name


def plane(rates=None, **more):
    inputs = (hf.Quantity("u"), hf.Quantity("w"))
    bounds = hf.Box((-1, -1), (1, 1))
    return hf.System("p", STATES, inputs, rates or {"x": U, "y": W}, input_bounds=bounds, **more)


def box(expression):
    return hf.Region("r", STATES, (hf.Inequality("box", expression, "m"),))


@pytest.mark.few("Piecewise")
@pytest.mark.parametrize(
    "outside",
    [
        -sp.Max(sp.Abs(X) - 1, sp.Abs(Y) - 1),
        -sp.Max(X - 1, -X - 1, Y - 1, -Y - 1),
        sp.Min(1 - abs(X), 1 - abs(Y)),
        sp.Piecewise((1 - sp.Abs(X), sp.Abs(X) > sp.Abs(Y)), (1 - sp.Abs(Y), True)),
    ],
    ids=["Abs", "Max", "Min", "Piecewise"],
)
def test_box_to_stay_out_of_is_the_same_however_it_is_written(outside):
    """Simulated, filtered, safeguarded: as the text of a scenario file has it."""
    text = hf.parse_expression("-max(abs(x) - 1, abs(y) - 1)", {"x": X, "y": Y})
    law = hf.Law("go", STATES, {"u": sp.S.One, "w": -Y})
    settings = {"starts": [[-3, 0.5]], "horizon": 5, "start_outside": True}
    ends = []
    for expression in (outside, text):
        region, system = box(expression), plane()
        alone = hf.simulate(system, law, region=region, **settings)
        kept = hf.simulate(system, hf.safeguard(system, law, region), region=region, **settings)
        decision = hf.SafetyFilter(system, region).step([-1.2, 0.5], [1, 0])
        ends.append(
            [
                alone.dataset["constraint"].values, kept.dataset["constraint"].values,
                decision.input, decision.status,
            ]
        )  # fmt: skip
        assert (alone.viable, kept.viable) == (0, 1)
    for ours, theirs in zip(*ends, strict=True):
        assert np.all(ours == theirs)


def test_rates_laws_guards_and_measurements_take_them_too():
    far = sp.Max(sp.Abs(X), sp.Abs(Y))
    seen = hf.Measurement("far", "m", expression=far)
    system = plane({"x": U - sp.sign(X) / 2, "y": sp.Min(W, sp.Abs(X))}, measurements=(seen,))
    law = hf.Law("back", STATES, {"u": -sp.Max(X, Y), "w": sp.Piecewise((-Y, Y > 0), (0, True))})
    modes = {"back": law, "stay": hf.Law("stay", STATES, {"u": sp.S.Zero, "w": sp.S.Zero})}
    switching = hf.Switching("both", modes, (hf.Transition("back", "stay", sp.Min(X, Y) - 5),))
    for one in (law, switching):
        found = hf.simulate(system, one, starts=[[1.0, 0.5]], horizon=1, region=box(far - 9))
        assert found.viable == 1
    assert system.derivative(seen.expression).free_symbols >= {X, Y, U}


REFUSED = {
    "floor": sp.floor(X), "ceiling": sp.ceiling(X), "Mod": sp.Mod(X, 2), "erf": sp.erf(X),
    "frac": sp.Function("frac")(X), "mine": sp.Function("mine")(X), "asinh": sp.asinh(X),
    "Integral": sp.Integral(sp.exp(-X * Y**2), (Y, 0, X)), "sinc": sp.sinc(X),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_other_functions_are_refused_by_name_when_the_definition_is_made(name):
    odd = REFUSED[name]
    with pytest.raises(DefinitionError, match=f"'box' of region 'r' uses '{name}'"):
        box(1 - odd)
    with pytest.raises(DefinitionError, match=f"rate of 'x' of system 'p' uses '{name}'"):
        plane({"x": U + odd, "y": W})
    with pytest.raises(DefinitionError, match=f"output 'u' of law 'a' uses '{name}'"):
        hf.Law("a", STATES, {"u": odd, "w": sp.S.Zero})
    stay = hf.Law("stay", STATES, {"u": sp.S.Zero, "w": sp.S.Zero})
    with pytest.raises(DefinitionError, match=f"guard a -> b .* uses '{name}'"):
        hf.Switching("s", {"a": stay, "b": stay}, (hf.Transition("a", "b", odd),))


def test_piecewise_that_ends_somewhere_is_refused():
    with pytest.raises(DefinitionError, match="no value where none of its conditions holds"):
        box(sp.Piecewise((X, X > 0), (Y, X < -1)))
