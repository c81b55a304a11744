"""When a filter intervened, and why: intervals of its decisions."""

import json
import math

import pytest

import holdfast as hf
from holdfast.analysis.online.decision import Interventions
from holdfast.errors import SimulationError
from tests.decisions import camera_filter, drive, record, stream


def seen(records, gap=0.5):
    """All events, and what saw them."""
    watch = Interventions(gap)
    events = [e for r in records for e in watch.add(r)]
    return [*events, *watch.end()], watch


def intervals(events):
    return [
        (round(e.intervention.begins, 9), round(e.intervention.ends, 9))
        for e in events
        if e.what == "ended"
    ]


def test_input_is_held_until_the_next_sample():
    events, watch = seen(stream("ppcppppppppp"))
    assert intervals(events) == [(0.2, 0.3)]
    assert watch.summary()["intervened"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("pattern", "gap", "found"),
    [
        ("ccppcc" + 9 * "p", 0.5, [(0.0, 0.6)]),
        ("ccppcc" + 9 * "p", 0.15, [(0.0, 0.2), (0.4, 0.6)]),
        ("cpcpc" + 9 * "p", 0.0, [(0.0, 0.1), (0.2, 0.3), (0.4, 0.5)]),
        ("ccc" + 9 * "p", 0.0, [(0.0, 0.3)]),
        ("pppppppccc", 0.5, [(0.7, 0.9)]),
        ("ppppppp", 0.5, []),
    ],
)
def test_interventions_nearer_than_the_gap_are_one(pattern, gap, found):
    assert intervals(seen(stream(pattern), gap)[0]) == found


def test_slow_stream_has_the_same_intervals_as_a_fast_one():
    """Samples in a row belong together, however long each of them is held."""
    assert intervals(seen(stream("pcccpppp", step=5.0))[0]) == [(5.0, 20.0)]


def test_intervention_is_told_when_it_begins_grows_graver_and_ends():
    records = [
        record(0.0),
        record(0.1, "changed", change=-0.3, why="changed u: 'wall' is 0.2 m away", value=0.2),
        record(0.2, "changed", change=0.1, value=0.1),
        record(0.3, "infeasible", why="no input: 'rail' gave way", slack=2.0, gave_way=("rail",),
               value=-0.1),
        record(0.4, "changed", value=0.3),
        record(0.5),
        record(1.2),
    ]  # fmt: skip
    events, watch = seen(records)
    assert [(e.what, e.t) for e in events] == [("began", 0.1), ("graver", 0.3), ("ended", 0.5)]
    of = events[-1].intervention
    assert (of.status, of.kind, of.samples) == ("infeasible", "infeasible", 4)
    assert of.constraints == ("wall", "rail")
    assert of.changes == {"u": pytest.approx(-0.3)}
    assert (of.value, of.slack) == (-0.1, 2.0)
    assert of.why == "no input: 'rail' gave way"
    assert watch.current is None
    said = watch.summary()
    assert said["worst_value"] == {"value": -0.1, "t": 0.3}
    assert said["share"] == {"passed": 3 / 7, "changed": 3 / 7, "infeasible": 1 / 7}
    assert said["longest_intervention"]["duration"] == pytest.approx(0.4)


def test_what_is_lost_is_named_beside_the_status():
    nothing = math.nan
    records = [
        record(0.0, lost="command", why="no command for 0.3 s: the filter's fallback is taken"),
        record(0.1, "changed", lost="command", change=0.2),
        record(0.2, "no measurement", lost="measurement", value=nothing),
        record(0.3, "not a number", value=nothing),
    ]
    events, watch = seen(records)
    what = ["began", "graver", "ended", "began", "ended", "began", "ended"]
    assert [e.what for e in events] == what
    found = [e.intervention for e in events if e.what == "ended"]
    assert [of.kind for of in found] == ["no command, changed", "no measurement", "not a number"]
    assert [of.begins for of in found] == [0.0, 0.2, 0.3]
    assert found[0].value == 0.5
    assert watch.summary()["lost"] == {"command": 0.5, "measurement": 0.25}
    lost = seen([record(0.0, lost="command")])[0][0].intervention
    assert lost.kind == "no command"


def test_time_that_goes_back_begins_a_new_session():
    events, watch = seen([*stream("ppcc"), *stream("pcp")])
    assert intervals(events) == [(0.2, 0.3), (0.1, 0.2)]
    assert (watch.sessions, watch.samples) == (2, 7)
    assert watch.duration == pytest.approx(0.3 + 0.2)


def test_silence_of_the_stream_is_measured():
    _, watch = seen([record(0.0), record(0.1), record(3.1), record(3.2)])
    assert watch.summary()["longest_silence"] == pytest.approx(3.0)


def test_stream_without_any_decision_has_a_summary():
    said = seen([])[1].summary()
    assert (said["samples"], said["interventions"], said["share"]) == (0, 0, {})
    assert "worst_value" not in json.loads(json.dumps(said))


def test_time_or_gap_that_is_no_number_is_refused():
    with pytest.raises(SimulationError, match="time of a decision is nan"):
        Interventions().add(record(math.nan))
    for gap in (-0.1, math.nan, math.inf):
        with pytest.raises(SimulationError, match="the gap is"):
            Interventions(gap)


def test_intervals_of_a_vehicle_hold_every_sample_at_which_the_filter_intervened():
    vehicle, keep = camera_filter()
    boat = hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0])
    records = drive(hf.Relay(keep), boat, 6, command_until=4.0)
    events, watch = seen(records, gap=0.1)
    found = [e.intervention for e in events if e.what == "ended"]
    for r in records:
        assert not r.intervened or any(i.begins <= r.t <= i.ends for i in found)
    assert sum(i.samples for i in found) == sum(r.intervened for r in records)
    assert {i.kind for i in found} >= {"changed"}
    assert found[-1].lost == ("command",)
    assert watch.summary()["worst_value"]["value"] == min(r.value for r in records)
