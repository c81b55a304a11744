"""Scenario files: reading, validation, composition of systems, laws, regions and kernels."""
