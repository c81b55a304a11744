"""A camera and a cart that tests certify, and the files of certificates with other content."""

import hashlib
import json
import math
import zlib

import sympy as sp

import holdfast as hf
from holdfast.maths.expressions.functions import least

AHEAD, LEFT, U, R, WA, WB = (hf.symbol(n) for n in ("ahead", "left", "u", "r", "wa", "wb"))
X, Y, PSI, V, A, W = (hf.symbol(n) for n in ("x", "y", "psi", "v", "a", "w"))
BOX = {"ahead": (0.3, 2.1), "left": (-1.2, 1.2)}


def camera(current=0.1):
    """A target ahead and to the left of a vehicle that steers by u and r."""
    return hf.System(
        "camera",
        (hf.Quantity("ahead", "m"), hf.Quantity("left", "m")),
        (hf.Quantity("u", "m/s"), hf.Quantity("r", "rad/s")),
        {"ahead": -U + R * LEFT - WA, "left": -R * AHEAD - WB},
        disturbances=(hf.Quantity("wa", "m/s"), hf.Quantity("wb", "m/s")),
        disturbance_bounds=hf.Box((-current, -current - 0.05), (current, current + 0.05)),
        input_bounds=hf.Box((-0.5, -0.8), (0.5, 0.8)),
    )


def view(system):
    edge = sp.tan(sp.pi / 6) * AHEAD
    limits = {"near": 0.35 - AHEAD, "far": AHEAD - 2, "edge_l": LEFT - edge, "edge_r": -LEFT - edge}
    rows = tuple(hf.Inequality(n, e, "m") for n, e in limits.items())
    return hf.Region("view", system.states, rows)


def cart():
    pushed = hf.System(
        "cart", (hf.Quantity("x", "m"), hf.Quantity("v", "m/s")), (hf.Quantity("a", "m/s^2"),),
        {"x": V, "v": A - hf.symbol("drag") * V + W}, disturbances=(hf.Quantity("w", "m/s^2"),),
        parameters=(hf.Parameter("drag", "1/s", value=0.2),),
        disturbance_bounds=hf.Box((-0.2,), (0.2,)), input_bounds=hf.Box((-1.0,), (1.0,)),
    )  # fmt: skip
    walls = (hf.Inequality("left", -1 - X, "m"), hf.Inequality("right", X - 1, "m"))
    return pushed, hf.Region("walls", pushed.states, walls)


CART = {"x": (-1, 1), "v": (-2, 2)}


def rows(name, system, limits):
    """The region of these limits."""
    found = tuple(hf.Inequality(f"c{k}", e, "m") for k, e in enumerate(limits))
    return hf.Region(name, system.states, found)


def vehicle():
    """A unicycle in a room of 3 m x 2 m, a block between it and its goal, in a current."""
    system = hf.System(
        "vehicle", (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad")),
        (hf.Quantity("u", "m/s"), hf.Quantity("r", "rad/s")),
        {"x": U * sp.cos(PSI) + W, "y": U * sp.sin(PSI), "psi": R},
        disturbances=(hf.Quantity("w", "m/s"),), disturbance_bounds=hf.Box((-0.05,), (0.05,)),
        input_bounds=hf.Box((-1.0, -1.5), (1.0, 1.5)),
    )  # fmt: skip
    block = least(least(X - 1.0, 1.4 - X), 1.1 - Y)
    room = rows("room", system, (-X, X - 3, -Y, Y - 2, block))
    return system, room, rows("goal", system, (2.2 - X, Y - 0.8))


def to_goal():
    """The certificate of the vehicle: to its goal from most of the room."""
    system, room, goal = vehicle()
    box = {"x": (0, 3), "y": (0, 2), "psi": (-math.pi, math.pi)}
    cells = {"x": 30, "y": 20, "psi": 30}
    return hf.certify(system, room, target=goal, box=box, cells=cells, sample_time=0.25, inputs=5)


def changed(path, alter, *, entries=None):
    """The file with another header or other entries, and its digest right again."""
    words, _, rest = path.read_bytes().partition(b"\n")
    kind = words.split(b" ")[0].decode()
    text, _, packed = rest.partition(b"\n")
    header = json.loads(text)
    alter(header)
    if entries is not None:
        packed = zlib.compress(entries(zlib.decompress(packed)))
        size = 1 if kind == "holdfast-flowpipe" else 10
        header["entries"] = len(zlib.decompress(packed)) // size
    content = json.dumps(header).encode() + b"\n" + packed
    first = f"{kind} 1 {hashlib.sha256(content).hexdigest()}\n".encode()
    other = path.with_name("changed.certificate")
    other.write_bytes(first + content)
    return other
