import jax
import jax.numpy as jnp
import numpy as np
from cbfpy import CBF, CBFConfig

jax.config.update("jax_enable_x64", True)


class AroundTheDisc(CBFConfig):
    def __init__(self):
        super().__init__(
            4, 2, u_min=[-2.0, -2.0], u_max=[2.0, 2.0], solver_tol=1e-9
        )

    def f(self, z):
        return jnp.array([z[2], z[3], 0.0, 0.0])

    def g(self, z):
        return jnp.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])

    def h_2(self, z):  # relative degree two; positive where it is safe
        return jnp.array([jnp.hypot(z[0], z[1]) - 1.0])

    def alpha(self, h):
        return 2.0 * h

    def alpha_2(self, h):
        return 3.0 * h


keep = jax.jit(CBF.from_config(AroundTheDisc()).safety_filter)
step, state, path = 0.02, np.array([-3.0, 0.3, 0.0, 0.0]), []
for _ in range(500):
    command = np.array([3.0, 0.0]) - state[:2] - 1.5 * state[2:]
    push = np.asarray(keep(state, command))
    state[:2] += state[2:] * step + push * step**2 / 2
    state[2:] += push * step
    path.append(state.copy())
path = np.array(path)
print("nearest:", np.hypot(path[:, 0], path[:, 1]).min().round(4))
print("at the end:", path[-1].round(3))
