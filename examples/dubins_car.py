# %% [markdown]
# # The avoid set of a Dubins car
#
# *A Dubins car drives at 1 m/s and turns at 1 rad/s at most. It must not hit a pillar with a radius
# of 0.5 m. From which states is a collision unavoidable?*
#
# These states are the avoid set, a backward reachable tube (BRT) under the best control against it.
# It is what the viability kernel of the free plane leaves out. For this car it is known in closed
# form, so that the error of the grid is stated in cells.

# %%
import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

NODES = {"x": 51, "y": 51, "psi": 40}
PILLAR = 0.5  # m

car = hf.System(
    name="dubins_car",
    states=(
        hf.Quantity("x", "m"),
        hf.Quantity("y", "m"),
        hf.Quantity("psi", "rad", "heading", angle=True),
    ),
    inputs=(hf.Quantity("w", "rad/s", "turn rate"),),
    rates={"x": "speed*cos(psi)", "y": "speed*sin(psi)", "psi": "w"},
    parameters=(hf.Parameter("speed", "m/s", value=1),),
    input_bounds=hf.Box((-1,), (1,)),
)
x, y = hf.symbol("x"), hf.symbol("y")
pillar = hf.Inequality("pillar", PILLAR - (x**2 + y**2) ** 0.5, "m")
free = hf.Region("free", car.states[:2], (pillar,))

# %% [markdown]
# ## The avoid set
# The free plane has no end, so that values beyond the grid are extrapolated.

# %%
grid = hf.grid(
    car,
    {"x": (-2, 2), "y": (-2, 2), "psi": (-np.pi, np.pi)},
    NODES,
    {"x": "extrapolated", "y": "extrapolated", "psi": "periodic"},
)
kernel = hf.viability_kernel(car, free, grid, horizon=5)
avoid = kernel.values() <= 0
print(kernel)
print(f"converged: {kernel.report.converged}; {avoid.sum()} nodes are in the avoid set")
assert kernel.report.converged  # the set does not grow with a longer horizon

# %% [markdown]
# ## Against the exact solution
# The car sees the pillar `ahead` and to the `left`. Turning as hard as it can, it goes round a
# circle with a radius of 1 m about (0, 1) or (0, -1). It is lost where both turns hit the pillar
# before it is abeam: within 1 m + 0.5 m of both centres.


# %%
def lost(x, y, psi, radius):
    ahead = -x * np.cos(psi) - y * np.sin(psi)
    left = x * np.sin(psi) - y * np.cos(psi)
    both_turns_hit = (ahead > 0) & (np.hypot(ahead, np.abs(left) + 1) <= 1 + radius)
    return both_turns_hit | (np.hypot(ahead, left) <= radius)


nodes = np.meshgrid(*(axis.nodes for axis in grid.axes), indexing="ij")
exact = lost(*nodes, PILLAR)
cell = grid.axes[0].step
off = (avoid & ~lost(*nodes, PILLAR + cell / 4)) | (lost(*nodes, PILLAR - cell / 4) & ~avoid)
print(f"{(avoid != exact).sum()} of {avoid.size} nodes are on the wrong side")
print(f"{off.sum()} of them are further off than a quarter of a cell of {cell:.3f} m")
assert (avoid != exact).sum() < 0.001 * avoid.size
assert not off.any()

# %% [markdown]
# ## In closed loop
# My law drives straight ahead. A safety filter over the kernel changes that as little as possible,
# from 300 random states each. Who leaves the grid has passed the pillar.

# %%
states = np.random.default_rng(1).uniform((-1.8, -1.8, -np.pi), (1.8, 1.8, np.pi), (20_000, 3))
in_free = np.hypot(states[:, 0], states[:, 1]) > PILLAR
doomed = states[lost(*states.T, PILLAR - cell) & in_free][:300]
avoidable = states[~lost(*states.T, PILLAR + cell)][:300]
law = hf.safety_law(car, kernel, hf.Law("straight_ahead", car.states, {"w": 0}))
for name, starts, hit in (
    ("in the avoid set", doomed, 300),
    ("a cell outside of it", avoidable, 0),
):
    run = hf.simulate(car, law, starts=starts, region=free, horizon=6)
    print(f"{name}: {run.outcomes['left region']} of {len(starts)} hit the pillar")
    assert run.outcomes["left region"] == hit

# %%
figure, axis = plt.subplots(figsize=(5, 5))
fine = np.meshgrid(np.linspace(-2, 2, 400), np.linspace(-2, 2, 400), indexing="ij")
axis.contourf(*fine, lost(*fine, 0.0, PILLAR), levels=[0.5, 1.5], colors=["0.8"])
east = kernel.slice(psi=0.0)
axis.contour(*(a.nodes for a in east.grid.axes), east.values().T, levels=[0], colors="tab:blue")
axis.add_patch(plt.Circle((0, 0), PILLAR, color="0.4"))
axis.plot([], [], color="tab:blue", label="avoid set on the grid")
axis.plot([], [], color="0.8", linewidth=8, label="avoid set, exact")
axis.plot([], [], color="0.4", linewidth=8, label="pillar")
axis.annotate("", (-1.4, -1.1), (-1.9, -1.1), arrowprops={"arrowstyle": "->"})
axis.text(-1.9, -1.3, "heading of the car")
axis.set(xlabel="x [m]", ylabel="y [m]", xlim=(-2, 1), ylim=(-1.5, 1.5))
axis.set_title("Avoid set (BRT) of cars that head east")
axis.legend()
figure.tight_layout()
plt.show()
