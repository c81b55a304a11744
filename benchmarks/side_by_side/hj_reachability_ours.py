import math

import sympy as sp

import holdfast as hf

x, y, psi, w = (hf.symbol(n) for n in ("x", "y", "psi", "w"))
car = hf.System(
    "Dubins car",
    (
        hf.Quantity("x", "m"),
        hf.Quantity("y", "m"),
        hf.Quantity("psi", "rad", angle=True),
    ),
    (hf.Quantity("w", "rad/s"),),
    {"x": sp.cos(psi), "y": sp.sin(psi), "psi": w},
    input_bounds=hf.Box((-1,), (1,)),
)
away = 1 - sp.sqrt(x**2 + y**2)
outside = hf.Region(
    "outside", car.states[:2], (hf.Inequality("away", away, "m"),)
)
inside = hf.Region(
    "inside", car.states[:2], (hf.Inequality("within", -away, "m"),)
)

box = {"x": (-3, 3), "y": (-3, 3), "psi": (-math.pi, math.pi)}
ends = {"x": "extrapolated", "y": "extrapolated", "psi": "periodic"}
grid = hf.grid(car, box, {"x": 41, "y": 41, "psi": 40}, ends)
avoid = hf.viability_kernel(car, outside, grid, horizon=2).values()
reach = hf.backward_reachable_tube(car, inside, grid, horizon=2).values()
print("cannot avoid it:", (avoid <= 0).sum())
print("can reach it:", (reach > 0).sum())
