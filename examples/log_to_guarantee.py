# %% [markdown]
# # From a log to a guarantee
#
# *I have a log of my cart: its position, its speed, and the force that I commanded. What are its
# mass and its drag, and what does the model leave unexplained? From where can the cart then be kept
# between two walls, whatever that is?*
#
# The log is made here, so that the true numbers are known: a cart on a floor that is not level,
# with noise. A second log judges what is taken from the first.

# %%
import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

NODES = 81
TRUE = {"mass": 22.0, "drag": 6.0}  # the first guess below is 15 kg and 10 N s/m


def floor(x):
    """The acceleration by the slope of the floor [m/s^2], which no model of the cart has."""
    return 0.12 * np.sin(2 * x)


def cart(mass, drag):
    return hf.System(
        name="cart",
        states=(hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
        inputs=(hf.Quantity("u", "N", "force"),),
        rates={"x": "v", "v": "(u - drag*v)/mass"},
        parameters=(
            hf.Parameter("mass", "kg", value=mass),
            hf.Parameter("drag", "N s/m", value=drag),
        ),
        input_bounds=hf.Box((-20,), (20,)),
    )


# %% [markdown]
# ## The logs
# Two files of comma-separated values (CSV), 100 s at 20 Hz each. Only the first lines of this cell
# know the truth; a log of your own takes their place.


# %%
def write_log(name, seed):
    random = np.random.default_rng(seed)
    true_cart = hf.add_unmodelled(cart(**TRUE), ("v",), hf.Box((-1,), (1,)))
    plant, rows = hf.Plant(true_cart, [0, 0], sample_time=0.05), []
    for k in range(2000):
        if k % 20 == 0:
            push = np.clip(random.uniform(-20, 20) - 2 * plant.state[0], -20, 20)
        rows.append([plant.t, *(plant.state + random.normal(0, (0.005, 0.01))), push])
        plant.step([push], [floor(plant.state[0])])
    np.savetxt(name, rows, delimiter=",", header="t,x,v,u", comments="")


def read_log(name):
    t, x, v, u = np.loadtxt(name, delimiter=",", skiprows=1).T
    states = {"x": hf.Signal(t, x), "v": hf.Signal(t, v)}
    return hf.Log(name, states, {"u": hf.Signal(t, u)}, gap=0.5)


for seed, name in enumerate(("first.csv", "second.csv")):
    write_log(name, seed)
first, second = read_log("first.csv"), read_log("second.csv")

# %% [markdown]
# ## The numbers, with intervals, and what they leave out

# %%
guess = cart(mass=15, drag=10)
identified = hf.identify(guess, first, held_out=second)
for e in identified.parameters:
    print(f"{e.name}: {e.value:.2f} {e.unit}, between {e.low:.2f} and {e.high:.2f} ({e.status})")
    assert e.low < TRUE[e.name] < e.high
(low,), (high,) = identified.unexplained.low, identified.unexplained.high
print(f"left unexplained: {low:.3f} to {high:.3f} m/s^2")
for remark in identified.remarks:
    print("remark:", remark)
assert identified.held_out.covered  # the second log needs no more

# %% [markdown]
# ## The guarantee
# What is left unexplained becomes a disturbance within these bounds, and the discriminating kernel
# counts the worst of it.

# %%
model = hf.add_unmodelled(identified.system, ("v",), hf.Box((low,), (high,)))
x = hf.symbol("x")
walls = hf.Region("walls", model.states[:1], (hf.Inequality("walls", abs(x) - 2, "m"),))
grid = hf.grid(model, {"x": (-2.2, 2.2), "v": (-2.5, 2.5)}, NODES, {"v": "extrapolated"})
kernel = hf.discriminating_kernel(model, walls, grid, horizon=20)
print(f"converged: {kernel.report.converged}; {kernel.fraction():.1%} of the box of the grid")
assert kernel.report.converged

# %% [markdown]
# ## Judged by the truth
# The kernel of the true cart on its floor is larger, and has every state that is promised. A law
# that pushes to and fro leaves the walls. With a safety filter that knows the identified model
# alone the true cart stays between them, from every start in the kernel.

# %%
true_cart = cart(**TRUE)
sloping = {"x": "v", "v": "(u - drag*v)/mass + 0.12*sin(2*x)"}
on_its_floor = dataclasses.replace(true_cart, rates=sloping)
true_kernel = hf.viability_kernel(on_its_floor, walls, grid, horizon=20)
promised, possible = kernel.values() > 0, true_kernel.values() > 0
print(f"{promised.sum()} nodes are promised, {possible.sum()} are possible")
assert not (promised & ~possible).any()

mine = hf.Law("to_and_fro", model.states, {"u": "20*sin(t)"})
drawn = np.random.default_rng(7).uniform((-2, -2), (2, 2), (300, 2))
starts = drawn[kernel.contains(drawn, margin=0.05)]
runs = {
    name: hf.simulate(
        model,
        law,
        starts=starts,
        region=walls,
        horizon=20,
        plant=TRUE,  # what moves; the law has the identified numbers
        disturbance={"unmodelled_v": "0.12*sin(2*x)"},
    )
    for name, law in {"alone": mine, "filtered": hf.safety_law(model, kernel, mine)}.items()
}
for name, run in runs.items():
    print(f"{name}: {run.viable} of {len(starts)} stay between the walls")
assert runs["alone"].viable < len(starts) == runs["filtered"].viable

# %%
figure, (fit, plane) = plt.subplots(1, 2, figsize=(10, 4.2))
needed = identified.unexplained
fit.plot(needed.start, needed.value[:, 0], "o", markersize=3, label="first log")
judged = identified.held_out.needed
fit.plot(judged.start, judged.value[:, 0], "x", markersize=4, label="second log")
fit.axhspan(low, high, color="0.9", label="bound")
fit.set(xlabel="start of the window [s]", ylabel="left unexplained of v' [m/s^2]")
fit.legend(loc="upper right")
for value, colour, name in ((true_kernel, "k", "true"), (kernel, "tab:blue", "promised")):
    plane.contour(*(a.nodes for a in grid.axes), value.values().T, levels=[0], colors=[colour])
    plane.plot([], [], color=colour, label=f"kernel, {name}")
for path in runs["filtered"].dataset["state"].values[:10]:
    plane.plot(path[:, 0], path[:, 1], color="tab:orange", linewidth=0.5)
plane.plot([], [], color="tab:orange", label="true cart, filtered")
plane.set(xlabel="x [m]", ylabel="v [m/s]")
plane.legend(loc="upper right")
figure.tight_layout()
plt.show()
