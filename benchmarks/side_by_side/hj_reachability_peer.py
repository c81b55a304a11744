import hj_reachability as hj
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)


class DubinsCar(hj.ControlAndDisturbanceAffineDynamics):
    def __init__(self, control_mode):
        turn, none = jnp.array([1.0]), jnp.array([0.0])
        super().__init__(
            control_mode,
            "max",
            hj.sets.Box(-turn, turn),
            hj.sets.Box(none, none),
        )

    def open_loop_dynamics(self, state, time):
        return jnp.array([jnp.cos(state[2]), jnp.sin(state[2]), 0.0])

    def control_jacobian(self, state, time):
        return jnp.array([[0.0], [0.0], [1.0]])

    def disturbance_jacobian(self, state, time):
        return jnp.zeros((3, 1))


high = np.array([3.0, 3.0, np.pi])
grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(
    hj.sets.Box(-high, high), (41, 41, 40), periodic_dims=2
)
# negative inside
disc = jnp.linalg.norm(grid.states[..., :2], axis=-1) - 1.0
tube = hj.SolverSettings.with_accuracy(
    "very_high",
    hamiltonian_postprocessor=hj.solver.backwards_reachable_tube,
)
avoid = hj.step(tube, DubinsCar("max"), grid, 0.0, disc, -2.0)
reach = hj.step(tube, DubinsCar("min"), grid, 0.0, disc, -2.0)
print("cannot avoid it:", (avoid <= 0).sum())
print("can reach it:", (reach < 0).sum())
