"""Closed loops: steppers, events, the driver of many runs, the quadratic program."""
