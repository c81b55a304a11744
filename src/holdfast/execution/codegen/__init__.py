"""Code generation: expressions as source text, Python for Numba, C99 for a vehicle."""
