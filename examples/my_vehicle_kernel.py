# %% [markdown]
# # The viability kernel of my own vehicle
#
# *A crane trolley runs between two end stops. Its motor is late: the force follows the command with
# a lag. From which positions, speeds and forces can the trolley still be kept off the stops and
# below its top speed? Is my start one of them?*
#
# The answer is the viability kernel, a set of states, computed by Hamilton-Jacobi (HJ)
# reachability on a grid. Of this trolley it is also known exactly, so that the error is seen.

# %%
import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

NODES = 31  # along each state; the error falls with more

trolley = hf.System(
    name="trolley",
    states=(
        hf.Quantity("x", "m", "position"),
        hf.Quantity("v", "m/s", "speed"),
        hf.Quantity("f", "N", "force of the motor"),
    ),
    inputs=(hf.Quantity("u", "N", "commanded force"),),
    rates={"x": "v", "v": "f/mass", "f": "(u - f)/lag"},
    parameters=(
        hf.Parameter("mass", "kg", "loaded", value=500),
        hf.Parameter("lag", "s", "of the motor", value=0.6),
    ),
    input_bounds=hf.Box((-400,), (400,)),
)
x, v = hf.symbol("x"), hf.symbol("v")
track = hf.Region(
    "track",
    trolley.states,
    (
        hf.Inequality("left_stop", -5 - x, "m"),
        hf.Inequality("right_stop", x - 5, "m"),
        hf.Inequality("too_fast", abs(v) - 2, "m/s"),
    ),
)

# %% [markdown]
# ## The kernel
# The grid goes a little beyond the constraints. The force cannot leave its bounds by itself, so
# that its axis is "limited" there.

# %%
grid = hf.grid(
    trolley, {"x": (-5.5, 5.5), "v": (-2.4, 2.4), "f": (-400, 400)}, NODES, {"f": "limited"}
)
kernel = hf.viability_kernel(trolley, track, grid, horizon=20)
print(kernel)
print(f"converged: {kernel.report.converged}, {kernel.fraction():.1%} of the box of the grid")
assert kernel.report.converged  # so that it holds for ever

# %% [markdown]
# ## Is my start in it?

# %%
starts = {"slowly ahead": [4.0, 0.5, 0.0], "fast and pulling": [3.0, 1.5, 300.0]}
for name, start in starts.items():
    print(f"{name}: {'in the kernel' if kernel.contains([start])[0] else 'lost whatever it does'}")

# %% [markdown]
# ## Against the exact solution
# The trolley is kept exactly where full braking keeps it: u = -400 N before the right stop and the
# top speed ahead, u = 400 N before the others. Both motions are known in closed form.

# %%
FORCE, MASS, LAG = 400.0, 500.0, 0.6
TIMES = np.linspace(0, 6, 601)


def excess(x, v, f):
    """By how much the worst of both constraints ahead is passed under full braking, [m, m/s]."""
    worst = np.full(np.shape(x), -np.inf)
    for t in TIMES:
        fading = (f + FORCE) * (1 - np.exp(-t / LAG)) * LAG / MASS
        speed = v + fading - FORCE * t / MASS
        place = x + v * t - FORCE * t**2 / (2 * MASS) + (f + FORCE) * LAG * t / MASS - LAG * fading
        worst = np.maximum(worst, np.maximum(place - 5, speed - 2))
    return worst


nodes = np.meshgrid(*(axis.nodes for axis in grid.axes), indexing="ij")
exact = np.maximum(excess(*nodes), excess(*(-n for n in nodes)))
inside = kernel.values() > 0
wrong_in, wrong_out = inside & (exact > 0), ~inside & (exact < 0)
print(f"of {inside.size} nodes {wrong_in.sum()} are wrongly in, {wrong_out.sum()} wrongly out")
assert wrong_in.sum() == 0
assert wrong_out.mean() < 0.005
cell = grid.axes[0].step
print(f"the worst of them is {-exact[wrong_out].min():.3f} m or m/s inside; a cell is {cell:.2f} m")

# %% [markdown]
# ## The promise, tried in closed loop
# The kernel's own law runs from random states of the set, and from states outside it.

# %%
promise = hf.check_promise(trolley, kernel, track, runs=100)
print(promise.conclusion)
assert promise.confirmed
assert promise.outside.kept.count == 0  # no start outside the set is kept

# %% [markdown]
# ## A safety law over the kernel
# My own law drives to the far end as fast as it can and brakes too late. Over the kernel it is
# changed as little as possible. The file of the kernel can be used in the same way.

# %%
kernel.save("trolley.nc")
stored = hf.load("trolley.nc")
assert np.array_equal(stored.values(), kernel.values())
mine = hf.Law("to_the_end", trolley.states, {"u": "400*(4.9 - x) - 100*v"})
start = [[-4.0, 0.0, 0.0]]
runs = {
    name: hf.simulate(trolley, law, starts=start, region=track, horizon=15)
    for name, law in {"alone": mine, "kept": hf.safety_law(trolley, stored, mine)}.items()
}
for name, run in runs.items():
    print(f"{name}: {run.outcomes}")
assert (runs["alone"].viable, runs["kept"].viable) == (0, 1)

# %%
figure = hf.value_function_figure(kernel, plane=("x", "v"), at={"f": [-300, 0, 300]})
projection = figure.axes[3]  # the force changes along a path
for (name, run), style in zip(runs.items(), ("--", "-"), strict=True):
    states = run.dataset["state"].values[0]
    projection.plot(states[:, 0], states[:, 1], style, color="tab:red", label=name)
projection.legend(loc="lower right")
plt.show()
