"""Comparison of laws and cases of a scenario; of closed loops with a reference kernel."""
