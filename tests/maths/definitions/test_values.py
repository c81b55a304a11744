"""Definitions are values: equal, hashed, copied and pickled by what they have, to the last part."""

import copy
import pickle
from dataclasses import fields, replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.definitions.law import Lookup
from holdfast.maths.definitions.value import FrozenDict, content, picklable
from holdfast.scenario.files import scenario_names

X, Y = hf.symbol("x"), hf.symbol("y")


def expressions(part):
    """Every expression in a definition, in the order in which it is met."""
    if isinstance(part, sp.Basic):
        yield part
    elif hasattr(part, "__dataclass_fields__"):
        for field in fields(part):
            yield from expressions(getattr(part, field.name))
    elif isinstance(part, dict):
        for held in part.values():
            yield from expressions(held)
    elif isinstance(part, tuple | list):
        for held in part:
            yield from expressions(held)


def same_trees(pairs):
    """Whether the expressions are the same, node by node; a node that many share is visited once."""
    waiting, visited = list(pairs), set()
    while waiting:
        a, b = waiting.pop()
        if (a, b) in visited:
            continue
        visited.add((a, b))
        if type(a) is not type(b) or len(a.args) != len(b.args):
            return False
        if not a.args and sp.srepr(a) != sp.srepr(b):
            return False
        waiting.extend(zip(a.args, b.args, strict=True))
    return True


def test_trees_are_told_apart_by_an_order_and_by_a_kind_of_number():
    assert same_trees([(X + 2 * Y, X + 2 * Y)])
    assert not same_trees([(sp.Add(X, Y, evaluate=False), sp.Add(Y, X, evaluate=False))])
    assert not same_trees([(2 * X, 2.0 * X)])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.few("berth-filter", "berth-kernel", "ch4-car", "ch6-corridor", "inspection",
                 "late-propellers", "slipping-view")  # fmt: skip
@pytest.mark.parametrize("name", scenario_names())
def test_a_scenario_and_its_parts_are_equal_to_their_copies(name):
    scenario = hf.load_scenario(name)
    for copied in (pickle.loads(pickle.dumps(scenario)), copy.deepcopy(scenario)):
        assert copied == scenario
        assert hash(copied) == hash(scenario)
        assert same_trees(zip(expressions(copied), expressions(scenario), strict=True))
    assert copy.copy(scenario) is scenario
    assert len({scenario, copied, hf.load_scenario(name)}) == 1
    assert replace(scenario, title="another") != scenario


def boat():
    return hf.System(
        "boat", (hf.Quantity("x", "m"),), (hf.Quantity("u", "m/s"),), {"x": hf.symbol("u")},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip


def test_a_definition_is_another_where_a_part_is():
    system = boat()
    assert system == boat()
    assert hash(system) == hash(boat())
    assert system != replace(system, input_bounds=hf.Box((-1,), (2,)))
    assert system != replace(system, rates={"x": 2 * hf.symbol("u")})
    law = hf.Law("home", system.states, {"u": -X})
    assert law != replace(law, outputs={"u": -2 * X})
    assert {law: 1}[hf.Law("home", system.states, {"u": -X})] == 1


def test_tables_are_compared_by_their_numbers():
    def table(last):
        return Lookup((X,), (np.array([0.0, np.nan, last]), np.array([3])), unit="m")

    assert table(1.0) == table(1.0)
    assert hash(table(1.0)) == hash(table(1.0))
    assert table(1.0) != table(2.0)
    assert pickle.loads(pickle.dumps(table(1.0))) == table(1.0)


def test_a_part_of_a_definition_cannot_be_changed():
    outputs = hf.Law("home", boat().states, {"u": -X}).outputs
    for change in (
        lambda: outputs.update(u=X),
        lambda: outputs.pop("u"),
        lambda: outputs.__setitem__("u", X),
        lambda: outputs.clear(),
        lambda: outputs.setdefault("v", X),
    ):
        with pytest.raises(TypeError, match="cannot be changed; make another with replace"):
            change()
    assert outputs == {"u": -X}
    assert outputs | {"v": X} == {"u": -X, "v": X}


@pytest.mark.parametrize(
    "expression",
    [
        sp.Mul(2, X + Y, evaluate=False),
        sp.Add(X, X, evaluate=False),
        sp.Pow(sp.Integer(2), 3, evaluate=False),
        sp.sin(sp.Integer(0), evaluate=False),
        hf.parse_expression("select(x - 1, wrap(y), min(x, y, 2*x))", {"x": X, "y": Y}),
        sp.Piecewise((X, X > 0), (Y, True)),
        sp.Matrix([[X, 1], [0, Y]]).as_immutable(),
        sp.Rational(1, 3) * X**2,
    ],
)
def test_an_expression_comes_back_as_it_is(expression):
    again = pickle.loads(pickle.dumps(picklable({"e": (expression, [expression])})))["e"]
    assert sp.srepr(again[0]) == sp.srepr(expression)
    assert again[0].free_symbols == expression.free_symbols
    assert again[1][0] is again[0] or again[1] == [expression]


def test_content_tells_arrays_of_other_shapes_and_kinds_apart():
    one = np.arange(4.0)
    assert content(one) == content(one.copy())
    assert content(one) != content(one.reshape(2, 2))
    assert content(one) != content(one.astype(np.float32))
    assert content({"a": [one], "b": {1, 2}}) == content({"b": {2, 1}, "a": [one]})
    assert content(float("nan")) == content(float("nan"))
    assert hash(FrozenDict(a=one)) == hash(FrozenDict(a=one))
