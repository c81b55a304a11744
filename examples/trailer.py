# %% [markdown]
# # Reversing a trailer without a jack-knife
#
# *A car pushes a trailer backwards. At a hitch angle of 60 degrees the two touch: the rig has
# jack-knifed. From which hitch and steering angles is it too late to prevent that? Can my reversing
# controller be kept from it?*
#
# Hitch and steering angle change in the same way wherever the rig is. `hf.subsystem` has these two
# states alone, and its viability kernel holds for the whole rig.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import holdfast as hf

NODES = 81
CAR, TRAILER, LOCK, RATE, JACK_KNIFE = 2.7, 5.0, 0.6, 0.6, np.radians(60)  # m, m, rad, rad/s, rad

rig = hf.System(
    name="rig",
    states=(
        hf.Quantity("x", "m", "axle of the trailer"),
        hf.Quantity("y", "m", "axle of the trailer"),
        hf.Quantity("theta", "rad", "heading of the trailer", angle=True),
        hf.Quantity("phi", "rad", "hitch angle: heading of the car less that of the trailer"),
        hf.Quantity("delta", "rad", "steering angle"),
    ),
    inputs=(hf.Quantity("w", "rad/s", "steering rate"),),
    rates={
        "x": "speed*cos(phi)*cos(theta)",
        "y": "speed*cos(phi)*sin(theta)",
        "theta": "speed*sin(phi)/trailer",
        "phi": "speed*tan(delta)/car - speed*sin(phi)/trailer",
        "delta": "w",
    },
    parameters=(
        hf.Parameter("speed", "m/s", "astern", value=-1),
        hf.Parameter("car", "m", "wheelbase of the car", value=CAR),
        hf.Parameter("trailer", "m", "from the hitch to the axle", value=TRAILER),
    ),
    input_bounds=hf.Box((-RATE,), (RATE,)),
)
hitch = hf.subsystem(rig, ("phi", "delta"))
limits = hf.Region(
    "limits",
    hitch.states,
    (
        hf.Inequality("jack_knife", abs(hf.symbol("phi")) - JACK_KNIFE, "rad"),
        hf.Inequality("lock", abs(hf.symbol("delta")) - LOCK, "rad"),
    ),
)

# %% [markdown]
# ## The kernel
# With this tolerance it counts as converged, so that it holds for ever, once its edge has less than
# a tenth of a cell to move.

# %%
grid = hf.grid(hitch, {"phi": (-1.1, 1.1), "delta": (-0.65, 0.65)}, NODES)
kernel = hf.viability_kernel(hitch, limits, grid, horizon=60, tolerance=0.1)
print(f"converged: {kernel.report.converged}; {kernel.fraction():.1%} of the box of the grid")
assert kernel.report.converged

# %% [markdown]
# ## Against the exact solution
# At 60 degrees the hitch angle still falls if CAR sin(60) / TRAILER < tan(delta). The edge of the
# kernel is the way to the point of equality, steered as fast as possible: it is followed backwards.

# %%
turning = np.arctan(CAR * np.sin(JACK_KNIFE) / TRAILER)
way = solve_ivp(
    lambda t, q: [np.tan(q[1]) / CAR - np.sin(q[0]) / TRAILER, -RATE],
    (0, (turning + LOCK) / RATE),
    (JACK_KNIFE, turning),
    rtol=1e-9,
    dense_output=True,
)
edge_delta = np.linspace(-LOCK, turning, 100)[1:-1]
edge_phi = way.sol((turning - edge_delta) / RATE)[0]
half = grid.axes[0].step / 2
assert kernel.contains(np.stack([edge_phi - half, edge_delta], axis=1)).all()
assert not kernel.contains(np.stack([edge_phi + half, edge_delta], axis=1)).any()
print(f"the edge is exact to half a cell, {np.degrees(half):.2f} degrees")
print(f"steered the wrong way it is too late from {np.degrees(edge_phi[0]):.0f} degrees on")

# %% [markdown]
# ## My controller reverses to the line y = 0, with and without the filter
# The filter is told of two states and stands in the loop of the whole rig.


# %%
def my_controller(state):
    _, y, theta, phi, delta = state
    wanted_phi = np.clip(1.3 * (theta - np.clip(0.15 * y, -1.2, 1.2)), -1.2, 1.2)
    wanted_delta = np.arctan(CAR * (np.sin(phi) / TRAILER + 0.6 * (phi - wanted_phi)))
    return [3 * (np.clip(wanted_delta, -LOCK, LOCK) - delta)]


def reverse(safety=None):
    plant, path, decisions = hf.Plant(rig, [0, 8, 0, 0, 0], sample_time=0.05), [], []
    for _ in range(800):  # 40 s
        path.append(plant.state)
        command = my_controller(plant.state)
        if safety is not None:
            decisions.append(safety.step(plant.state[3:], command))
            command = decisions[-1].input
        plant.step(command)
    return np.array(path), decisions


alone, _ = reverse()
filtered, decisions = reverse(hf.SafetyFilter(hitch, kernel, around=rig, sample_time=0.05))
for name, path in (("alone", alone), ("filtered", filtered)):
    largest = np.degrees(np.abs(path[:, 3]).max())
    print(f"{name}: hitch angle of up to {largest:.1f} degrees, ends at y = {path[-1, 1]:.2f} m")
assert np.abs(alone[:, 3]).max() > JACK_KNIFE > np.abs(filtered[:, 3]).max()
assert {d.status for d in decisions} == {hf.Status.PASSED, hf.Status.CHANGED}
assert abs(filtered[-1, 1]) < 0.3

# %%
figure, (plan, plane) = plt.subplots(1, 2, figsize=(10, 4.2))
nodes = [np.degrees(axis.nodes) for axis in grid.axes]
plane.contourf(*nodes, kernel.values().T, levels=[0, 9], colors=["0.85"])
plane.plot(np.degrees(edge_phi), np.degrees(edge_delta), "k:", label="exact edge")
for name, path, style in (("alone", alone, "--"), ("filtered", filtered, "-")):
    plan.plot(path[:, 0], path[:, 1], style, label=name)
    plane.plot(np.degrees(path[:, 3]), np.degrees(path[:, 4]), style, label=name)
plan.set(xlabel="x [m]", ylabel="y [m]", title="axle of the trailer, from the right")
plane.set(xlabel="hitch angle [degrees]", ylabel="steering angle [degrees]", title="kernel (grey)")
plan.legend()
plane.legend(loc=(0.46, 0.1))
figure.tight_layout()
plt.show()
