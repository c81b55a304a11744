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
limits = {
    "pillar": 1 - sp.sqrt(x**2 + y**2),
    "walls_x": abs(x) - 2.8,
    "walls_y": abs(y) - 2.8,
}
room = hf.Region(
    "room",
    car.states[:2],
    tuple(hf.Inequality(n, e, "m") for n, e in limits.items()),
)
there = hf.Inequality("there", sp.sqrt((x - 2) ** 2 + y**2) - 0.5, "m")
goal = hf.Region("goal", car.states[:2], (there,))
grid = hf.grid(
    car,
    {"x": (-3, 3), "y": (-3, 3), "psi": (-math.pi, math.pi)},
    {"x": 41, "y": 41, "psi": 40},
    {"psi": "periodic"},
)
basin = hf.capture_basin(car, goal, room, grid, horizon=8)
starts = [[-2.0, 0.4, 0.0], [-2.5, 0.6, 0.0], [-1.5, 0.0, 0.0]]
least = basin.least_time(starts)
print("least times:", least.round(3))
