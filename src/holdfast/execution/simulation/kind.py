"""What differs between the loops of one shape."""

from __future__ import annotations

from typing import NamedTuple


class Kind(NamedTuple):
    """noisy, late: how the states are measured. switch_limit: changes of mode within a second
    beyond which a run chatters. until_goal: whether a run ends in its goal. direct: whether leaves
    and parts are called by their names, as functions of the same module.
    """

    noisy: bool = False
    late: bool = False
    switch_limit: int = 1
    until_goal: bool = False
    direct: bool = False
