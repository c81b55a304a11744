"""Hamiltonians of a vehicle against a disturbance, of bounded and of sampled inputs."""
