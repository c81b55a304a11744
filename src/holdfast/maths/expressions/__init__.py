"""Expressions: the functions and the parser of files, traversal, random points, plain numbers."""
