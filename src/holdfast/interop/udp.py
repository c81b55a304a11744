"""UDP sockets for autopilots."""

from __future__ import annotations

import errno
import re
import socket
from collections.abc import Iterator
from typing import Self

from holdfast.errors import SimulationError


class Closing:
    """A context that calls its `close`."""

    def close(self) -> None:
        """Close what is open; a second time does nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


Address = tuple[str, int]
LONGEST = 65536
"""More than the longest datagram [bytes]."""
MOST = 1000
"""So many datagrams are received at once, so that a flood does not keep from deciding."""


def bound(host: str, port: int) -> socket.socket:
    """A socket that receives at an address; 0 is any free port.

    Raises `SimulationError` for a port in use, and for a host that is not of this machine.
    """
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind((host, port))
    except (OSError, OverflowError) as error:
        made.close()
        said = error.strerror if isinstance(error, OSError) else str(error)
        used = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
        raise SimulationError(
            f"{host}:{port} cannot be bound ({said})",
            expected="an address of this machine, and a free port",
            remedy="end the program that uses the port, or choose another" if used else "",
        ) from None
    return made


class Port:
    """One end of a connection, in the notation of MAVLink programs.

    "udpin:HOST:PORT" receives there and answers whoever sent last; "udpout:HOST:PORT" sends there,
    and receives the answers. A sender other than the present one is heard only after `patience`
    [s] of silence, so that a program that was started again is heard and a stray one is not.

    counts what it refused: `strangers`, datagrams of another sender; `unsent`, datagrams that the
    operating system did not take or that had no receiver yet.
    """

    def __init__(self, text: str, *, patience: float = 2.0) -> None:
        match = re.fullmatch(r"(udpin|udpout):([^:]+):(\d{1,5})", text)
        if not match or int(match[3]) > 65535:
            raise SimulationError(
                f"{text!r} is no connection", expected="udpin:HOST:PORT or udpout:HOST:PORT"
            )
        kind, host, port = match[1], match[2], int(match[3])
        self.text, self.patience = text, patience
        self.peer: Address | None = None
        self._fixed = kind == "udpout"
        self._heard = -float("inf")
        self.strangers = self.unsent = 0
        if self._fixed:
            try:
                self.peer = (socket.gethostbyname(host), port)
            except OSError as error:
                raise SimulationError(f"{host!r} is no host ({error.strerror})") from None
        self.socket = bound("" if self._fixed else host, 0 if self._fixed else port)
        self.socket.setblocking(False)

    @property
    def port(self) -> int:
        """The number of the port of this end."""
        return int(self.socket.getsockname()[1])

    def receive(self, now: float) -> Iterator[bytes]:
        """The datagrams that wait, at `now` [s], up to `MOST`."""
        for _ in range(MOST):
            try:
                data, sender = self.socket.recvfrom(LONGEST)
            except BlockingIOError:
                return
            except ConnectionError:  # a datagram of ours had no receiver
                continue
            if sender != self.peer and (
                self._fixed or (self.peer and now - self._heard <= self.patience)
            ):
                self.strangers += 1
                continue
            self.peer, self._heard = sender, now
            yield data

    def send(self, data: bytes) -> None:
        """Send a datagram, if it is known to whom."""
        if self.peer is None:
            self.unsent += 1
            return
        try:
            self.socket.sendto(data, self.peer)
        except OSError:
            self.unsent += 1

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
