"""Expressions: functions and parser for scenario files, traversal, tests at random points."""
