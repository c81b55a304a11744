"""Execution: from symbolic definitions to compiled functions and trajectories.

The only home of llvmlite; SymPy appears where text is made.
"""
