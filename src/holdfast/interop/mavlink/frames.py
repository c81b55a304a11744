"""Frames of MAVLink 1 and 2 in datagrams: found, checked, made; signed ones too.

A signature is checked before anything of a frame is believed. pymavlink signs what is sent.
Its own check is not used: before 2.4.49 it accepts a frame that is
sent again, and later ones believe the time of a frame before its signature, so that a forged frame
silences the true sender.
"""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Iterator
from typing import Any

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


try:
    from pymavlink.dialects.v20 import ardupilotmega as dialect
except ImportError:
    raise SimulationError(
        "MAVLink needs the package pymavlink", remedy='pip install "holdfast[interop]"'
    ) from None

__all__ = ["Codec", "Message", "dialect", "is_signed", "is_v1"]

V1, V2 = 0xFE, 0xFD
SIGNED = 0x01
SEARCHED = 4096
"""So many bytes of a datagram are searched for frames behind a broken one."""
V1_LENGTHS = {"MANUAL_CONTROL": 11}
"""Payloads of MAVLink 1 that version 2 has made longer, of the messages that are made [bytes]."""
RADIO_STATUS = 109
"""Radios send it unsigned."""

Message = Any
"""A message of pymavlink."""


class Codec:
    """One direction of a connection: its frames out of datagrams, and messages into frames.

    link: the number of the link in signatures. key: the secret of 32 bytes that signs the
    connection. With one, frames without a valid signature are dropped, except a radio's status, and
    what is made is signed; without one, signed frames are read like others and cannot be made.

    read: frames that were found. broken: those whose checksum is wrong. garbage: bytes that are
    part of no whole frame. unsigned: frames that the key refuses. A frame whose number is not in
    ArduPilot's set of messages is found too, by its length; its checksum cannot be known.

    Raises `SimulationError` for a key of another length.
    """

    def __init__(self, key: bytes | None = None, *, link: int = 0) -> None:
        self._mav: Any = dialect.MAVLink(None)
        self.key = key
        self._signatures = Signatures(key) if key is not None else None
        self._mav.signing.link_id = link
        self._sequence: dict[tuple[int, int], int] = {}
        self.read = self.broken = self.garbage = self.unsigned = 0

    def messages(self, datagram: bytes) -> Iterator[tuple[Message, bytes]]:
        """The messages of a datagram, each with its frame."""
        data, at, whole, most = bytearray(datagram), 0, True, SEARCHED
        while at < len(data):
            size = _size(data, at)
            message = self._decoded(data[at : at + size]) if size else None
            if message is None or not (whole or _known(message)):
                self.broken += bool(size) and whole
                self.garbage += 1
                at, whole, most = at + 1, False, most - 1
                if most == 0:
                    self.garbage += len(data) - at
                    return
                continue
            frame = bytes(data[at : at + size])
            at, whole = at + size, True
            if message is not _REFUSED:
                self.read += 1
                yield message, frame

    def _decoded(self, frame: bytearray) -> Message | None:
        try:
            message = self._mav.decode(frame)
        except dialect.MAVError:
            return None
        if self._signatures is None or (is_signed(frame) and self._signatures.valid(frame)):
            return message
        if not is_signed(frame) and message.get_msgId() == RADIO_STATUS:
            return message
        self.unsigned += 1
        return _REFUSED

    def frame(self, message: Message, system: int, component: int, *, v1: bool = False) -> bytes:
        """The frame of a message from a system and component; in MAVLink 1 where `v1`."""
        sender, mav = (system, component), self._mav
        mav.srcSystem, mav.srcComponent = sender
        mav.seq = self._sequence.get(sender, 0)
        self._sequence[sender] = (mav.seq + 1) % 256
        signing = mav.signing
        signing.sign_outgoing = self.key is not None and not v1
        signing.secret_key, signing.timestamp = self.key, max(signing.timestamp, signature_time())
        made = bytes(message.pack(mav, force_mavlink1=v1))
        signing.secret_key = None  # what is read is checked by `Signatures`
        length = V1_LENGTHS.get(message.get_type(), len(made))
        return _cut(made, length, message.crc_extra) if v1 and made[1] > length else made


_REFUSED = object()


def _cut(frame: bytes, length: int, extra: int) -> bytes:
    """A frame of MAVLink 1 without the fields that version 2 has added."""
    body = frame[:1] + bytes([length]) + frame[2 : 6 + length]
    checksum = dialect.x25crc(bytearray(body[1:]) + bytes([extra])).crc
    return body + int(checksum).to_bytes(2, "little")


def _known(message: Message) -> bool:
    return not isinstance(message, dialect.MAVLink_unknown)


def _size(data: bytearray, at: int) -> int:
    """The length of the frame that begins here; 0 where none does, or it is cut off."""
    if len(data) < at + 8:
        return 0
    if data[at] == V1:
        size = data[at + 1] + 8
    elif data[at] == V2 and not data[at + 2] & ~SIGNED:
        size = data[at + 1] + 12 + LENGTH * (data[at + 2] & SIGNED)
    else:
        return 0
    return size if at + size <= len(data) else 0


def is_v1(frame: bytes | bytearray) -> bool:
    """Whether a frame is of MAVLink 1."""
    return frame[0] == V1


def is_signed(frame: bytes | bytearray) -> bool:
    """Whether a frame is signed."""
    return frame[0] == V2 and bool(frame[2] & SIGNED)
