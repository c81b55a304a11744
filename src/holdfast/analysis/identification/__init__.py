"""Parameters of a system from logs of its motion."""
