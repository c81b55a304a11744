"""Nodes of ROS 2: a safety filter, a simulated vehicle, a controller.

What a filter does is diagnostic_msgs/DiagnosticArray too. Samples follow a clock that only goes
forward.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypedDict, Unpack

from holdfast.analysis.online.controller import Plant
from holdfast.analysis.online.decision import DecisionRecord, Status
from holdfast.analysis.online.relay import Relay
from holdfast.analysis.online.safety_filter import SafetyFilter
from holdfast.arguments import checked
from holdfast.errors import DefinitionError, OutputError
from holdfast.host.interruption import ended_by_signals
from holdfast.interop.closing import Closing
from holdfast.interop.ros2.node import Network, Node, NodeName, Subscription
from holdfast.interop.ros_messages import ODOMETRY, Interface, MessageError, header, made

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

    keep: the filter. interface: how states and inputs stand in messages. odometry, nominal,
    command: other names of the topics. patience [s]: see `Relay`; a message counts as received at
    the sample that takes it. Fields of the command out of the plane of motion are passed on while
    commands come. The last command before it is closed is the filter's fallback.

    Messages of other types, without an attachment of rmw_zenoh, in another frame, or unreadable are
    refused: counted and said in the diagnostics, and not taken for a measurement or a command.

    Raises `DefinitionError` for a filter that needs more than Odometry gives, and what `Node` and
    `Relay` raise.
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
    ) -> None:
        self.interface = _fitting(interface, keep)
        self.relay = Relay(keep, patience=patience)
        topics = odometry, nominal, command
        super().__init__(name, namespace, network, keep.sample_time, topics)
        self._states = keep.measured_states
        self._rest: Mapping[str, float] = {}
        self._odometry = self.node.subscription(odometry, ODOMETRY)
        self._nominal = self.node.subscription(nominal, self.interface.command)
        self._command = self.node.publisher(command, self.interface.command)
        self._decisions = self.node.publisher("~/decisions", TEXT)
        self._diagnostics = Diagnostics(
            self.node, keep.system.name, {"odometry": self._odometry, "command": self._nominal}
        )

    def step(self, now: float) -> DecisionRecord:
        """Take what came, decide, and publish."""
        state = _newest(self._odometry, self.interface.state)
        if state is not None:
            self.relay.measured([state[n] for n in self._states], now)
        asked = _newest(self._nominal, self.interface.inputs)
        if asked is not None:
            inputs, self._rest = asked
            self.relay.commanded(inputs, now)
        record = self.relay.decide(now)
        rest = {} if record.lost else self._rest
        stamp = time.time_ns()
        self._command.send(self.interface.wrap(record.input, stamp, rest))
        self._decisions.send(made(TEXT, data=record.line()))
        self._diagnostics.tell(record, now, stamp, self.loop.skipped)
        return record

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

    Without a command for `patience` [s] its inputs are 0. Arguments as those of `FilterNode`.
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

    controller: a function of the states that Odometry gives, in the order of the system; it returns
    the inputs in their order. sample_time [s]: how often it looks for a message.
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


@checked
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


def serve(
    keep: SafetyFilter,
    *,
    said: Callable[[DecisionRecord], None] | None = None,
    seconds: float | None = None,
    **settings: Unpack[FilterOptions],
) -> None:
    """A `FilterNode` until Ctrl-C or SIGTERM, or for so many seconds.

    said: called with every decision. settings: those of `FilterNode`. Raises what that does.
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
