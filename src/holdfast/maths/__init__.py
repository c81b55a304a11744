"""Symbolic mathematics of systems, laws, regions and reference fields. No arrays."""
