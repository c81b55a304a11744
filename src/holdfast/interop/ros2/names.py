"""Names on the wire of rmw_zenoh: topics, tokens of nodes and endpoints, what goes with a message.

The formats are those of the design document of rmw_zenoh for ROS 2 Jazzy and Kilted:

    topic       DOMAIN/TOPIC/TYPE/HASH
    node        @ros2_lv/DOMAIN/SESSION/NODE/NODE/NN/ENCLAVE/NAMESPACE/NAME
    endpoint    @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME/TOPIC/TYPE/HASH/QOS
    attachment  sequence number (int64), time since 1970 in ns (int64), 16 (uint8), GID (16 bytes)

A message is CDR with its encapsulation header. In a token "%" stands for every "/" of a name.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import NamedTuple

import xxhash

from holdfast.arguments import checked
from holdfast.errors import DefinitionError

DEPTH = 10
"""The number of messages that a publisher or subscriber keeps, in its token."""
QOS = f"::,{DEPTH}:,:,:,,"
"""Reliable, volatile, keep the last `DEPTH`; what is empty has the default value of rmw_zenoh."""

LATCHED_QOS = ":1:,1:,:,:,,"
"""Transient local: the last message, for those that come later too."""

_ATTACHMENT = struct.Struct("<qqB16s")
_GID = 16
_TOKEN = "[A-Za-z_][A-Za-z0-9_]*"
_NODE = re.compile(rf"{_TOKEN}\Z")
_NAMESPACE = re.compile(rf"/({_TOKEN}(/{_TOKEN})*)?\Z")
_TOPIC = re.compile(rf"(~?/)?{_TOKEN}(/{_TOKEN})*\Z")
DOMAINS = 232
"""The largest domain that ROS 2 allows."""


@checked
@dataclass(frozen=True)
class NodeName:
    """A node of a domain: its name, and its namespace as "/" or "/robot_1".

    Raises `DefinitionError` for names that ROS 2 does not allow, and for a domain outside 0 to 232.
    """

    name: str
    namespace: str = "/"
    domain: int = 0

    def __post_init__(self) -> None:
        if not _NODE.match(self.name) or "__" in self.name:
            raise DefinitionError(f"'{self.name}' names no node", expected="a name as 'filter_1'")
        if not _NAMESPACE.match(self.namespace) or "__" in self.namespace:
            raise DefinitionError(
                f"'{self.namespace}' is no namespace", expected="'/', or as '/robot_1'"
            )
        if not 0 <= self.domain <= DOMAINS:
            raise DefinitionError(f"domain {self.domain}", expected=f"0 to {DOMAINS}")

    def topic(self, name: str) -> str:
        """The full name of a topic: "/a" is absolute, "~/a" below the node, "a" in the namespace.

        Raises `DefinitionError` for a name that ROS 2 does not allow.
        """
        if not _TOPIC.match(name) or "__" in name:
            raise DefinitionError(f"'{name}' names no topic", expected="a name as 'odometry'")
        if name.startswith("/"):
            return name
        below = self.namespace.rstrip("/")
        return f"{below}/{self.name}{name[1:]}" if name.startswith("~") else f"{below}/{name}"


def dds_type(message: str) -> str:
    """'nav_msgs/msg/Odometry' as 'nav_msgs::msg::dds_::Odometry_'."""
    package, kind, name = message.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def topic_key(domain: int, topic: str, message: str, digest: str) -> str:
    """The key of the messages of a topic; `digest` is the RIHS01 hash of their type."""
    return f"{domain}/{topic.strip('/')}/{dds_type(message)}/{digest}"


def node_token(of: NodeName, session: str) -> str:
    """The token by which the nodes of a domain know of a node."""
    return f"@ros2_lv/{of.domain}/{session}/0/0/NN/%/{_mangled(of.namespace)}/{of.name}"


def endpoint_token(
    of: NodeName, session: str, entity: int, kind: str, topic: str, message: str, digest: str,
    qos: str = QOS,
) -> str:  # fmt: skip
    """The token of a publisher (kind "MP") or a subscriber ("MS"); `entity` counts them."""
    node = f"@ros2_lv/{of.domain}/{session}/0/{entity}/{kind}/%/{_mangled(of.namespace)}/{of.name}"
    return f"{node}/{_mangled(topic)}/{dds_type(message)}/{digest}/{qos}"


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def gid(token: str) -> bytes:
    """The identifier of an endpoint: XXH3 of its token, 128 bits, the low half first."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


class Attachment(NamedTuple):
    """What goes with a message: its number, from 1; when it was sent [ns since 1970]; by whom."""

    sequence: int
    sent: int
    gid: bytes

    def encode(self) -> bytes:
        return _ATTACHMENT.pack(self.sequence, self.sent, _GID, self.gid)

    @staticmethod
    def decode(data: bytes) -> Attachment:
        """Raises `ValueError` for bytes that are none."""
        if len(data) != _ATTACHMENT.size:
            raise ValueError(f"an attachment of {len(data)} bytes instead of {_ATTACHMENT.size}")
        sequence, sent, size, by = _ATTACHMENT.unpack(data)
        if size != _GID:
            raise ValueError(f"an identifier of {size} bytes instead of {_GID}")
        return Attachment(sequence, sent, by)
