"""Kernels of systems with more states than a grid has, put together from those of their parts."""
