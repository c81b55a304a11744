"""Pfaffian constraints: structure, null space, Lie algebra, chained form, following a field."""
