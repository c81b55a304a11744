"""Figures of one run, field or set (Matplotlib)."""
