"""Systems and regions that fall into parts."""

import holdfast as hf
from holdfast.maths.definitions.extension import lagged

Q = hf.Quantity


def symbols(text):
    return [hf.symbol(n) for n in text.split()]


def plane(bounds=None, push=0.3):
    """Two double integrators, pushed by one disturbance."""
    vx, vy, ux, uy, d = symbols("vx vy ux uy d")
    felt = d if push else 0
    return hf.System(
        "plane",
        (Q("x", "m"), Q("vx", "m/s"), Q("y", "m"), Q("vy", "m/s")),
        (Q("ux", "m/s^2"), Q("uy", "m/s^2")),
        {"x": vx, "vx": ux + felt, "y": vy, "vy": uy - felt},
        disturbances=(Q("d", "m/s^2"),) if push else (),
        input_bounds=bounds or hf.Box((-1, -1), (1, 1)),
        disturbance_bounds=hf.Box((-push,), (push,)) if push else None,
    )


def walls(*names, at=1.0):
    """|name| <= at for each of the names."""
    rows = []
    for n in names:
        s = hf.symbol(n)
        rows += [hf.Inequality(f"{n}_low", -at - s), hf.Inequality(f"{n}_high", s - at)]
    return hf.Region("walls", tuple(Q(n) for n in names), tuple(rows))


def box(*names, at=1.2, speed=2.0):
    return {n: (-speed, speed) if n.startswith("v") else (-at, at) for n in names}


def cart():
    v, u = symbols("v u")
    return hf.System(
        "cart",
        (Q("x", "m"), Q("v", "m/s")),
        (Q("u", "m/s^2"),),
        {"x": v, "v": u},
        input_bounds=hf.Box((-1,), (1,)),
    )


def late_cart(lag=0.2):
    """A cart whose force follows its command with a lag: three states."""
    return lagged(cart(), {"u": lag})


def pair():
    """Two carts on one line."""
    v1, v2, u1, u2 = symbols("v1 v2 u1 u2")
    return hf.System(
        "pair",
        (Q("x1"), Q("v1"), Q("x2"), Q("v2")),
        (Q("u1"), Q("u2")),
        {"x1": v1, "v1": u1, "x2": v2, "v2": u2},
        input_bounds=hf.Box((-1, -1), (1, 1)),
    )


def towed(pull=0.3):
    """A cart that a winch pulls: x' = v, v' = u + pull w, w' = c - w."""
    v, w, u, c = symbols("v w u c")
    return hf.System(
        "towed",
        (Q("x"), Q("v"), Q("w")),
        (Q("u"), Q("c")),
        {"x": v, "v": u + pull * w, "w": c - w},
        input_bounds=hf.Box((-1, -0.9), (1, 0.9)),
    )
