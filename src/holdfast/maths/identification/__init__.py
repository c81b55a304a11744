"""What a log of a system's motion depends on, and how: the expressions of an identification."""
