"""Scenario files: read, checked, composed to systems, laws, regions and kernels."""
