import control
import numpy as np
import sympy as sp

import holdfast as hf
from holdfast.interop.control import plant

theta, omega, tau = (hf.symbol(n) for n in ("theta", "omega", "tau"))
pendulum = hf.System(
    "pendulum",
    (hf.Quantity("theta", "rad"), hf.Quantity("omega", "rad/s")),
    (hf.Quantity("tau", "1/s^2"),),
    {"theta": omega, "omega": sp.sin(theta) + tau},
    input_bounds=hf.Box((-1,), (1,)),
)
gain, _, _ = control.lqr(
    plant(pendulum).linearize([0, 0], [0]), np.eye(2), np.eye(1)
)
law = hf.Law(
    "lqr",
    pendulum.states,
    {"tau": -gain[0, 0] * theta - gain[0, 1] * omega},
)
run = hf.simulate(
    pendulum, law, starts=[[0.6, 0.0]], horizon=10, continuous=True
)
angles = run.dataset["state"].values[0, :, 0]
print("gain:", gain.round(4), "angle at the end:", angles[-1].round(5))
