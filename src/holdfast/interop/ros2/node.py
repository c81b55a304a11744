"""Nodes of ROS 2 over Zenoh: a safety filter, a simulated vehicle, a controller.

The graph of rmw_zenoh shows its publishers and subscribers. What a filter does is
diagnostic_msgs/DiagnosticArray too. Samples follow a clock that only goes forward.
"""

from __future__ import annotations

import json
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypedDict, Unpack

import zenoh
import zenoh.ext

from holdfast.analysis.online.controller import Plant
from holdfast.analysis.online.decision import DecisionRecord, Status
from holdfast.analysis.online.relay import Relay
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, OutputError
from holdfast.host.interruption import ended_by_signals
from holdfast.interop import ros_messages as messages
from holdfast.interop.ros2.lookout import Lookout, Watch
from holdfast.interop.ros2.names import (
    LATCHED_QOS,
    QOS,
    Attachment,
    NodeName,
    dds_type,
    endpoint_token,
    gid,
    node_token,
    topic_key,
)
from holdfast.interop.ros_messages import (
    DETECTIONS,
    GRID,
    ODOMETRY,
    Interface,
    MessageError,
    header,
    made,
)
from holdfast.interop.udp import Closing
from holdfast.planning.moving_obstacles import Obstacle
from holdfast.planning.occupancy_map import OccupancyMap, Unknown

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

    listen: the endpoint, such as "tcp/[::]:7447". Raises `OutputError` where it cannot listen.
    """
    session = Network(connect=(), listen=(listen,)).session("router")
    try:
        yield
    finally:
        session.close()


class Publisher:
    """Sends messages of one type on a topic, with their number and the time."""

    def __init__(self, session: Any, key: str, token: str, *, latched: bool = False) -> None:
        self._gid, self._count = gid(token), 0
        self._session, self._key = session, key
        self._token = session.liveliness().declare_token(token)
        if latched:
            self._publisher: Any = zenoh.ext.declare_advanced_publisher(
                session, key, express=True, publisher_detection=True,
                cache=zenoh.ext.CacheConfig(max_samples=1),
            )  # fmt: skip
        else:
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

    def __init__(
        self, session: Any, keys: str, key: str, kind: str, token: str, *, latched: bool = False
    ) -> None:
        self._key, self._kind = key, kind
        self.received, self.refused, self.why = 0, 0, ""
        self._token = session.liveliness().declare_token(token)
        ring: Any = zenoh.handlers.RingChannel(KEPT)
        if latched:
            earlier = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            self._subscriber: Any = zenoh.ext.declare_advanced_subscriber(
                session, keys, ring, history=earlier
            )
        else:
            self._subscriber = session.declare_subscriber(keys, ring)

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

    name, namespace: of the node. network: by default one of its own. Raises `DefinitionError` for
    names and domains that ROS 2 does not allow, and `OutputError` where the network cannot be
    reached. It is closed by `close`, or at the end of `with`.
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

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Publisher:
        """A publisher of a standard type, as "nav_msgs/msg/Odometry".

        latched: whether subscribers that come later get the last message (transient local).
        Raises `DefinitionError` for a type that is none, and for a name that ROS 2 does not allow.
        """
        topic, digest = self.name.topic(topic), messages.digest(kind)
        key = topic_key(self.name.domain, topic, kind, digest)
        token = self._endpoint("MP", topic, kind, digest, latched)
        return Publisher(self._session, key, token, latched=latched)

    def subscription(self, topic: str, kind: str, *, latched: bool = False) -> Subscription:
        """A subscriber to a standard type; see `publisher`."""
        topic, digest = self.name.topic(topic), messages.digest(kind)
        key = topic_key(self.name.domain, topic, kind, digest)
        keys = f"{self.name.domain}/{topic.strip('/')}/*/*"  # another type is seen, and refused
        token = self._endpoint("MS", topic, kind, digest, latched)
        return Subscription(self._session, keys, key, kind, token, latched=latched)

    def _endpoint(self, what: str, topic: str, kind: str, digest: str, latched: bool) -> str:
        self._entities += 1
        qos = LATCHED_QOS if latched else QOS
        return endpoint_token(self.name, self._id, self._entities, what, topic, kind, digest, qos)

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


OK, WARN, ERROR, STALE = range(4)
"""The levels of diagnostic_msgs/DiagnosticStatus."""
EVERY = 0.5
"""Seconds between two messages on what does not change."""

_LEVELS = {Status.PASSED.value: OK, Status.CHANGED.value: WARN}


class Diagnostics:
    """Publishes on `/diagnostics` at every change of a status, and every `EVERY` seconds.

    The level is OK where the command is passed, WARN where it is changed or lost or a message was
    refused since, ERROR where nothing is promised, STALE when the node is closed.
    """

    def __init__(self, node: Node, hardware: str, topics: Mapping[str, Subscription]) -> None:
        self._name, self._hardware, self._topics = node.name.name, hardware, topics
        self._publisher = node.publisher("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
        self._said, self._due, self._refused, self._why = "", 0.0, 0, ""

    def tell(self, record: DecisionRecord, now: float, stamp: int, skipped: int) -> None:
        """A decision, at `now` [s]; stamp in ns since 1970."""
        kind = f"{record.lost}/{record.status}"
        self._why = record.why or (self._why if kind == self._said else "")
        if kind == self._said and now < self._due:
            return
        self._said, self._due = kind, now + EVERY
        refused = sum(t.refused for t in self._topics.values())
        level = max(_LEVELS.get(record.status, ERROR), WARN if record.lost else OK)
        if refused > self._refused:
            level, self._refused = max(level, WARN), refused
        values: dict[str, Any] = {
            "status": record.status,
            "lost": record.lost,
            "value": record.value,
            "slack": record.slack,
            "why": self._why,
            "gave way": ", ".join(record.gave_way),
            **{f"command {n}": v for n, v in record.command.items()},
            **{f"input {n}": v for n, v in record.input.items()},
            "samples skipped": skipped,
        }
        for name, topic in self._topics.items():
            values[f"{name} received"] = topic.received
            values[f"{name} refused"] = topic.refused
            values[f"{name} refused because"] = topic.why
        self._send(level, self._why or record.status, values, stamp)

    def farewell(self, stamp: int) -> None:
        """That the node is closed."""
        self._send(STALE, "closed; the last command was the fallback", {}, stamp, last=True)

    def _send(
        self, level: int, said: str, values: Mapping[str, Any], stamp: int, *, last: bool = False
    ) -> None:
        status = made(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=f"{self._name}: decisions",
            message=said,
            hardware_id=self._hardware,
            values=[
                made("diagnostic_msgs/msg/KeyValue", key=key, value=_text(value))
                for key, value in values.items()
            ],
        )
        report = made(
            "diagnostic_msgs/msg/DiagnosticArray", header=header(stamp, ""), status=[status]
        )
        self._publisher.send(report, last=last)


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


class Loop:
    """Calls `step(now)` every `sample_time` [s]; now is the monotonic clock [s].

    skipped: the samples that passed while a step took longer. `stop` ends it after the sample.
    """

    def __init__(self, sample_time: float) -> None:
        self.sample_time, self.skipped = sample_time, 0
        self._ended = threading.Event()

    def run(self, step: Callable[[float], object], seconds: float | None = None) -> None:
        """Until `stop`, or for so many seconds."""
        began = time.monotonic()
        sample = 0
        while not self._ended.is_set():
            step(time.monotonic())
            sample += 1
            late = int((time.monotonic() - began) / self.sample_time) - sample
            if late > 0:
                self.skipped += late
                sample += late
            if seconds is not None and sample * self.sample_time >= seconds:
                return
            self._ended.wait(max(0.0, began + sample * self.sample_time - time.monotonic()))

    def stop(self) -> None:
        """End it; any thread may call this, and the handler of a signal."""
        self._ended.set()


TEXT = "std_msgs/msg/String"


class SampledNode(Closing):
    """A node that does something at every sample: `step`, `run` until `stop`, `close`."""

    def __init__(
        self,
        name: str,
        namespace: str,
        network: Network | None,
        sample_time: float,
        topics: Sequence[str],
    ) -> None:
        for topic in topics:  # before a session is open
            NodeName(name, namespace).topic(topic)
        self.node = Node(name, namespace=namespace, network=network)
        self.loop = Loop(sample_time)

    def step(self, now: float) -> object:
        """What is done at a sample; now is the monotonic clock [s]."""
        raise NotImplementedError

    def run(self, seconds: float | None = None) -> None:
        """A step at every sample until `stop`, Ctrl-C or SIGTERM, or for so many seconds."""
        with ended_by_signals(self.stop):
            self.loop.run(self.step, seconds)

    def stop(self) -> None:
        """End `run`; any thread may call this."""
        self.loop.stop()

    def close(self) -> None:
        """Leave the graph."""
        self.node.close()


class FilterNode(SampledNode):
    """A safety filter between a controller and a vehicle that speak ROS 2.

    It subscribes to `odometry` (nav_msgs/Odometry) and to `nominal_command`, and publishes
    `command`, of the same type, at every `sample_time` of the filter. Also published:
    `~/decisions` (std_msgs/String), the `DecisionRecord.line` of every sample, and `/diagnostics`
    (diagnostic_msgs/DiagnosticArray) at every change and twice a second.

    name, namespace, network: as of `Node`. keep: the filter. interface: how states and inputs stand
    in messages. odometry, nominal, command: other names of the topics. patience [s]: see `Relay`; a
    message counts as received at the sample that takes it. map: of a filter with obstacles, the
    topic of a nav_msgs/OccupancyGrid, as "map"; its newest one counts, however old, and until one
    came nothing is promised. unknown: whether its unknown cells are "occupied" or "free". within
    [m]: how far from the vehicle occupied cells are obstacles. Fields of the command out of the
    plane of motion are passed on while commands come. The last command before it is closed is the
    filter's fallback.

    Messages of other types, without an attachment of rmw_zenoh, in another frame, or unreadable are
    refused: counted and said in the diagnostics, and not taken for a measurement or a command.

    lookout: of a filter with obstacles, what it takes for some; without a map by default
    vision_msgs' Detection3DArray of the topic `detections`. Where these cease nothing is promised,
    and the command is the fallback.

    Raises `DefinitionError` for a filter that needs more than Odometry gives, for a map or a
    lookout beside a filter without obstacles, and what `Node` and `Relay` raise.
    """

    @checked
    def __init__(
        self,
        keep: SafetyFilter,
        *,
        interface: Interface | None = None,
        name: str = "safety_filter",
        namespace: str = "/",
        network: Network | None = None,
        odometry: str = "odometry",
        nominal: str = "nominal_command",
        command: str = "command",
        patience: float = 0.25,
        map: str | None = None,
        unknown: Unknown = "occupied",
        within: float = 3.0,
        lookout: Lookout | None = None,
    ) -> None:
        self.interface = _fitting(interface, keep)
        if keep.clearing is None and (map is not None or lookout is not None):
            raise DefinitionError(
                f"a {'map' if map else 'lookout'} is given, and the filter keeps clear of no "
                "obstacles",
                remedy="make it with obstacles=20",
            )
        if keep.clearing is not None and map is None and lookout is None:
            lookout = Lookout()
        self.map: OccupancyMap | None = None
        self._unknown, self._within = unknown, within
        self._position = keep.clearing.position if keep.clearing else ()
        self._place: list[float] | None = None
        self.relay = Relay(keep, patience=patience)
        looked = () if lookout is None else (lookout.detections or odometry, *lookout.neighbours)
        topics = odometry, nominal, command, *([map] if map else []), *looked
        super().__init__(name, namespace, network, keep.sample_time, topics)
        self._states = keep.measured_states
        self._rest: Mapping[str, float] = {}
        self._odometry = self.node.subscription(odometry, ODOMETRY)
        self._nominal = self.node.subscription(nominal, self.interface.command)
        self._command = self.node.publisher(command, self.interface.command)
        self._decisions = self.node.publisher("~/decisions", TEXT)
        heard = {"odometry": self._odometry, "command": self._nominal}
        self._map = None if map is None else self.node.subscription(map, GRID, latched=True)
        if self._map is not None:
            heard["map"] = self._map
        self._watch = None if lookout is None else Watch(lookout, self.interface.frame)
        self._boxes, self._neighbours = None, dict[str, Subscription]()
        if lookout is not None:
            if lookout.detections is not None:
                self._boxes = self.node.subscription(lookout.detections, DETECTIONS)
                heard["detections"] = self._boxes
            self._neighbours = {n: self.node.subscription(n, ODOMETRY) for n in lookout.neighbours}
            heard |= self._neighbours
        self._diagnostics = Diagnostics(self.node, keep.system.name, heard)

    def step(self, now: float) -> DecisionRecord:
        """Take what came, decide, and publish."""
        if self._map is not None:
            self.map = _newest(self._map, self._read_map) or self.map
        state = _newest(self._odometry, self.interface.state)
        unmapped = self._map is not None and self.map is None
        if state is not None:
            self.relay.measured([state[n] for n in self._states], now)
            self._place = [state[n] for n in self._position]
        asked = _newest(self._nominal, self.interface.inputs)
        if asked is not None:
            inputs, self._rest = asked
            self.relay.commanded(inputs, now)
        self._look(now)
        record = self.relay.decide(now)
        if unmapped and record.why:
            record = replace(record, why="no map yet: the input is the fallback")
        rest = {} if record.lost else self._rest
        stamp = time.time_ns()
        self._command.send(self.interface.wrap(record.input, stamp, rest))
        self._decisions.send(made(TEXT, data=record.line()))
        self._diagnostics.tell(record, now, stamp, self.loop.skipped)
        return record

    def _read_map(self, message: Any) -> OccupancyMap:
        return self.interface.map(message, self._unknown, self.map)

    def _look(self, now: float) -> None:
        """Take what came of obstacles, and those of the map around the last place."""
        if self._watch is None and self._map is None:
            return
        around: tuple[list[Obstacle], float] | None = [], now
        if (watch := self._watch) is not None:
            if self._boxes is not None:
                watch.seen(_newest(self._boxes, watch.boxes), now)
            for topic, subscription in self._neighbours.items():
                watch.met(topic, _newest(subscription, partial(watch.neighbour, topic)), now)
            around = watch.around(now)
        if around is None:
            return
        obstacles, at = around
        if self._map is not None:
            if self.map is None or self._place is None:
                return
            obstacles = [*obstacles, *self.map.near(self._place, self._within)]
        self.relay.surrounded(obstacles, at)

    def close(self) -> None:
        """Send the fallback and leave the graph."""
        names, stamp = self.relay.commands, time.time_ns()
        last = dict(zip(names, self.relay.keep.fallback.tolist(), strict=True))
        with suppress(OutputError):
            self._command.send(self.interface.wrap(last, stamp), last=True)
            self._diagnostics.farewell(stamp)
        super().close()


class VehicleNode(SampledNode):
    """A simulated vehicle: it moves by the newest `command`, and publishes `odometry`.

    plant: a `Plant`. patience [s]: without a command for so long its inputs are 0. interface,
    odometry, command, name, namespace, network: as of `FilterNode`.
    """

    @checked
    def __init__(
        self,
        plant: Plant,
        *,
        interface: Interface | None = None,
        name: str = "vehicle",
        namespace: str = "/",
        network: Network | None = None,
        odometry: str = "odometry",
        command: str = "command",
        patience: float = 0.5,
    ) -> None:
        self.interface = interface or Interface(plant.system)
        self.plant, self.patience = plant, patience
        super().__init__(name, namespace, network, plant.sample_time, (odometry, command))
        self._odometry = self.node.publisher(odometry, ODOMETRY)
        self._command = self.node.subscription(command, self.interface.command)
        self._input, self._at = [0.0] * len(plant.system.inputs), -math.inf

    def step(self, now: float) -> None:
        """Move by a sample, and say where it is."""
        asked = _newest(self._command, self.interface.inputs)
        if asked is not None and all(map(math.isfinite, asked[0].values())):
            self._input, self._at = list(asked[0].values()), now
        fresh = now - self._at <= self.patience
        self.plant.step(self._input if fresh else [0.0] * len(self._input))
        state = dict(zip(self.plant.system.state_names, self.plant.state.tolist(), strict=True))
        self._odometry.send(self.interface.odometry(state, time.time_ns()))


class ControllerNode(SampledNode):
    """A controller: for every newest `odometry` a `nominal_command`.

    interface, odometry, command, name, namespace, network: as of `FilterNode`. controller: a
    function of the states that Odometry gives, in the order of the system; it returns the inputs in
    their order. sample_time [s]: how often it looks for a message.
    """

    @checked
    def __init__(
        self,
        controller: Callable[[Sequence[float]], Sequence[float]],
        interface: Interface,
        *,
        sample_time: float = 0.02,
        name: str = "controller",
        namespace: str = "/",
        network: Network | None = None,
        odometry: str = "odometry",
        command: str = "nominal_command",
    ) -> None:
        self.controller, self.interface = controller, interface
        super().__init__(name, namespace, network, sample_time, (odometry, command))
        self._odometry = self.node.subscription(odometry, ODOMETRY)
        self._command = self.node.publisher(command, interface.command)

    def step(self, now: float) -> None:
        """Answer the newest message, if one came."""
        state = _newest(self._odometry, self.interface.state)
        if state is not None:
            inputs = self.controller([state[n] for n in self.interface.states])
            named = dict(zip(self.interface.fields, inputs, strict=True))
            self._command.send(self.interface.wrap(named, time.time_ns()))


class FilterOptions(TypedDict, total=False):
    """Those of `FilterNode`."""

    interface: Interface | None
    name: str
    namespace: str
    network: Network | None
    odometry: str
    nominal: str
    command: str
    patience: float
    map: str | None
    unknown: Unknown
    within: float
    lookout: Lookout | None


@checked
def serve(
    keep: SafetyFilter,
    *,
    said: Callable[[DecisionRecord], None] | None = None,
    seconds: float | None = None,
    **settings: Unpack[FilterOptions],
) -> None:
    """A `FilterNode` until Ctrl-C or SIGTERM, or for so many seconds.

    keep: the filter. seconds [s]: how long; None for ever. said: called with every decision.
    settings: those of `FilterNode`. Raises what that does.
    """
    with FilterNode(keep, **settings) as node:

        def step(now: float) -> None:
            record = node.step(now)
            if said is not None:
                said(record)

        with ended_by_signals(node.stop):
            node.loop.run(step, seconds)


def _newest(topic: Subscription, read: Callable[[Any], Any]) -> Any:
    """What the newest readable message says; None if there is none."""
    newest = None
    for message in topic.take():
        try:
            newest = read(message)
        except MessageError as error:
            topic.refuse(error)
    return newest


def _fitting(interface: Interface | None, keep: SafetyFilter) -> Interface:
    """The interface of a filter; refuses one that gives less than the filter needs."""
    made = interface or Interface(keep.system)
    if made.system.input_names != keep.system.input_names:
        raise DefinitionError(
            f"the interface is of inputs {', '.join(made.system.input_names)}",
            expected=", ".join(keep.system.input_names),
        )
    if lacking := [n for n in keep.measured_states if n not in made.states]:
        raise DefinitionError(
            f"the filter measures {', '.join(lacking)}, which Odometry does not give",
            remedy="name the states with pose and twist, or let an observer estimate them "
            "(states=... of the filter)",
        )
    if keep.measured_disturbances:
        raise DefinitionError(
            f"the filter measures {', '.join(keep.measured_disturbances)}",
            expected="a filter of states alone: no message gives disturbances",
        )
    return made
