"""Scenario files of kernels that are known in closed form; the kinds of the shipped ones."""

from functools import cache

from holdfast.scenario.files import read_tables, scenario_names


@cache
def kinds_of_scenarios():
    """Shipped scenario -> its kind, by what its file says: none is composed."""
    headers = {name: read_tables(name)[2]["scenario"] for name in scenario_names()}
    return {name: header.get("kind", "closed-loop") for name, header in headers.items()}


def scenarios_of(*kinds):
    """The shipped scenarios of these kinds."""
    return [name for name, kind in kinds_of_scenarios().items() if kind in kinds]


PLANT = """
[system]
name = "cart"
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { a = { unit = "m/s^2", bounds = [-1, 1] } }
disturbances = { d = { unit = "m/s^2", bounds = [-0.5, 0.5] } }
rates = { x = "v", v = "a + d" }
[region]
constraints = { left = { expression = "-1 - x", unit = "m" }, right = { expression = "x - 1", unit = "m" } }
"""
CART = f"""
[scenario]
title = "cart between walls"
kind = "discriminating-kernel"
{PLANT}[grid]
nodes = 61
box = {{ x = ["-130 cm", 1.3], v = [-1.8, 1.8] }}
[march]
horizon = 10
forever = true
[promise]
runs = 200
horizon = 10
"""
LINE = """
[scenario]
title = "An unstable line"
kind = "discriminating-kernel"

[system]
states = { x = { unit = "m" } }
inputs = { u = { unit = "m/s", bounds = [-0.6, 0.6] } }
disturbances = { d = { unit = "m/s", bounds = ["-push", "push"] } }
parameters = { push = { value = 0.4, unit = "m/s" } }
empirical = "numbers"
rates = { x = "x + u + d" }

[region]
constraints = { end = { expression = "abs(x) - 1", unit = "m" } }

[grid]
nodes = 101
box = { x = [-1.2, 1.2] }

[march]
horizon = 60
forever = true
band = 0.2
"""

EXTERNAL = """
[scenario]
title = "My controller in front of a target"
[system]
name = "marine_vehicle"
[law]
external = true
[region]
name = "camera_view"
[safeguard]
gains = [1.5, 8]
[starts]
states = [{ x = -1.3, y = 0.75, psi = -0.35 }]
random = 2
box = { x = [-2, -0.6], y = [-0.8, 0.8], psi = [-0.8, 0.8] }
[run]
horizon = 4
record_every = 0.02
tolerance = 1e-3
"""
"""The scenario of a controller that is a program."""
DRIFTING = """
[scenario]
title = "A cart that drifts"

[system]
states = { x = { unit = "m" }, v = { unit = "m/s" } }
inputs = { a = { unit = "m/s^2", bounds = [-1, 1] } }
disturbances = { w = { unit = "m/s" } }
rates = { x = "v + w", v = "a" }

[law]
outputs = { a = "-k*x - c*v" }
parameters = { k = { value = 1.0, unit = "1/s^2" }, c = { value = 2.0, unit = "1/s" } }

[region]
constraints = { right = { expression = "x - wall", unit = "m" } }
parameters = { wall = { value = 2.0, unit = "m" } }

[goal]
empirical = "a norm of numbers"
constraints = { near = "hypot(x, v) - size" }
parameters = { size = 0.25 }

[starts]
states = [{ x = 1 }, { x = -1 }]
random = 30
box = { x = [-2, 2], v = [-1, 1] }

[varied.draws]
push = { range = [0.0, 0.3], unit = "m/s" }

[disturbance]
w = "push"

[noise.normal]
x = 0.01

[reference]
x = 0

[run]
horizon = 10
sample_time = 0.05
seed = 7
"""
