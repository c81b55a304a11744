"""Definitions as plain data: the same ones when they are read, and nothing but what was written."""

import json

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, ExpressionError, HoldfastError
from holdfast.maths.catalogue.signature import example
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.written import read, written
from holdfast.maths.expressions.written import Steps, expressions


def again(what, kind):
    """What was written and read by way of a text."""
    return read(json.loads(json.dumps(written(what))), kind)


@pytest.mark.parametrize("function", hf.systems.ALL, ids=lambda f: f.__name__)
def test_every_system_is_read_as_it_was_written(function):
    system = example(function)
    found = again(system, System)
    assert found == system
    assert written(found) == written(system)


@pytest.mark.parametrize("function", hf.regions.ALL, ids=lambda f: f.__name__)
def test_every_region_is_read_as_it_was_written(function):
    region = example(function)
    found = again(region, Region)
    assert found == region
    assert written(found) == written(region)


def test_a_part_that_stands_twice_is_written_once():
    e = hf.symbol("x")
    for _ in range(10):
        e = sp.sin(e) + e**2
    steps = Steps()
    number = steps.number(e)
    assert len(steps.rows) < 40
    assert expressions(steps.rows)[number] == e


@pytest.mark.parametrize(
    "number",
    [sp.Float(0.1), sp.Float(-5e-324), sp.Float("0.1", 40), sp.Float(0), sp.Rational(-1, 3),
     sp.Integer(10**30), sp.pi, sp.E, sp.sqrt(2)],
)  # fmt: skip
def test_numbers_keep_every_digit(number):
    steps = Steps()
    at = steps.number(number)
    found = expressions(json.loads(json.dumps(steps.rows)))[at]
    assert sp.srepr(found) == sp.srepr(number)


@pytest.mark.parametrize(
    "e",
    [sp.Piecewise((1, sp.Symbol("x", real=True) > 0), (2, True)), sp.Symbol("x"), sp.oo, sp.I,
     sp.Function("f")(sp.Symbol("x", real=True)), sp.floor(sp.Symbol("x", real=True))],
)  # fmt: skip
def test_what_no_step_has_is_refused(e):
    with pytest.raises(ExpressionError, match="cannot be written"):
        Steps().number(e)


LONG = str(10**1400)


@pytest.mark.parametrize(
    "rows",
    [
        [["Add", 0]], [["symbol", "x"], ["Add", 0, 1]], [["symbol", "x"], ["Add", -1]],
        [["symbol", "x"], ["Add", 0.0]], [["symbol", "x"], ["Add", True]], [["system", "x"]],
        [["symbol", "x"], ["__import__", 0]], [["integer", 3]], [["integer", LONG]], [["Add"]],
        [["float", "1", 10**9, 53]], [["float", "1", 0, 10**9]], [["rational", "1", "0"]],
        [["integer", "9"], ["integer", "65"], ["Pow", 0, 1]],
        [["integer", "9"], *(["Pow", k, k] for k in range(4))],
        [["integer", "7"], ["integer", "64"], *(["Pow", k, 1] for k in (0, 2, 3, 4))],
        [["symbol", "x"], *(["Add", k, k, 0] for k in range(40)), *(["sin", 40] for _ in "ab")],
        [[["x"]]], [[]], ["x"], [None],
    ],
)  # fmt: skip
def test_steps_that_nobody_wrote_are_refused(rows):
    data = {"steps": [*rows, ["integer", "1"]], "what": {"step": 0}}
    with pytest.raises((DefinitionError, ExpressionError)):
        read(data, sp.Symbol)


def test_an_expression_that_grows_with_every_step_is_refused():
    doubled = [["symbol", "x"], ["sin", 0]]
    for k in range(1, 60):
        doubled += [["cos", 2 * k - 1], ["Mul", 2 * k - 1, 2 * k]]
    with pytest.raises(ExpressionError, match="too large"):
        expressions(doubled)


BOX = {"is": "Box", "lower": [-1], "upper": [1]}


@pytest.mark.parametrize(
    ("what", "kind"),
    [
        ({**BOX, "is": "Path"}, hf.Box), ({**BOX, "more": 1}, hf.Box), (BOX, hf.Ball),
        ({"is": "Box", "lower": [-1]}, hf.Box), ({**BOX, "upper": [-3]}, hf.Box),
        ({**BOX, "upper": ["1"]}, hf.Box), ({**BOX, "upper": 1}, hf.Box), ([], hf.Box),
        ({"is": "Ball", "radius": 1, "dimension": True}, hf.Ball),
        ({"is": "Quantity", "name": 3, "unit": "m", "description": "", "angle": False},
         hf.Quantity),
        ({"is": "Quantity", "name": "x", "unit": "m", "description": "", "angle": 0}, hf.Quantity),
        ({"is": "Inequality", "name": "x", "expression": {"step": 5}, "unit": "m",
          "description": "", "scale": None}, hf.Inequality),
        (None, hf.Box), ("Box", hf.Box),
    ],
)  # fmt: skip
def test_records_that_nobody_wrote_are_refused(what, kind):
    assert read({"what": BOX, "steps": []}, hf.Box) == hf.Box((-1,), (1,))
    with pytest.raises(HoldfastError):
        read({"what": what, "steps": []}, kind)
