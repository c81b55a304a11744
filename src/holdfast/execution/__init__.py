"""Execution: from symbolic definitions to compiled functions and trajectories.

The only home of Numba; SymPy appears where text is made.
"""
