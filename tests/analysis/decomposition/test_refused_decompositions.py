"""Problems whose parts would promise too much are refused, each with its reason."""

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import HoldfastError
from holdfast.maths.expressions.functions import magnitude, sgn

X, V, A, Y, W, U, D = (hf.symbol(n) for n in "xvaywud")
BOX = {"x": (-1.5, 1.5), "v": (-2, 2)}


def system(rates, disturbed=False):
    more = {}
    if disturbed:
        more = {
            "disturbances": (hf.Quantity("d"),), "disturbance_bounds": hf.Box((-0.5,), (0.5,)),
        }  # fmt: skip
    return hf.System(
        "cart", tuple(hf.Quantity(n) for n in rates), (hf.Quantity("u"),), rates,
        input_bounds=hf.Box((-1,), (1,)), **more,
    )  # fmt: skip


def walls(name, *more):
    s = hf.symbol(name)
    rows = [hf.Inequality("low", -1 - s), hf.Inequality("high", s - 1), *more]
    reads = {name, *(str(t) for c in rows for t in c.expression.free_symbols)}
    return hf.Region("walls", tuple(hf.Quantity(n) for n in sorted(reads)), tuple(rows))


JUMP = hf.Inequality("jump", W - 0.5 - 0.6 * sgn(W - 0.2)), hf.Inequality("less", -1 - W)


@pytest.mark.parametrize(
    ("rates", "region", "options", "said"),
    [
        ({"x": V, "v": A, "a": 5 * (A - U)}, walls("x"), {"lag_share": 0.8, "box": BOX},
         "time constant is -0.2 s"),
        ({"x": V, "v": A, "a": (U + 0.4 - A) / 0.2}, walls("x"), {"lag_share": 0.5, "box": BOX},
         "rests at 0.4 without a command"),
        ({"x": sp.Integer(-1), "y": V * sgn(X), "v": A, "a": 2 * (U - A)}, walls("y"),
         {"lag_share": 0.3, "box": {**BOX, "y": (-1.5, 1.5)}}, "prediction of 'y' jumps"),
        ({"x": V, "v": U + W, "w": 2 * sp.sqrt(magnitude(1 - W))}, walls("x"),
         {"cut": {"w": (-1, 1)}}, "not seen to stay within"),
        ({"x": V, "v": U + W, "w": U / 2}, walls("x", *JUMP), {"cut": {"w": None}},
         "no interval is known that 'w' stays in"),
        ({"x": V, "v": U}, walls("x"), {"cut": {"x": None}}, "no part has 'x' as a disturbance"),
        ({"x": V, "v": U}, walls("x"), {"disturbances": "banana"}, "disturbances: 'banana'"),
        ({"x": V, "v": U}, walls("x"), {"disturbances": "max"}, "whose disturbances help"),
        ({"x": V, "v": U}, None,
         {"kind": "capture-basin", "goal": walls("x"), "disturbances": "max"},
         "whose disturbances help"),
        ({"x": V, "v": U + 1 - W**2, "w": -W}, walls("x"), {"cut": {"w": (-1, 1)}},
         "are not affine in 'w'"),
    ],
)  # fmt: skip
def test_what_would_promise_too_much_is_refused(rates, region, options, said):
    """An actuator that runs away or rests elsewhere, a prediction that jumps, a state that leaves
    an interval at whose end it may rest, an inequality that jumps, a state whose worst value may
    lie between its ends, and arguments without effect."""
    with pytest.raises(HoldfastError, match=said):
        hf.decompose(system(rates), region, **options)


def test_effect_that_depends_on_a_disturbance_is_named():
    made = system({"x": V, "v": (1 + D) * A, "a": 5 * (U - A)}, disturbed=True)
    with pytest.raises(HoldfastError, match="what an actuator does to 'v' depends on 'd'"):
        hf.decompose(made, walls("x"), kind="discriminating-kernel", lag_share=0.8, box=BOX)


def test_state_that_decays_towards_the_middle_of_its_interval_is_cut():
    made = system({"x": V, "v": U + 0.8 * W, "w": -W})
    assert hf.decompose(made, walls("x"), cut={"w": (-0.5, 0.5)}).verdict == "inner"
