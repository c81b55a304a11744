"""Presentation: figures and text from results, without new computations."""
