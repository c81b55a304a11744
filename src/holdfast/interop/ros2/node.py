"""A node of ROS 2 over Zenoh, and what rmw_zenoh puts on the wire: topics, tokens, attachments.

The graph of rmw_zenoh shows its publishers and subscribers.

The formats are those of the design document of rmw_zenoh for ROS 2 Jazzy and Kilted:

    topic       DOMAIN/TOPIC/TYPE/HASH
    node        @ros2_lv/DOMAIN/SESSION/NODE/NODE/NN/ENCLAVE/NAMESPACE/NAME
    endpoint    @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME/TOPIC/TYPE/HASH/QOS
    attachment  sequence number (int64), time since 1970 in ns (int64), 16 (uint8), GID (16 bytes)

A message is CDR with its encapsulation header. In a token "%" stands for every "/" of a name.
"""

from __future__ import annotations

import json
import os
import re
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import xxhash
import zenoh

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, OutputError
from holdfast.interop import ros_messages as messages
from holdfast.interop.closing import Closing

DEPTH = 10
"""The number of messages that a publisher or subscriber keeps, in its token."""
QOS = f"::,{DEPTH}:,:,:,,"
"""Reliable, volatile, keep the last `DEPTH`; what is empty has the default value of rmw_zenoh."""

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


def any_type_key(domain: int, topic: str) -> str:
    """The keys of a topic whatever the type, so that another type is seen and refused."""
    return f"{domain}/{topic.strip('/')}/*/*"


def node_token(of: NodeName, session: str) -> str:
    """The token by which the nodes of a domain know of a node."""
    return f"@ros2_lv/{of.domain}/{session}/0/0/NN/%/{_mangled(of.namespace)}/{of.name}"


def endpoint_token(
    of: NodeName, session: str, entity: int, kind: str, topic: str, message: str, digest: str
) -> str:
    """The token of a publisher (kind "MP") or a subscriber ("MS"); `entity` counts them."""
    node = f"@ros2_lv/{of.domain}/{session}/0/{entity}/{kind}/%/{_mangled(of.namespace)}/{of.name}"
    return f"{node}/{_mangled(topic)}/{dds_type(message)}/{digest}/{QOS}"


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


ROUTER = "tcp/localhost:7447"
"""Where the router of rmw_zenoh (`ros2 run rmw_zenoh_cpp rmw_zenohd`) listens."""
KEPT = 16
"""Messages of a topic that wait to be taken; the oldest are dropped."""


@dataclass(frozen=True)
class Network:
    """Which ROS 2 a node belongs to, and how it reaches the others.

    domain: by default that of ROS_DOMAIN_ID, else 0. connect: the routers or peers that are tried
    until they answer, now or later. listen: where peers reach this node; port 0 is any free one. By
    default both are those of rmw_zenoh: a router at tcp/localhost:7447 makes the peers known to
    each other, and the messages then go directly. config: a file of Zenoh's own settings (TLS,
    interfaces), in place of both; by default that of ZENOH_SESSION_CONFIG_URI. Multicast is not
    used. Raises `DefinitionError` for a text in place of several.
    """

    domain: int | None = None
    connect: tuple[str, ...] = (ROUTER,)
    listen: tuple[str, ...] = ("tcp/localhost:0",)
    config: str | None = None

    def __post_init__(self) -> None:
        for name in ("connect", "listen"):
            if isinstance(getattr(self, name), str):
                raise DefinitionError(
                    f"{name} is '{getattr(self, name)}'",
                    expected="addresses, as ('tcp/host:7447',)",
                )

    def domain_id(self) -> int:
        """Raises `DefinitionError` for a ROS_DOMAIN_ID that is no number."""
        said = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
        if self.domain is not None:
            return self.domain
        if not said.isdecimal():
            raise DefinitionError(f"ROS_DOMAIN_ID is '{said}'", expected="a number from 0 to 232")
        return int(said)

    def session(self, mode: str = "peer") -> Any:
        """An open session of Zenoh. Raises `OutputError` where none can be opened."""
        file = self.config or (os.environ.get("ZENOH_SESSION_CONFIG_URI") if mode == "peer" else "")
        try:
            if file:
                return zenoh.open(zenoh.Config.from_file(file))
            config = zenoh.Config()
            for key, value in {
                "mode": mode,
                "connect/endpoints": self.connect,
                "connect/exit_on_failure": False,
                "connect/timeout_ms": -1,  # in the background, for ever
                "connect/retry": {
                    "period_init_ms": 200,
                    "period_max_ms": 1000,
                    "period_increase_factor": 2,
                },
                "listen/endpoints": self.listen,
                "scouting/multicast/enabled": False,
                "scouting/gossip/enabled": True,
                "scouting/delay": 0 if mode == "router" else 500,
                "timestamping/enabled": True,
            }.items():
                config.insert_json5(key, json.dumps(value))
            return zenoh.open(config)
        except zenoh.ZError as error:
            where = file or f"{', '.join(self.connect)}; {', '.join(self.listen)}"
            raise OutputError(
                f"no session of Zenoh ({where}): {str(error).split(' at /')[0]}"[:300],
                expected="addresses as tcp/localhost:7447, and ports that are free",
            ) from None


@contextmanager
def router(listen: str = ROUTER) -> Iterator[None]:
    """A router for nodes where no ROS 2 is installed; it does what `rmw_zenohd` does.

    Raises `OutputError` where it cannot listen.
    """
    session = Network(connect=(), listen=(listen,)).session("router")
    try:
        yield
    finally:
        session.close()


