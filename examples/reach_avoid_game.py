# %% [markdown]
# # A reach-avoid game: a boat and a guard
#
# *A rowing boat in a round lake wants to land. A guard runs along the shore, 5.5 times as fast as
# the boat. From where does the boat get ashore out of his reach, whatever he does?*
#
# This is the differential game of the lady in the lake. The boat's set is a capture basin (a
# reach-avoid set) in which the second player, the guard, is the disturbance. Its edge, the barrier
# of the game, is known exactly.

# %%
import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

NODES = {"r": 81, "theta": 120}
GUARD, ARMS = 5.5, 0.2  # the speed of the guard [rad/s], his reach to either side [rad]

game = hf.System(
    name="boat_and_guard",
    states=(
        hf.Quantity("r", "m", "boat, from the middle of the lake, which has a radius of 1 m"),
        hf.Quantity("theta", "rad", "boat, from the guard along the shore", angle=True),
    ),
    inputs=(
        hf.Quantity("out", "m/s", "boat, outwards"),
        hf.Quantity("along", "m/s", "boat, to the left"),
    ),
    disturbances=(hf.Quantity("run", "rad/s", "guard, to the left"),),
    rates={"r": "out", "theta": "along/r - run"},
    input_bounds=hf.Ball(1, 2),
    disturbance_bounds=hf.Box((-GUARD,), (GUARD,)),
)
r, theta = (state.symbol for state in game.states)
landed = hf.Region(
    "landed",
    game.states,
    (
        hf.Inequality("ashore", 1 - r, "m"),
        hf.Inequality("out_of_reach", ARMS - abs(theta), "rad"),
    ),
)
lake = hf.Region("lake", game.states[:1], (hf.Inequality("ends", abs(r - 0.6) - 0.46, "m"),))

# %% [markdown]
# ## The capture basin
# A boat that wins needs less than 1 s to the shore. Nearer to the middle than 0.14 m nothing is
# asked: there the angle to the guard changes without end.

# %%
grid = hf.grid(game, {"r": (0.1, 1.1), "theta": (-np.pi, np.pi)}, NODES, {"theta": "periodic"})
basin = hf.capture_basin(game, landed, lake, grid, horizon=1.5)
print(basin)

# %% [markdown]
# ## Against the exact barrier
# Best of all the boat leaves on a straight line that touches the circle of radius 1 / GUARD, in
# which it turns as fast as the guard. What is left of the angle when it lands decides the game.


# %%
def left_over(r, theta):
    """The angle between the landing place and what the guard reaches [rad]."""
    away = np.arccos(1 / GUARD) - np.arccos(1 / (GUARD * r))
    seconds = np.sqrt(1 - GUARD**-2) - np.sqrt(r**2 - GUARD**-2)
    return np.abs(theta) + away - GUARD * seconds - ARMS


nodes = np.meshgrid(*(axis.nodes for axis in grid.axes), indexing="ij")
between = (nodes[0] > 1 / GUARD) & (nodes[0] < 1)
exact = left_over(*(n[between] for n in nodes))
wins = basin.values()[between] > 0
cell = grid.axes[1].step
print(f"{(wins != (exact > 0)).sum()} of {exact.size} nodes are on the wrong side of the barrier,")
print(f"by {np.abs(exact[wins != (exact > 0)]).max():.3f} rad at most; a cell is {cell:.3f} rad")
assert exact[wins].min() > 0  # the boat is promised no more than is true
assert exact[~wins].max() < cell

# %% [markdown]
# ## In closed loop
# The boat's law is tried against guards that follow the value, run one way, turn round, and so on.

# %%
promise = hf.check_promise(game, basin, lake, goal=landed, runs=50)
print(promise.conclusion)
assert promise.held
assert promise.outside.kept.count == 0  # from outside of the basin no boat wins

# %% [markdown]
# ## Two games against a guard who always runs the shorter way to the boat
# One begins inside of the barrier, and one outside of it.

# %%
starts = {"inside": [0.6, 2.6], "outside": [0.6, 2.0]}
run = hf.simulate(
    game,
    hf.safety_law(game, basin, sample_time=0.005),
    starts=list(starts.values()),
    goal=landed,
    until_goal=True,
    horizon=0.6,
    sample_time=0.005,
    record_every=0.005,
    disturbance={"run": f"{GUARD}*sgn(theta)"},
)
paths = dict(zip(starts, run.dataset["state"].values, strict=True))
for name, path in paths.items():
    end = path[~np.isnan(path[:, 0])][-1]
    print(f"{name}: ends at r = {end[0]:.2f} m, {abs(end[1]):.2f} rad from the guard")
assert run.outcomes["reached goal"] == 1
won = paths["inside"][~np.isnan(paths["inside"][:, 0])][-1]
assert abs(abs(won[1]) - ARMS - left_over(*starts["inside"])) < 0.05  # what the barrier says

# %%
figure, (plane, plan) = plt.subplots(1, 2, figsize=(10, 4.6))
plane.contourf(*nodes, basin.values(), levels=[0, 9], colors=["0.85"])
edge = np.linspace(0.46, 1, 100)
for side in (-1, 1):
    barrier = side * -left_over(edge, 0.0)
    plane.plot(edge, barrier, "k:", label="exact barrier" if side > 0 else None)
plan.add_patch(plt.Circle((0, 0), 1, color="0.95"))
for (name, path), style in zip(paths.items(), ("-", "--"), strict=True):
    plane.plot(path[:, 0], path[:, 1], style, label=name)
    guard = -path[0, 1] + np.cumsum(np.r_[0, 0.005 * GUARD * np.sign(path[:-1, 1])])
    boat = path[:, 0] * np.exp(1j * (path[:, 1] + guard))
    (line,) = plan.plot(boat.real, boat.imag, style, label=f"boat, {name}")
    plan.plot(1.03 * np.cos(guard), 1.03 * np.sin(guard), style, color=line.get_color())
plane.set(xlabel="r [m]", ylabel="theta [rad]", title="capture basin (grey)", xlim=(0.1, 1.1))
plan.set(title="lake, the guards on its shore", aspect="equal")
plane.legend(loc="lower left")
plan.legend(loc="center")
figure.tight_layout()
plt.show()
