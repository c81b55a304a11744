"""A pushed cart between two walls, whose kernel is known: V = 1 - max(|x|, |x + v |v| / 2w|)."""

import holdfast as hf

X, V, U, D = (hf.symbol(n) for n in ("x", "v", "u", "d"))
STATES = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
WALLS = hf.Region("walls", STATES[:1], (
    hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m"),
))  # fmt: skip
BOX = {"x": (-1.3, 1.3), "v": (-1.8, 1.8)}


def cart(push=0.5):
    return hf.System(
        "cart", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V, "v": U + D},
        disturbances=(hf.Quantity("d", "m/s^2"),),
        input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-push,), (push,)),
    )  # fmt: skip


def swinging():
    return hf.Law("swing", STATES, {"u": hf.parse_expression("0.9*sin(t)", {"t": hf.TIME})})
