"""Coverage-guided fuzzing of what strangers write: expressions, conditions, scenario files.

    python -m pip install atheris
    python -m tests.fuzz expressions -max_total_time=600
    python -m tests.fuzz files -max_total_time=600

Whatever the input, the answer is an object or a `HoldfastError`, within the seconds of -timeout.
What was found is kept as a test in `test_hostile_input.py`. Not collected by pytest.
"""

import sys
import warnings

import atheris

with atheris.instrument_imports(include=["holdfast"]):
    import copy
    import tomllib

    import holdfast as hf
    from holdfast.errors import GainWarning, HoldfastError
    from holdfast.execution.steppers import BY_NAME
    from holdfast.execution.translate import closed_loop_program
    from holdfast.maths.expression import parse_condition, parse_expression
    from holdfast.scenario import Scenario, scenario_of
    from holdfast.sources import overridden, read_text

warnings.simplefilter("ignore", GainWarning)

NAMES = {n: hf.symbol(n) for n in ("x", "y", "psi", "k1", "t")}
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


def expressions(data):
    """Text made of words that mean something here, and of others."""
    provider = atheris.FuzzedDataProvider(data)
    condition = provider.ConsumeBool()
    parts = []
    while provider.remaining_bytes() and len(parts) < 200:
        place = provider.ConsumeIntInRange(0, len(WORDS) + 3)
        parts.append(WORDS[place] if place < len(WORDS) else provider.ConsumeUnicode(3))
    try:
        found = (parse_condition if condition else parse_expression)("".join(parts), NAMES)
    except HoldfastError:
        return
    assert found.free_symbols <= set(NAMES.values())


def _paths(table, prefix=()):
    pairs = table.items() if isinstance(table, dict) else enumerate(table)
    for name, value in list(pairs):
        yield (*prefix, name)
        if isinstance(value, dict | list):
            yield from _paths(value, (*prefix, name))


def files(data):
    """A scenario with keys and values changed, taken away, put elsewhere; or any text at all."""
    provider = atheris.FuzzedDataProvider(data)
    base = provider.PickValueInList([UNICYCLE, CART, KERNEL, ""])
    if not base:
        try:
            tables = tomllib.loads(provider.ConsumeUnicode(4000))
        except (ValueError, RecursionError):
            return
    else:
        tables = tomllib.loads(base)
    for _ in range(provider.ConsumeIntInRange(1, 4)):
        paths = list(_paths(tables))
        if not paths:
            break
        *way, last = provider.PickValueInList(paths)
        place = tables
        for part in way:
            place = place[part]
        kind = provider.ConsumeIntInRange(0, 4)
        if kind == 0:
            del place[last]
        elif kind == 1 and isinstance(place, dict):
            place[provider.ConsumeUnicode(8)] = place.pop(last)
        elif kind == 2:
            place[last] = provider.ConsumeUnicode(12)
        elif kind == 3:
            place[last] = provider.ConsumeFloat()
        else:
            value = copy.deepcopy(provider.PickValueInList(VALUES))
            if isinstance(place, dict) and provider.ConsumeBool():
                place[
                    provider.PickValueInList(
                        ["x", "y", "name", "unit", "value", "law", "a", "goal"]
                    )
                ] = value
            else:
                place[last] = value
    try:
        changes = [provider.ConsumeUnicode(20)] if provider.ConsumeProbability() > 0.9 else []
        text, tables = overridden("", tables, changes)
        found = scenario_of("fuzz.toml", text, tables)
        if isinstance(found, Scenario):
            closed_loop_program(
                found.system, found.law, region=found.region, goal=found.goal,
                disturbance=found.disturbance, varied=found.varied,
                stepper=BY_NAME.get(found.settings["stepper"], BY_NAME["rk4"]),
            )  # fmt: skip
    except HoldfastError:
        return


def texts(data):
    """Bytes as a file."""
    provider = atheris.FuzzedDataProvider(data)
    name = provider.PickValueInList(["inspection", "ch4-chained-3", "ch2-unicycle", "ch6-corridor"])
    text = read_text(name)[1]
    at, end = sorted(provider.ConsumeIntInRange(0, len(text)) for _ in range(2))
    text = text[:at] + provider.ConsumeUnicode(60) + text[min(end, at + 200) :]
    try:
        tables = tomllib.loads(text)
        scenario_of("fuzz.toml", text, tables)
    except (HoldfastError, tomllib.TOMLDecodeError):
        return


if __name__ == "__main__":
    TARGETS = {f.__name__: f for f in (expressions, files, texts)}
    target = TARGETS[sys.argv.pop(1)]
    atheris.Setup(sys.argv, target)
    atheris.Fuzz()
