"""Upwind differences, of first order."""

from holdfast.execution.level_set.schemes import Scheme

SCHEME = Scheme("upwind", ghosts=1, order=1)
