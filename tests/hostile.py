"""What strangers write: words of expressions, scenario files, and changes to them.

For hypothesis (`test_hostile_input.py`) and for the coverage-guided fuzzer (`fuzz.py`).
"""

import tomllib

from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.simulation.settings import BY_NAME
from holdfast.scenario.files import overridden
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.scenario.load import scenario_of

WORDS = [
    "x", "y", "psi", "k1", "t", "pi", "0", "1", "2.5", "1e300", "1e-300", "-", "+", "*", "/", "**", "(", ")", ",",
    "<", "<=", ">", ">=", "==", " and ", " or ", "not ", "sin(", "cos(", "tan(", "asin(", "acos(", "atan2(", "sqrt(",
    "exp(", "log(", "abs(", "hypot(", "min(", "max(", "sgn(", "wrap(", "select(", "diff(", "sign(", "tanh(", "[", "]",
    "lambda:", ".", "x.__class__", "'", "if", "else", "for", "\n", "#", "\\", "é", "9" * 40,
]  # fmt: skip

UNICYCLE = """
[scenario]
title = "one"
[system]
name = "unicycle"
[law]
name = "steer_unicycle"
[region]
constraints = { far = "hypot(x, y) - 3" }
[goal]
constraints = { near = { expression = "hypot(x, y) - 0.1", unit = "m" } }
[starts]
random = 3
box = { x = [-1, 1], y = [-1, 1], psi = ["-180 deg", "180 deg"] }
states = [{ x = 1.0 }]
[run]
horizon = 1
sample_time = 0.1
[noise.uniform]
x = 0.01
[figures]
plane = ["x", "y"]
"""
CART = """
[scenario]
title = "two"
[system]
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { a = { unit = "m/s^2", bounds = [-1, 1] } }
disturbances = { w = { unit = "m/s", bounds = ["-push", "push"] } }
parameters = { push = { value = 0.3, unit = "m/s" } }
rates = { x = "v + w", v = "a" }
[law]
empirical = "numbers"
parameters = { k = 1.0 }
signals = { s = "x + v" }
initial = "far"
modes = { far = { outputs = { a = "-k*x - v" } }, near = { outputs = { a = "-v" }, definitions = { z = "2*x" } } }
transitions = [{ from = "far", to = "near", when = "abs(x) < 0.1 and time_in_mode > 1" }]
[region]
constraints = { right = "x - 2" }
scene = [{ kind = "circle", role = "goals", centre = [0, 0], radius = "push" }]
[safeguard]
gains = [1.0, 4.0]
[varied.draws]
draw = { range = [0.0, 0.3], unit = "m/s" }
[disturbance]
w = "draw*cos(t)"
[starts]
random = 3
box = { x = [-1, 1] }
[run]
horizon = 1
sample_time = 0.1
"""
KERNEL = """
[scenario]
title = "three"
kind = "viability-kernel"
[system]
states = { x = { unit = "m" } }
inputs = { u = { unit = "m/s", bounds = [-0.6, 0.6] } }
empirical = "numbers"
rates = { x = "x + u" }
[region]
constraints = { end = { expression = "abs(x) - 1", unit = "m" } }
[grid]
nodes = 21
box = { x = [-1.2, 1.2] }
[march]
horizon = 1
[promise]
runs = 10
"""
VALUES = [
    None, True, 0, -1, 1, 2, 10**30, -0.0, 1e308, 1e-308, float("nan"), float("inf"), "", "x", "1e999", "30 deg", "1 m",
    "nan", "x + y", "sin(x", [], [0], [1, 2], [[]], {}, {"x": 1}, {"value": 1, "unit": "m"}, {"expression": "x"},
    [{"x": 1}], "a" * 3000, "time_in_mode", "t", "../x.toml", "steer_marine", ["x"], [1, 2, 3], "2 m/s", "__import__",
]  # fmt: skip

KEYS = ["x", "y", "name", "unit", "value", "law", "a", "goal"]


def paths(table, prefix=()):
    """The keys of tables in tables, places in lists among them."""
    pairs = table.items() if isinstance(table, dict) else enumerate(table)
    for name, value in list(pairs):
        yield (*prefix, name)
        if isinstance(value, dict | list):
            yield from paths(value, (*prefix, name))


def inside(tables, way):
    """The table, or the list, at the end of the way."""
    for part in way:
        tables = tables[part]
    return tables


def base(place):
    """One of the files, as tables that may be changed."""
    return tomllib.loads((UNICYCLE, CART, KERNEL)[place])


def go_through(tables):
    """From tables to the program of their closed loop, as far as they let it."""
    found = scenario_of("odd.toml", *overridden("", tables, []))
    if isinstance(found, Scenario):
        closed_loop_program(
            found.system, found.law, region=found.region, goal=found.goal,
            disturbance=found.disturbance, varied=found.varied,
            stepper=BY_NAME.get(found.settings["stepper"], BY_NAME["rk4"]),
        )  # fmt: skip
