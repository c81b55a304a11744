"""`holdfast filter`: a safety filter as a process, sample by sample."""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from holdfast.commands.options import ANSWERED, NOT_ANSWERED, set_option
from holdfast.errors import OutputError
from holdfast.host.interruption import GRACE, end, postponed
from holdfast.host.streams import descriptor_of, has_reader, lines
from holdfast.studies.progress import bar

if TYPE_CHECKING:
    from holdfast.analysis.online.decision import DecisionRecord
    from holdfast.analysis.online.safety_filter import SafetyFilter

    Keeps = Callable[[DecisionRecord], None]

ROUTER = "tcp/localhost:7447"
MOST = 1000
"""Decisions that may wait for who reads them."""
LONGEST = 1 << 20
"""Bytes of a line."""
TICK = 0.1
"""Seconds after which a stream without lines is left, where that was asked for."""


@click.command("filter")
@click.argument("scenario")
@set_option
@click.option(
    "--patience",
    type=float,
    default=0.25,
    show_default=True,
    help="Largest age of a state, a command or a list of obstacles, in seconds.",
)
@click.option(
    "--log",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Append every decision to this file, one line each.",
)
@click.option("--ros2", is_flag=True, help="Run as a node of ROS 2, with rmw_zenoh.")
@click.option(
    "--router",
    help="With --ros2: the address of the router [default: tcp/localhost:7447].",
)
@click.option("--namespace", help="With --ros2: the namespace of the node [default: /].")
@click.option(
    "--mavlink",
    nargs=2,
    metavar="CONTROLLER VEHICLE",
    help="Run as a MAVLink component between two connections, such as udpin:127.0.0.1:14550 "
    "udpin:127.0.0.1:14560.",
)
def command(
    scenario: str,
    overrides: tuple[str, ...],
    patience: float,
    log: Path | None,
    ros2: bool,
    router: str | None,
    namespace: str | None,
    mavlink: tuple[str, str] | None,
) -> None:
    """Filter the commands of another controller by the safety filter of SCENARIO.

    The scenario has [law] external = true and a [safeguard] or [safety]. Standard input has one
    line of JSON for every sample, {"state": {...}, "command": {...}}, with values by name; "t" in
    seconds and the "disturbance" are optional. A filter with [obstacles] reads a list "obstacles",
    such as [{"disc": [x, y, radius], "velocity": [vx, vy]}]. Every line is answered at once with a
    decision on standard output: its "input" is the input for the vehicle.

    If the first line is no sample, the command ends; a later line that is no sample is answered
    with the fallback.

    With --ros2 or --mavlink samples and answers are messages, until Ctrl-C or SIGTERM, which are
    then the ordinary end. The decisions are on standard output all the same: holdfast monitor reads
    them.
    """
    if not ros2 and (router is not None or namespace is not None):
        raise click.UsageError("--router and --namespace are of --ros2; give it too")
    if ros2 and mavlink is not None:
        raise click.UsageError("--ros2 and --mavlink are two connections; give one")
    from holdfast.analysis.online.safety_filter import crossings_text
    from holdfast.scenario.load import load_scenario

    loaded = load_scenario(scenario, overrides)
    tally = Tally()
    with closing(Appended(log)) as file:
        with bar(f"{loaded.name}, preparing") as tell:
            keep = loaded.safety_filter(lambda fraction: tell("the kernel", fraction))
        remains = crossings_text(keep.crossings, keep.sample_time)
        if not ros2 and mavlink is None:
            status = serve_lines(keep, [tally, file], patience, remains)
            click.echo(f"holdfast: {tally}", err=True)
            sys.exit(status or (NOT_ANSWERED if file.trouble else ANSWERED))
        tell_of(remains)
        aside = Aside([shown, file])
        if mavlink is not None:
            serve_mavlink(keep, [tally, aside], patience, *mavlink)
        else:
            serve_ros2(keep, [tally, aside], patience, router or ROUTER, namespace or "/")
        whole = aside.ended()
        click.echo(f"holdfast: {tally}{aside}", err=True)
        if not whole:  # who reads does not, and waiting for that is no end
            end(NOT_ANSWERED)
    sys.exit(NOT_ANSWERED if file.trouble or aside.left_out else ANSWERED)


def tell_of(remains: str) -> None:
    """What may be crossed between samples, on standard error."""
    if remains:
        click.echo(f"holdfast: {remains}", err=True)


def serve_lines(
    keep: SafetyFilter, keepers: Sequence[Keeps], patience: float, remains: str = ""
) -> int:
    """Answer the lines of standard input until it ends; the exit status.

    keepers: called with every decision, after it was answered. remains: said after the first
    sample.
    """
    from holdfast.analysis.online.relay import SampleLines

    reader = None
    if keep.clearing is not None:  # with polygons
        from holdfast.planning.moving_obstacles import Obstacle

        reader = Obstacle.of_table
    samples, refused = SampleLines(keep, patience=patience, obstacle=reader), 0
    with postponed() as asked:
        for line in lines(descriptor_of(sys.stdin), TICK):
            if asked() or not has_reader(sys.stdout):
                break
            if line is None:
                continue
            record = samples.answer(line)
            sys.stdout.write(record.line() + "\n")
            sys.stdout.flush()
            tell_of(remains)
            remains = ""
            for keeps in keepers:
                keeps(record)
            if samples.refused:
                refused += 1
                click.echo(f"holdfast: {samples.refused}", err=True)
        return asked() or (NOT_ANSWERED if refused else ANSWERED)


