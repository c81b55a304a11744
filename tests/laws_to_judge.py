"""A line with a current, a camera whose view is a rectangle, and laws that tests judge there."""

import sympy as sp

import holdfast as hf

X, V, W = (hf.symbol(n) for n in ("x", "v", "w"))
AHEAD, BEARING, U, R, WA, WB = (hf.symbol(n) for n in ("ahead", "bearing", "u", "r", "wa", "wb"))


def slider(limit=1.0, current=0.3):
    """x' = v + w on a line from -1 to 1, v at most `limit`, w up to `current` m/s."""
    system = hf.System(
        "slider", (hf.Quantity("x"),), (hf.Quantity("v"),), {"x": V + W},
        disturbances=(hf.Quantity("w"),),
        disturbance_bounds=hf.Box((-current,), (current,)),
        input_bounds=hf.Box((-limit,), (limit,)),
    )  # fmt: skip
    ends = (hf.Inequality("left", -1 - X), hf.Inequality("right", X - 1))
    return system, hf.Region("line", system.states, ends)


def thermostat(on=0.5, off=-0.5, speed=0.6):
    """Moves left until `off`, then right until `on`, at a constant speed."""
    states = slider()[0].states
    modes = {
        "left": hf.Law("left", states, {"v": sp.Float(-speed)}),
        "right": hf.Law("right", states, {"v": sp.Float(speed)}),
    }
    turns = (hf.Transition("left", "right", off - X), hf.Transition("right", "left", X - on))
    return hf.Switching("thermostat", modes, turns)


def camera(current=0.05):
    """A target at a bearing, some way ahead of a vehicle that steers by u and r."""
    across = sp.sin(BEARING) * sp.cos(BEARING) * (U + WA) - sp.cos(BEARING) ** 2 * WB
    return hf.System(
        "camera",
        (hf.Quantity("ahead", "m"), hf.Quantity("bearing", "rad")),
        (hf.Quantity("u", "m/s"), hf.Quantity("r", "rad/s")),
        {"ahead": -U + R * AHEAD * sp.tan(BEARING) - WA, "bearing": -R + across / AHEAD},
        disturbances=(hf.Quantity("wa", "m/s"), hf.Quantity("wb", "m/s")),
        disturbance_bounds=hf.Box((-current, -current - 0.05), (current, current + 0.05)),
        input_bounds=hf.Box((-0.5, -0.8), (0.5, 0.8)),
    )


VIEW = {"ahead": (0.35, 2.0), "bearing": (-0.5235, 0.5235)}


def view(system):
    rows = {
        "near": (0.35 - AHEAD, "m"), "far": (AHEAD - 2, "m"),
        "edge_l": (BEARING - sp.pi / 6, "rad"), "edge_r": (-BEARING - sp.pi / 6, "rad"),
    }  # fmt: skip
    given = tuple(hf.Inequality(n, e, unit) for n, (e, unit) in rows.items())
    return hf.Region("view", system.states, given)


def guarded(system, law):
    """A law with the safeguard that is certified: against any current within its bounds."""
    margins = {"near": 0.05, "far": 0.05, "edge_l": 0.1, "edge_r": 0.1}
    return hf.safeguard(
        system, law, view(system), worst=("wa", "wb"), gains=(2.0, 4.0), margins=margins
    )


def forward(system):
    """Drives on whatever it sees: without a safeguard it loses the target."""
    return hf.Law("forward", system.states, {"u": sp.Float(0.3), "r": 0.8 * BEARING})


def boat():
    """A boat that moves in any direction, in a round berth, with a current across."""
    x, y, u, v, a, b = (hf.symbol(n) for n in ("x", "y", "u", "v", "a", "b"))
    system = hf.System(
        "boat",
        (hf.Quantity("x", "m"), hf.Quantity("y", "m")),
        (hf.Quantity("u", "m/s"), hf.Quantity("v", "m/s")),
        {"x": u + a, "y": v + b},
        disturbances=(hf.Quantity("a", "m/s"), hf.Quantity("b", "m/s")),
        disturbance_bounds=hf.Box((-0.1, -0.1), (0.1, 0.1)),
        input_bounds=hf.Box((-0.5, -0.5), (0.5, 0.5)),
    )
    rim = (hf.Inequality("rim", (x**2 + y**2 - 1) / 2, "m^2"),)
    return system, hf.Region("berth", system.states, rim)
