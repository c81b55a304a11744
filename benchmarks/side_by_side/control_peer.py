import control
import numpy as np

pendulum = control.nlsys(
    lambda t, x, u, params: [x[1], np.sin(x[0]) + u[0]],
    None,
    states=["theta", "omega"],
    inputs=["tau"],
    outputs=["theta", "omega"],
    name="pendulum",
)
linear = control.linearize(pendulum, [0, 0], [0])
gain, _, _ = control.lqr(linear, np.eye(2), np.eye(1))
law = control.nlsys(
    None,
    lambda t, x, u, params: np.clip(-gain @ u, -1, 1),
    inputs=["theta", "omega"],
    outputs=["tau"],
    name="law",
)
loop = control.interconnect(
    [pendulum, law], inputs=[], outputs=["theta", "omega"]
)
times = np.linspace(0, 10, 101)
precise = {"rtol": 1e-9, "atol": 1e-9}
run = control.input_output_response(
    loop, times, 0, [0.6, 0.0], solve_ivp_kwargs=precise
)
angles = run.outputs[0]
print("gain:", gain.round(4), "angle at the end:", angles[-1].round(5))
