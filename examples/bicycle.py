# %% [markdown]
# # Lane keeping with a kinematic bicycle
#
# *A car drives at 8 m/s in a lane that is 3.5 m wide. Its steering angle is limited to 9.6 degrees,
# and the road bends either way with a radius of 60 m or more. From which offsets and headings can
# the car still stay in its lane? Does my lane-keeping controller stay in it?*
#
# The vehicle is the kinematic bicycle model. Its input is the tangent of the steering angle, so
# that the rates are affine in it. The bend is a disturbance that nobody announces: the set of these
# states is the discriminating kernel.

# %%
import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

NODES = 101
SPEED, WHEELBASE, LOCK, BEND = 8.0, 2.7, np.tan(np.radians(9.6)), 1 / 60  # m/s, m, 1, 1/m
ROOM = (3.5 - 1.8) / 2  # m, on either side of a car that is 1.8 m wide

car = hf.System(
    name="bicycle",
    states=(
        hf.Quantity("y", "m", "offset from the middle of the lane"),
        hf.Quantity("psi", "rad", "heading beside that of the lane"),
    ),
    inputs=(hf.Quantity("s", "1", "tangent of the steering angle"),),
    disturbances=(hf.Quantity("kappa", "1/m", "curvature of the road"),),
    rates={"y": "speed*sin(psi)", "psi": "speed*s/wheelbase - speed*cos(psi)*kappa"},
    parameters=(
        hf.Parameter("speed", "m/s", value=SPEED),
        hf.Parameter("wheelbase", "m", value=WHEELBASE),
    ),
    input_bounds=hf.Box((-LOCK,), (LOCK,)),
    disturbance_bounds=hf.Box((-BEND,), (BEND,)),
)
lane = hf.Region("lane", car.states, (hf.Inequality("lane", abs(hf.symbol("y")) - ROOM, "m"),))

# %% [markdown]
# ## The kernel
# Against every bend within the bounds, for ever.

# %%
grid = hf.grid(car, {"y": (-1, 1), "psi": (-0.6, 0.6)}, NODES, {"psi": "extrapolated"})
kernel = hf.discriminating_kernel(car, lane, grid, horizon=20)
headings = np.degrees(kernel.extent()["psi"])
print(f"converged: {kernel.report.converged}; headings of up to {headings[1]:.1f} degrees")
assert kernel.report.converged

# %% [markdown]
# ## Against the exact solution
# The best that the driver can do is full lock away from the edge, and the worst is the sharpest
# bend towards it. With psi' = -V (k - b cos psi), k of the lock and b of the bend, the car goes
# log((k - b cos psi) / (k - b)) / b further to the side before it is along the lane.


# %%
def furthest(y, psi):
    k, psi = LOCK / WHEELBASE, np.maximum(psi, 0)
    return y + np.log((k - BEND * np.cos(psi)) / (k - BEND)) / BEND


y, psi = np.meshgrid(*(axis.nodes for axis in grid.axes), indexing="ij")
exact = np.maximum(furthest(y, psi), furthest(-y, -psi)) < ROOM
inside = kernel.values() > 0
print(f"{inside.sum()} nodes are in the kernel, {exact.sum()} exactly")
assert not (inside & ~exact).any()  # no node is promised that cannot be kept
assert (exact & ~inside).sum() < 0.01 * exact.sum()

# %% [markdown]
# ## My controller, alone and with a safety filter
# From the same random starts in the kernel, on a road that winds.

# %%
drawn = np.random.default_rng(0).uniform((-0.85, -0.4), (0.85, 0.4), (600, 2))
starts = drawn[kernel.contains(drawn, margin=0.02)]
mine = hf.Law("lane_keeping", car.states, {"s": "-0.1*y - 0.3*psi"})
runs = {
    name: hf.simulate(
        car, law, starts=starts, region=lane, horizon=20, disturbance={"kappa": "cos(t/2)/60"}
    )
    for name, law in {"alone": mine, "filtered": hf.safety_law(car, kernel, mine)}.items()
}
for name, run in runs.items():
    print(f"{name}: {run.viable} of {len(starts)} stay in the lane")
assert runs["filtered"].viable == len(starts) > runs["alone"].viable

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True)
for axis, (name, run) in zip(axes, runs.items(), strict=True):
    axis.contourf(y, np.degrees(psi), kernel.values(), levels=[0, 9], colors=["0.85"])
    for path in run.dataset["state"].values[:40]:
        axis.plot(path[:, 0], np.degrees(path[:, 1]), color="tab:blue", linewidth=0.5)
    axis.set(xlabel="offset y [m]", title=f"{name}: {run.viable} of {len(starts)} stay")
    axis.set(xlim=(-1.2, 1.2), ylim=(-25, 25))
    for edge in (-ROOM, ROOM):
        axis.axvline(edge, color="k", linestyle=":")
axes[0].set_ylabel("heading psi [degrees]")
figure.suptitle("Discriminating kernel (grey), edges of the lane (dotted), 40 paths")
figure.tight_layout()
plt.show()
