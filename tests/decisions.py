"""Decisions of a filter that keeps a camera's target in view, and made-up ones."""

import json
import math

import holdfast as hf

START = [-1.3, 0.75, -0.35, 0, 0, 0]
NAMES = ("x", "y", "psi", "u", "v", "r")


def pd(state):
    x, y, psi, u, _, r = state
    return [4 * (-0.5 - x) - 6 * u, -0.6 * psi - 1.2 * y - 0.4 * r]


def camera_filter(**settings):
    vehicle, view = hf.systems.marine_vehicle(), hf.regions.camera_view()
    return vehicle, hf.SafetyFilter(vehicle, view, gains=(1.5, 8), **settings)


def drive(relay, boat, seconds, command_until=math.inf, measure_until=math.inf):
    records = []
    for k in range(round(seconds / 0.02)):
        now = 100.0 + k * 0.02  # the clock of a receiver begins anywhere
        if now - 100.0 < measure_until:
            relay.measured(boat.state, now)
        if now - 100.0 < command_until:
            relay.commanded(pd(boat.state), now)
        records.append(relay.decide(now))
        boat.step(records[-1].input)
    return records


def sample(state):
    """The line of `holdfast filter` for that state, with the command of the controller."""
    push, turn = pd(state)
    said = dict(zip(NAMES, map(float, state), strict=True))
    return json.dumps({"state": said, "command": {"tau_u": push, "tau_r": turn}}) + "\n"


def record(t, status="passed", *, change=0.0, lost="", value=0.5, slack=0.0, why="", gave_way=()):
    return hf.DecisionRecord(
        t=t, status=status, lost=lost, state={"x": t}, command={"u": 1.0, "w": 0.0},
        input={"u": 1.0 + change, "w": 0.0}, actuators={}, overruled=status != "passed",
        slack=slack, value=value, gave_way=gave_way, why=why,
    )  # fmt: skip


def stream(pattern, step=0.1, **of_changed):
    """A sample for every letter: p passed, c changed."""
    return [
        record(k * step, "changed", change=0.2, **of_changed) if c == "c" else record(k * step)
        for k, c in enumerate(pattern)
    ]


def messages(path, topic=None):
    """Topic, time and content of every message, in the order of their times; checksums are checked."""
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in reader.iter_messages()
            if topic in (None, channel.topic)
        ]
