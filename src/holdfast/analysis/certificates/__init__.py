"""Proofs over cells of the state space: sets that held inputs keep, rounding counted."""
