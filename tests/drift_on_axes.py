"""A system of any dimension whose Hamiltonian is known, and kinds of the ends of axes."""

import holdfast as hf

C = (0.7, -0.4, 0.9, -0.2)
KINDS = ("extrapolated", "periodic", "limited")


def hamiltonian(n):
    """q_i' = c_i q_j + u_i, j the axis before: H = sum of c_i q_j p_i + |p_i|."""
    states = tuple(hf.Quantity(f"q{i}", "m") for i in range(n))
    inputs = tuple(hf.Quantity(f"u{i}", "m/s") for i in range(n))
    rates = {q.name: C[i] * states[i - 1].symbol + u.symbol
             for i, (q, u) in enumerate(zip(states, inputs, strict=True))}  # fmt: skip
    return hf.hamiltonian(
        hf.System("drift", states, inputs, rates, input_bounds=hf.Box((-1,) * n, (1,) * n))
    )
