# %% [markdown]
# # A safety filter around my controller
#
# *My robot has a PD controller that drives it to a goal. It cuts the corner at a pillar, and it
# stops too late in front of a wall. How do I keep it off both, and change its commands as little as
# possible?*
#
# Each obstacle is an inequality. From it follows a control barrier function of second order
# (HOCBF), which is a condition on the inputs. `hf.SafetyFilter` solves the quadratic program
# (CBF-QP) at every sample.

# %%
from collections import Counter

import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

robot = hf.System(
    name="robot",
    states=(
        hf.Quantity("x", "m"),
        hf.Quantity("y", "m"),
        hf.Quantity("psi", "rad", "heading", angle=True),
        hf.Quantity("v", "m/s", "speed"),
    ),
    inputs=(hf.Quantity("a", "m/s^2", "acceleration"), hf.Quantity("w", "rad/s", "turn rate")),
    rates={"x": "v*cos(psi)", "y": "v*sin(psi)", "psi": "w", "v": "a"},
    input_bounds=hf.Box((-2, -2), (2, 2)),
)
x, y = hf.symbol("x"), hf.symbol("y")
room = hf.Region(
    "room",
    robot.states[:2],
    (  # an inequality is met where its expression is at most 0
        hf.Inequality("wall", x - 5, "m"),
        hf.Inequality("pillar", 1 - ((x - 2.5) ** 2 + (y - 0.2) ** 2) ** 0.5, "m"),
    ),
)

# %% [markdown]
# ## My controller
# It knows nothing of the pillar. The goal is 0.2 m in front of the wall.

# %%
GOAL = np.array([4.8, 1.5])


def my_controller(state):
    x, y, psi, v = state
    to_goal = GOAL - (x, y)
    ahead = to_goal @ (np.cos(psi), np.sin(psi))
    bearing = np.arctan2(to_goal[1], to_goal[0]) - psi
    turn = np.arctan2(np.sin(bearing), np.cos(bearing)) if np.hypot(*to_goal) > 0.3 else 0.0
    return [1.2 * ahead - 1.2 * v, 1.5 * turn]


# %% [markdown]
# ## The same loop with and without the filter
# `hf.Plant` simulates the robot. Your own simulator, or the robot itself, may stand in its place.

# %%
START = [0.0, 0.0, 0.0, 0.0]


def drive(safety=None):
    plant, path, decisions = hf.Plant(robot, START), [START], []
    for _ in range(500):  # 10 s of samples of 0.02 s
        command = my_controller(plant.state)
        if safety is not None:
            decisions.append(safety.step(plant.state, command))
            command = decisions[-1].input
        path.append(plant.step(command))
    return np.array(path), decisions


def clearance(path):
    """The distance to the nearer obstacle at every sample, computed apart from the filter."""
    return np.minimum(5 - path[:, 0], np.hypot(path[:, 0] - 2.5, path[:, 1] - 0.2) - 1)


alone, _ = drive()
filtered, decisions = drive(hf.SafetyFilter(robot, room, gains=(2, 6)))
print(f"least clearance of my controller alone: {clearance(alone).min():6.3f} m")
print(f"least clearance with the filter:        {clearance(filtered).min():6.3f} m")
assert clearance(alone).min() < -0.5  # it drives through the pillar
assert clearance(filtered).min() > 0  # it touches nothing
assert np.hypot(*(filtered[-1, :2] - GOAL)) < 0.3  # and still arrives

# %% [markdown]
# ## What was changed, when, and why
# A `Decision` of status `INFEASIBLE` would say that no input meets all conditions. There is none.

# %%
print(Counter(decision.status.value for decision in decisions))
changed = [decision for decision in decisions if decision.overruled]
for decision in changed[:: len(changed) // 4]:
    print(f"{decision.t:.2f} s  {decision.why}")
assert {decision.status for decision in decisions} == {hf.Status.PASSED, hf.Status.CHANGED}

# %%
figure, (plan, inputs) = plt.subplots(2, 1, figsize=(6.4, 7), height_ratios=(3, 2))
plan.add_patch(plt.Circle((2.5, 0.2), 1, color="0.7"))
plan.axvspan(5, 5.3, color="0.7")
plan.plot(alone[:, 0], alone[:, 1], "--", color="tab:red", label="my controller alone")
plan.plot(filtered[:, 0], filtered[:, 1], color="tab:blue", label="with the filter")
plan.plot(*GOAL, "k*", markersize=10, label="goal")
plan.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.3, 5.3), ylim=(-1, 2.5), aspect="equal")
plan.legend(loc="upper left")
time = [decision.t for decision in decisions]
inputs.plot(time, [d.nominal[1] for d in decisions], "--", color="tab:red", label="my command")
inputs.plot(time, [d.input[1] for d in decisions], color="tab:blue", label="applied")
inputs.set(xlabel="time [s]", ylabel="turn rate [rad/s]")
inputs.legend()
figure.tight_layout()
plt.show()
