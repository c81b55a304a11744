"""How it runs: symbolic definitions to compiled functions to trajectories.

The only home of Numba; SymPy appears where text is made.
"""
