"""Signatures of MAVLink 2 frames, checked before anything of a frame is believed.

pymavlink signs what is sent. Its own check is not used: before 2.4.49 it accepts a frame that is
sent again, and later ones believe the time of a frame before its signature, so that a forged frame
silences the true sender.
"""

from __future__ import annotations

import hashlib
import hmac
import time

from holdfast.errors import SimulationError

EPOCH = 1_420_070_400
"""2015-01-01, where the time of signatures begins [s, Unix]; its unit is 10 us."""
MINUTE = 6_000_000
"""How far the first frame of a stream may be behind our time [10 us]."""
LENGTH = 13
"""Of a signature: link (1), time (6), hash (6) [bytes]."""


def signature_time() -> int:
    """The time now, as signatures have it."""
    return int((time.time() - EPOCH) * 1e5)


class Signatures:
    """Which signed frames a key vouches for.

    The last 6 bytes are the first of SHA-256 over the key and all before them. The time of every
    stream (link, system, component) has to grow, so that a frame that is sent again is refused; it
    begins at most a minute behind ours.

    Raises `SimulationError` for a key that has not 32 bytes.
    """

    def __init__(self, key: bytes) -> None:
        if len(key) != 32:
            raise SimulationError(f"the key has {len(key)} bytes", expected="32")
        self.key = key
        self._times: dict[tuple[int, int, int], int] = {}

    def valid(self, frame: bytes | bytearray) -> bool:
        """Whether a signed frame is of the key's owner, and new."""
        made = hashlib.sha256(self.key + frame[:-6]).digest()[:6]
        if not hmac.compare_digest(made, bytes(frame[-6:])):
            return False
        at = int.from_bytes(frame[-12:-6], "little")
        stream = frame[-LENGTH], frame[5], frame[6]
        if at <= self._times.get(stream, signature_time() - MINUTE):
            return False
        self._times[stream] = at
        return True
