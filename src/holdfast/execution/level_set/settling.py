"""The progress of a march, and whether its set comes to rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

EIGHTHS = 8
"""Parts of a doubling of the steps for which the largest speed is kept."""

LEAST_DECAY = 0.25
"""The speed of what slows down falls at least as t to the power of minus this."""


@dataclass
class Done:
    """time [s], steps; speeds: how fast the set moved [cells/s], at most, in each eighth of a
    doubling of the steps; last: when that was looked at last; still_since: the step since
    which it is still, 0 where it is not; fixed: whether no node changed in the last step;
    measured: whether it was looked how fast the set moved in it;
    computed: stretches of nodes computed, of how many a full march would
    have; seconds: of wall time."""

    time: float = 0.0
    steps: int = 0
    speeds: list[float] = field(default_factory=list)
    last: float = math.inf
    still_since: int = 0
    computed: int = 0
    of: int = 0
    seconds: float = 0.0
    stopped: bool = False
    converged: bool = False
    fixed: bool = False
    measured: bool = False

    def moved(self, speed: float) -> None:
        """Take down how fast the set moved in the last step."""
        self.last = speed
        place = int(EIGHTHS * math.log2(self.steps))
        self.speeds += [0.0] * (place + 1 - len(self.speeds))
        self.speeds[place] = max(self.speeds[place], speed)

    @property
    def speed(self) -> float:
        """The recent speed of the set [cells/s], over an eighth of a doubling or more."""
        return max(self.speeds[-2:], default=math.inf)

    @property
    def slows(self) -> bool:
        """Whether the set moves slower than it did a doubling, half and a quarter of one ago.

        A drift that is small beside all speeds goes on for ever at the same speed, while what
        comes to rest, or is worn off by the scheme, slows down.
        """
        now = self.speed
        for back in (EIGHTHS, EIGHTHS // 2, EIGHTHS // 4):
            then = max(self.speeds[:-back][-2:], default=0.0)
            if now > then * 2.0 ** (-LEAST_DECAY * back / EIGHTHS):
                return False
        return True

    def settled(self, still: bool) -> bool:
        """Whether the march has been still for a quarter of a doubling of the steps, until now.

        To be called after every step that is measured.
        """
        if not still:
            self.still_since = 0
        elif not self.still_since:
            self.still_since = self.steps
        return still and self.steps >= 2.0 ** (2 / EIGHTHS) * self.still_since
