"""The autopilot's end: a law of one's own drives any physics backend of ArduPilot's interface."""

from __future__ import annotations

import math
import socket
import time
from collections import deque
from collections.abc import Sequence

from holdfast.arguments import checked
from holdfast.errors import SimulationError
from holdfast.interop.ardupilot.packets import MAGIC, ServoPacket, read_motion
from holdfast.interop.ardupilot.physics import LATE, PORT
from holdfast.interop.ardupilot.servos import NEUTRAL
from holdfast.interop.closing import Closing
from holdfast.interop.planar_motion import Motion
from holdfast.interop.udp import LONGEST


class Autopilot(Closing):
    """Sends servo packets and takes the answers, as ArduPilot's simulator does, in lockstep.

    rate [Hz]: what the physics is asked to step by, 1 to 65535. channels: 16 or 32. resend [s]: a
    packet that has no answer is sent again (ArduPilot: after 1 s). patience [s]: after that `frame`
    raises. Used in a `with`, or `close` it.

    restarts: how often the physics began anew: its time fell. ignored: answers that were there
    already. resent: packets that were sent again.

    Raises `SimulationError` for invalid arguments and for a host that is unknown.
    """

    @checked
    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = PORT,
        *,
        rate: int = 50,
        channels: int = 16,
        resend: float = 0.1,
        patience: float = 10.0,
    ) -> None:
        if channels not in MAGIC or rate not in range(1, 0x10000):
            raise SimulationError(
                f"rate is {rate} Hz, with {channels} channels",
                expected="1 to 65535 Hz, and 16 or 32 channels",
            )
        if not (0 < resend <= patience < math.inf):
            raise SimulationError(
                f"resend is {resend} s, patience {patience} s", expected="0 < resend <= patience"
            )
        if port not in range(1, 0x10000):
            raise SimulationError(f"port is {port}", expected="1 to 65535")
        self.rate, self.channels, self.resend, self.patience = rate, channels, resend, patience
        try:
            self.physics = (socket.gethostbyname(host), int(port))
        except OSError as error:
            raise SimulationError(f"{host!r} is no host ({error.strerror})") from None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._seen: deque[bytes] = deque(maxlen=LATE)
        self.count, self.t = 0, -math.inf
        self.restarts = self.ignored = self.resent = 0

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def frame(self, pwm: Sequence[int]) -> Motion:
        """Send the pulses [us] of the first channels, the others neutral; the motion after them.

        Raises `SimulationError` where no answer comes within the patience, for an answer that is
        none, and for pulses that are no whole numbers from 0 to 65535.
        """
        pulses = (*pwm, *[NEUTRAL] * (self.channels - len(pwm)))
        data = ServoPacket(self.rate, self.count, pulses).pack()
        ends, resent = time.monotonic() + self.patience, False
        while True:
            if (now := time.monotonic()) >= ends:
                raise SimulationError(
                    f"the physics at {self.physics[0]}:{self.physics[1]} is silent for "
                    f"{self.patience:g} s at frame {self.count}",
                    remedy="start it, or give more patience",
                )
            self.resent += resent
            self._socket.sendto(data, self.physics)
            motion = self._answer(min(now + self.resend, ends))
            if motion is not None:
                self.count += 1
                return motion
            resent = True

    def _answer(self, until: float) -> Motion | None:
        """The next answer that was not there yet; None if there is none until then."""
        while (left := until - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                data, sender = self._socket.recvfrom(LONGEST)
            except (TimeoutError, ConnectionError):
                continue
            if sender != self.physics or data in self._seen:
                self.ignored += 1
                continue
            motion = read_motion(data)
            self._seen.append(data)
            self.restarts += motion.t < self.t
            self.t = motion.t
            return motion
        return None
