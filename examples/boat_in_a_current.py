# %% [markdown]
# # A boat enters a harbour in a current
#
# *A boat is underactuated: it cannot stop and cannot move sideways. It has to pass between two
# piers, and a current of up to 0.3 m/s pushes it in a direction that nobody knows. From where does
# it come in for sure, and how long does it take at worst?*
#
# These states are a capture basin (a reach-avoid set): the harbour is reached, and the piers are
# avoided until then, whatever the current does.

# %%
import matplotlib.pyplot as plt
import numpy as np
import sympy as sp

import holdfast as hf

NODES = {"x": 41, "y": 31, "psi": 24}
FAST, CURRENT, HARBOUR = 1.5, 0.3, 11.0  # m/s, m/s, m

boat = hf.System(
    name="boat",
    states=(
        hf.Quantity("x", "m"),
        hf.Quantity("y", "m"),
        hf.Quantity("psi", "rad", "heading", angle=True),
    ),
    inputs=(
        hf.Quantity("u", "m/s", "speed through the water"),
        hf.Quantity("r", "rad/s", "turn rate"),
    ),
    disturbances=(hf.Quantity("cx", "m/s", "current"), hf.Quantity("cy", "m/s", "current")),
    rates={"x": "u*cos(psi) + cx", "y": "u*sin(psi) + cy", "psi": "r"},
    input_bounds=hf.Box((0.5, -0.4), (FAST, 0.4)),
    disturbance_bounds=hf.Ball(CURRENT, 2),  # of any direction
)
x, y = hf.symbol("x"), hf.symbol("y")
harbour = hf.Region("harbour", boat.states[:2], (hf.Inequality("inside", HARBOUR - x, "m"),))
water = hf.Region(
    "water",
    boat.states[:2],
    (
        hf.Inequality("piers", sp.Min(x - 8, abs(y) - 3), "m"),  # land beyond x = 8, but for 6 m
        hf.Inequality("shore", abs(y) - 7, "m"),
        hf.Inequality("sea", -3 - x, "m"),
        hf.Inequality("quay", x - 12.2, "m"),
    ),
)

# %% [markdown]
# ## The capture basin, with the least time of arrival against the worst current

# %%
box = {"x": (-3.5, 12.5), "y": (-7.5, 7.5), "psi": (-np.pi, np.pi)}
grid = hf.grid(boat, box, NODES, {"psi": "periodic"})
basin = hf.capture_basin(boat, harbour, water, grid, horizon=40)
print(basin)
for name, start in {"straight ahead": (0, 0, 0), "athwart": (6, 0, np.pi / 2)}.items():
    seconds = basin.least_time([start])[0]
    print(f"{name}: {'lost for some current' if np.isnan(seconds) else f'in {seconds:.1f} s'}")

# %% [markdown]
# ## Against the exact solution
# Ahead of the entrance nothing is worse than a current that comes from the harbour: the boat then
# arrives after the distance over FAST - CURRENT.

# %%
places = np.arange(0.0, 10.0, 0.5)
ahead = np.stack([places, 0 * places, 0 * places], axis=1)
exact = (HARBOUR - places) / (FAST - CURRENT)
late = basin.least_time(ahead) - exact
cell = grid.axes[0].step / (FAST - CURRENT)
print(f"late by {late.max():.2f} s at most; a cell of {grid.axes[0].step:.1f} m takes {cell:.2f} s")
assert (np.abs(late) < cell / 2).all()

# %% [markdown]
# ## In closed loop, against currents that try to prevent it
# The law of the basin is tried from random starts, against constant, switching and swinging
# currents, and against those that follow the slope of the value.

# %%
promise = hf.check_promise(boat, basin, water, goal=harbour, runs=30)
print(promise.conclusion)
assert promise.held
assert promise.outside.kept.count == 0  # from outside of the basin no boat comes in

# %%
headings = np.radians([-90, 0, 90])
figure = hf.value_function_figure(basin, plane=("x", "y"), at={"psi": headings})
for axis in figure.axes[:3]:
    for side in (-1, 1):
        axis.fill_between([8, 12.5], 3 * side, 7.5 * side, color="0.7")
plt.show()