def serve_ros2(
    keep: SafetyFilter, keepers: Sequence[Keeps], patience: float, router: str, namespace: str
) -> None:
    """A node of ROS 2 until Ctrl-C or SIGTERM."""
    from holdfast.interop.ros2 import Network, serve

    network = Network(connect=(router,))
    click.echo(f"holdfast: a node of ROS 2, which tries the router at {router}", err=True)
    serve(keep, said=each(keepers), network=network, namespace=namespace, patience=patience)


def serve_mavlink(
    keep: SafetyFilter, keepers: Sequence[Keeps], patience: float, controller: str, vehicle: str
) -> None:
    """A MAVLink component until Ctrl-C or SIGTERM."""
    from holdfast.interop.mavlink import SafetyComponent, commands_of, serve

    component = SafetyComponent(
        keep,
        commands_of(keep.system),
        controller=controller,
        vehicle=vehicle,
        patience=patience,
    )
    where = f"a controller at {controller} and a vehicle at {vehicle}"
    click.echo(f"holdfast: a component of MAVLink between {where}", err=True)
    click.echo(f"holdfast: messages: {serve(component, on_decision=each(keepers))}", err=True)


def each(keepers: Sequence[Keeps]) -> Keeps:
    """All of them, one after the other."""

    def tell(record: DecisionRecord) -> None:
        for keeps in keepers:
            keeps(record)

    return tell


def shown(record: DecisionRecord) -> None:
    """A decision on standard output."""
    sys.stdout.write(record.line() + "\n")
    sys.stdout.flush()


class Aside:
    """Tells others of decisions in a thread of its own, so that one who stalls stops no vehicle.

    left_out: the decisions that they were not told of, because `MOST` others waited.
    """

    def __init__(self, keepers: Sequence[Keeps]) -> None:
        self.kept, self.left_out = keepers, 0
        self._waiting: queue.Queue[DecisionRecord | None] = queue.Queue(MOST)
        self._thread = threading.Thread(target=self._tell, name="holdfast-aside", daemon=True)
        self._thread.start()

    def __call__(self, record: DecisionRecord) -> None:
        try:
            self._waiting.put_nowait(record)
        except queue.Full:
            self.left_out += 1

    def _tell(self) -> None:
        tell = each(self.kept)
        while (record := self._waiting.get()) is not None:
            tell(record)

    def ended(self) -> bool:
        """Whether all were told within `GRACE`."""
        with suppress(queue.Full):
            self._waiting.put(None, timeout=GRACE / 2)
        self._thread.join(GRACE / 2)
        return not self._thread.is_alive()

    def __str__(self) -> str:
        return f"; {self.left_out} not written, for nobody read them" if self.left_out else ""


class Tally:
    """How many decisions there were, and how many of each kind."""

    def __init__(self) -> None:
        self.samples, self.kinds = 0, Counter[str]()

    def __call__(self, record: DecisionRecord) -> None:
        self.samples += 1
        self.kinds[record.status] += 1
        if record.lost:
            self.kinds["lost"] += 1

    def __str__(self) -> str:
        kinds = {"changed": 0, "infeasible": 0, "lost": 0} | self.kinds
        shown = [f"{n} {k}" for k, n in kinds.items() if k not in ("passed", "no measurement")]
        return f"{self.samples} samples: {', '.join(shown)}"


class Appended:
    """A file that has every decision as soon as it was made; None is no file.

    A disk that is full does not stop a filter: `trouble` says what could not be written.
    Raises `OutputError` for a file that cannot be opened, or has something else.
    """

    def __init__(self, path: Path | None) -> None:
        self.trouble = ""
        if path is not None:
            self._check(path)
        try:
            self.file = open(path or os.devnull, "ab", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise OutputError(
                f"{path} cannot be written ({error.strerror})", remedy="choose another with --log"
            ) from None

    @staticmethod
    def _check(path: Path) -> None:
        """Refuse a file that has something else than decisions."""
        from holdfast.analysis.online.decision import DecisionRecord
        from holdfast.errors import SimulationError

        try:
            with path.open("rb") as file:
                if path.is_file() and (first := file.readline(LONGEST)):
                    DecisionRecord.read(first)
        except OSError:
            return  # a new file, or the opening says what is wrong
        except SimulationError as error:
            raise OutputError(
                f"{path} has something else: {error.cause}", remedy="choose another with --log"
            ) from None

    def close(self) -> None:
        """Close the file."""
        self.file.close()

    def __call__(self, record: DecisionRecord) -> None:
        if self.trouble:
            return
        try:
            self.file.write(f"{record.line()}\n".encode())
        except OSError as error:
            self.trouble = f"{self.file.name} has no more decisions ({error.strerror})"
            click.echo(f"holdfast: {self.trouble}", err=True)
