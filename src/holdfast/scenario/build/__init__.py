"""Definitions from the tables of a scenario file: one module for each table."""
