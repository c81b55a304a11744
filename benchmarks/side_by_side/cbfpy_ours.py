import numpy as np
import sympy as sp

import holdfast as hf

x, y, vx, vy, ax, ay = (
    hf.symbol(n) for n in ("x", "y", "vx", "vy", "ax", "ay")
)
puck = hf.System(
    "puck",
    (
        *(hf.Quantity(n, "m") for n in ("x", "y")),
        *(hf.Quantity(n, "m/s") for n in ("vx", "vy")),
    ),
    (hf.Quantity("ax", "m/s^2"), hf.Quantity("ay", "m/s^2")),
    {"x": vx, "y": vy, "vx": ax, "vy": ay},
    input_bounds=hf.Box((-2, -2), (2, 2)),
)
# at most 0 where it is safe
disc = hf.Inequality("disc", 1 - sp.sqrt(x**2 + y**2), "m")
away = hf.Region("away", puck.states[:2], (disc,))
keep = hf.SafetyFilter(puck, away, gains=(2, 3))

plant, path = hf.Plant(puck, [-3, 0.3, 0, 0]), []
for _ in range(500):
    command = np.array([3.0, 0.0]) - plant.state[:2] - 1.5 * plant.state[2:]
    plant.step(keep.step(plant.state, command).input)
    path.append(plant.state)
path = np.array(path)
print("nearest:", np.hypot(path[:, 0], path[:, 1]).min().round(4))
print("at the end:", path[-1].round(3))