class Publisher:
    """Sends messages of one type on a topic, with their number and the time."""

    def __init__(self, session: Any, key: str, token: str) -> None:
        self._gid, self._count = gid(token), 0
        self._session, self._key = session, key
        self._token = session.liveliness().declare_token(token)
        self._publisher = session.declare_publisher(key, express=True)

    def send(self, message: Any, *, last: bool = False) -> None:
        """Send a message; one that finds no room in the queue within a millisecond is dropped.

        last: it is never dropped, because none follows that says the same. It may wait for seconds.
        Raises `OutputError` where the session is closed.
        """
        self._count += 1
        attachment = Attachment(self._count, time.time_ns(), self._gid).encode()
        data = messages.encoded(message)
        try:
            if last:
                self._session.put(
                    self._key,
                    data,
                    attachment=attachment,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    express=True,
                )
            else:
                self._publisher.put(data, attachment=attachment)
        except zenoh.ZError as error:
            raise OutputError(f"a message cannot be sent: {error}"[:200]) from None


class Subscription:
    """The messages of one type on a topic; what is none of them is counted and said.

    refused: how many messages were of another type, without an attachment, or unreadable; why: what
    was wrong with the last of these.
    """

    def __init__(self, session: Any, keys: str, key: str, kind: str, token: str) -> None:
        self._key, self._kind = key, kind
        self.received, self.refused, self.why = 0, 0, ""
        self._token = session.liveliness().declare_token(token)
        self._subscriber = session.declare_subscriber(keys, zenoh.handlers.RingChannel(KEPT))

    def take(self) -> Iterator[Any]:
        """The messages that came since the last call, in order; at most `KEPT`."""
        for _ in range(KEPT):
            sample = self._subscriber.try_recv()
            if sample is None:
                return
            try:
                message = self._read(sample)
            except messages.MessageError as error:
                self.refuse(error)
            else:
                self.received += 1
                yield message

    def refuse(self, error: messages.MessageError) -> None:
        """Count a message that is not what the topic is for."""
        self.refused, self.why = self.refused + 1, str(error)

    def _read(self, sample: Any) -> Any:
        key = str(sample.key_expr)
        if key != self._key:
            kind, digest = key.split("/")[-2:]
            mine = dds_type(self._kind)
            what = f"type {kind}" if kind != mine else f"another definition of {kind} ({digest})"
            raise messages.MessageError(f"a message of {what}"[:120], expected=self._kind)
        try:
            Attachment.decode(sample.attachment.to_bytes() if sample.attachment else b"")
        except ValueError as error:
            raise messages.MessageError(f"a message of no node of ROS 2: {error}") from None
        return messages.decoded(sample.payload.to_bytes(), self._kind)


class Node(Closing):
    """A name in the graph, with its publishers and subscribers.

    Raises `DefinitionError` for names and domains that ROS 2 does not allow, and `OutputError`
    where the network cannot be reached. It is closed by `close`, or at the end of `with`.
    """

    @checked
    def __init__(self, name: str, *, namespace: str = "/", network: Network | None = None) -> None:
        network = network or Network()
        self.name = NodeName(name, namespace, network.domain_id())
        self._session = network.session()
        self._id, self._entities = str(self._session.zid()), 0
        self._graph: Any = None
        self._known: set[str] = set()
        self._token = self._session.liveliness().declare_token(node_token(self.name, self._id))

    def publisher(self, topic: str, kind: str) -> Publisher:
        """A publisher of a standard type, as "nav_msgs/msg/Odometry".

        Raises `DefinitionError` for a type that is none, and for a name that ROS 2 does not allow.
        """
        topic, digest = self.name.topic(topic), messages.digest(kind)
        key = topic_key(self.name.domain, topic, kind, digest)
        return Publisher(self._session, key, self._endpoint("MP", topic, kind, digest))

    def subscription(self, topic: str, kind: str) -> Subscription:
        """A subscriber to a standard type; see `publisher`."""
        topic, digest = self.name.topic(topic), messages.digest(kind)
        key = topic_key(self.name.domain, topic, kind, digest)
        keys = any_type_key(self.name.domain, topic)
        token = self._endpoint("MS", topic, kind, digest)
        return Subscription(self._session, keys, key, kind, token)

    def _endpoint(self, what: str, topic: str, kind: str, digest: str) -> str:
        self._entities += 1
        return endpoint_token(self.name, self._id, self._entities, what, topic, kind, digest)

    def graph(self) -> Sequence[str]:
        """The tokens of the nodes, publishers and subscribers of the domain, this node's too.

        Those that are known: from the first call on it listens, and what is there is heard soon.
        """
        if self._graph is None:
            keys = f"@ros2_lv/{self.name.domain}/**"
            self._graph = self._session.liveliness().declare_subscriber(
                keys, self._heard, history=True
            )
        return sorted(self._known)

    def _heard(self, token: Any) -> None:
        """In a thread of Zenoh's."""
        if token.kind == zenoh.SampleKind.PUT:
            self._known.add(str(token.key_expr))
        else:
            self._known.discard(str(token.key_expr))

    def close(self) -> None:
        """Leave the graph. A second call does nothing."""
        if not self._session.is_closed():
            self._session.close()
