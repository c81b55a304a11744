from dataclasses import replace

import numpy as np
import sympy as sp

import holdfast as hf

x, v, a, d = (hf.symbol(name) for name in ("x", "v", "a", "d"))
cart = hf.System(
    "cart",
    states=(hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
    inputs=(hf.Quantity("a", "m/s^2"),),
    rates={"x": v, "v": a},
    input_bounds=hf.Box((-1,), (1,)),
)
gusty = replace(
    cart,
    disturbances=(hf.Quantity("d", "m/s^2"),),
    rates={"x": v, "v": a + d},
    disturbance_bounds=hf.Box((-0.2,), (0.2,)),
)
end = hf.Inequality("end", abs(x) - 1, "m")
fast = hf.Inequality("fast", abs(v) - 0.5, "m/s")
track = hf.Region("track", cart.states[:1], (end,))
slow = hf.Region("slow", cart.states[1:], (fast,))
gains = hf.Parameter("k", "1/s^2", value=1.0), hf.Parameter("c", "1/s", value=2.0)
brake = hf.Law("brake", cart.states, {"a": "-k*x - c*v"}, parameters=gains)
nodes = hf.grid(cart, {"x": (-1.2, 1.2), "v": (-1.6, 1.6)}, 33)
kernel = hf.viability_kernel(cart, track, nodes, 4.0)
starts = [[0.5, 0.0], [0.9, 0.9]]
box = {"x": (-1, 1), "v": (-0.5, 0.5)}
cells = {"box": box, "cells": 15, "sample_time": 0.2, "inputs": 3}
certificate = hf.certify(cart, hf.both(track, slow), **cells)
result = hf.simulate(cart, brake, starts=starts, region=track, horizon=8.0)
robot = hf.systems.unicycle()
