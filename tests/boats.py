"""A boat that is pushed ahead, and a vehicle on the plane, with logs of their motion by SciPy."""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

import holdfast as hf

X, U, F = (hf.symbol(n) for n in ("x", "u", "F"))
NOISE = {"x": 0.01, "u": 0.01, "y": 0.01, "psi": 0.005, "v": 0.01, "r": 0.005}


def boat(mass=20.0, drag=8.0, quadratic=30.0, *, added=None, metre=1.0):
    """mass u' = F - drag u - quadratic |u| u; metre: how many units of length there are in one."""
    parameters = [
        hf.Parameter("mass", "kg", value=mass, above=0.0),
        hf.Parameter("drag", "N s/m", value=drag),
        hf.Parameter("quadratic", "N s^2/m^2", value=quadratic / metre),
    ]
    whole = hf.symbol("mass")
    if added is not None:
        parameters.insert(1, hf.Parameter("added", "kg", value=added))
        whole = whole + hf.symbol("added")
    resisting = hf.symbol("drag") * U + hf.symbol("quadratic") * abs(U) * U
    return hf.System(
        "boat",
        (hf.Quantity("x", "m"), hf.Quantity("u", "m/s")),
        (hf.Quantity("F", "N"),),
        {"x": U, "u": (F - resisting) / whole},
        parameters=tuple(parameters),
        input_bounds=hf.Box((-40.0 * metre,), (40.0 * metre,)),
    )


def pushes(seconds, most, seed, *, every=(1.0, 6.0), step=0.1):
    """Random forces that are held for random times."""
    random = np.random.default_rng(seed)
    found = np.empty(round(seconds / step))
    k = 0
    while k < len(found):
        last = k + max(round(random.uniform(*every) / step), 1)
        found[k:last] = random.uniform(-most, most)
        k = last
    return found


def boat_log(
    true=None, *, seconds=120.0, seed=0, noise=1.0, unknown=None, forces=None, metre=1.0, step=0.1
):
    """A log of x and u at 10 Hz, of the boat or of one with another mass and drag.

    unknown: an acceleration that no model knows, a function of time.
    """
    mass, drag, quadratic = true or (20.0, 8.0, 30.0)
    forces = pushes(seconds, 35.0, seed) if forces is None else forces
    random = np.random.default_rng(seed + 1000)
    states = np.zeros((len(forces) + 1, 2))

    def rate(t, q, force):
        push = 0.0 if unknown is None else unknown(t)
        resisting = drag * q[1] + quadratic * abs(q[1]) * q[1]
        return [q[1], (force - resisting) / mass + push]

    changes = [0, *(np.flatnonzero(np.diff(forces)) + 1), len(forces)]
    for first, last in itertools.pairwise(changes):
        moved = solve_ivp(
            rate, (first * step, last * step), states[first], args=(forces[first],), rtol=1e-8,
            atol=1e-10, t_eval=step * np.arange(first, last + 1).clip(first, last), max_step=1.0,
        )  # fmt: skip
        states[first : last + 1] = moved.y.T
    time = step * np.arange(len(states))
    states += noise * np.array([NOISE["x"], NOISE["u"]]) * random.standard_normal(states.shape)
    signals = {n: hf.Signal(time, metre * states[:, k]) for k, n in enumerate(("x", "u"))}
    return hf.Log(f"boat {seed}", signals, {"F": hf.Signal(time[:-1], metre * forces)}, gap=0.5)


def vehicle_log(system, *, seconds=100.0, seed=0, noise=1.0, current=(0.0, 0.0), measured=None):
    """A log of a vehicle on the plane, by the steps of `hf.Plant`, its inputs chosen at random."""
    random = np.random.default_rng(seed + 1000)
    ranges = [
        [float(e.subs({p.symbol: p.value for p in system.parameters})) for e in pair]
        for pair in system.input_bounds.ranges()
    ]
    most = [0.6 * min(abs(low), abs(high)) for low, high in ranges]
    inputs = np.stack([pushes(seconds, m, seed + 10 * k) for k, m in enumerate(most)], axis=1)
    plant = hf.Plant(system, [0.0] * len(system.states), sample_time=0.1, substeps=10)
    states = [plant.state]
    for row in inputs:
        states.append(plant.step(row, list(current)))
    states, time = np.array(states), 0.1 * np.arange(len(states))
    signals = {}
    for k, name in enumerate(system.state_names):
        wrong = noise * NOISE[name] * random.standard_normal(len(time))
        if measured is None or name in measured:
            signals[name] = hf.Signal(time, states[:, k] + wrong)
    commands = {
        n: hf.Signal(time[:-1], inputs[:, k].copy()) for k, n in enumerate(system.input_names)
    }
    return hf.Log(f"{system.name} {seed}", signals, commands, gap=0.5)
