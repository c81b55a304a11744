"""Hamiltonians of a differential game, vehicle against disturbance: closed-form or sampled."""
