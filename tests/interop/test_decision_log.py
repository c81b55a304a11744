"""Decisions as MCAP, read by the reader of the format."""

import json
import math

import pytest

import holdfast as hf
from holdfast.analysis.online.decision import Interventions
from holdfast.errors import OutputError
from holdfast.presentation.text.interventions import event_line
from tests.decisions import camera_filter, drive, messages, record

pytest.importorskip("mcap")
from mcap.reader import make_reader

from holdfast.interop.decision_log import ERROR, INFO, WARNING, DecisionLog


def fits(value, schema):
    """Whether a value is of its JSON schema, with the few words that ours have."""
    kind = schema["type"]
    if kind == "object":
        known, other = schema.get("properties", {}), schema.get("additionalProperties")
        return isinstance(value, dict) and all(
            fits(v, known.get(k) or other) for k, v in value.items()
        )
    if kind == "array":
        return isinstance(value, list) and all(fits(v, schema["items"]) for v in value)
    if kind == "boolean":
        return isinstance(value, bool)
    if kind == "string":
        return isinstance(value, str)
    if kind == "integer":
        return type(value) is int and value >= schema["minimum"]
    return kind == "number" and type(value) in (int, float)


def written(path, records):
    watch, events = Interventions(), []
    with DecisionLog(path) as log:
        for one in records:
            log.decided(one)
            for event in watch.add(one):
                log.happened(event, event_line(event))
                events.append(event)
        for event in watch.end():
            log.happened(event, event_line(event))
            events.append(event)
    return events


def test_decisions_and_interventions_return_from_the_file(tmp_path):
    vehicle, keep = camera_filter()
    boat = hf.Plant(vehicle, [-1.3, 0.75, -0.35, 0, 0, 0])
    records = drive(hf.Relay(keep), boat, 3, command_until=1.5, measure_until=2.0)
    events = written(tmp_path / "a.mcap", records)
    found = messages(tmp_path / "a.mcap", "/holdfast/decision")
    assert [stamp for _, stamp, _ in found] == [round(r.t * 1e9) for r in records]
    for (_, _, said), one in zip(found, records, strict=True):
        wanted = json.loads(one.line())
        for name in ("state", "command", "input", "actuators"):
            wanted[name] = {k: v for k, v in wanted[name].items() if v is not None}
        assert said == {k: v for k, v in wanted.items() if v is not None}
    ended = [e.intervention for e in events if e.what == "ended"]
    found = messages(tmp_path / "a.mcap", "/holdfast/intervention")
    assert [said["begins"] for _, _, said in found] == [i.begins for i in ended]
    assert [said["lost"] for _, _, said in found] == [list(i.lost) for i in ended]
    assert found[-1][1] == round(ended[-1].ends * 1e9)


def test_sentences_have_the_levels_and_the_schema_that_foxglove_shows(tmp_path):
    records = [
        record(1.25),
        record(1.5, "changed", why="changed u"),
        record(1.75, "infeasible", why="no input"),
        record(2.0),
        record(3.0),
    ]
    written(tmp_path / "a.mcap", records)
    said = [s for _, _, s in messages(tmp_path / "a.mcap", "/holdfast/log")]
    assert [s["level"] for s in said] == [WARNING, ERROR, INFO]
    assert said[0]["timestamp"] == {"sec": 1, "nsec": 500_000_000}
    assert "changed u" in said[0]["message"]
    with open(tmp_path / "a.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    names = {
        c.topic: (summary.schemas[c.schema_id].name, c.message_encoding)
        for c in summary.channels.values()
    }
    assert names == {
        "/holdfast/decision": ("holdfast.Decision", "json"),
        "/holdfast/intervention": ("holdfast.Intervention", "json"),
        "/holdfast/log": ("foxglove.Log", "json"),
    }


def test_every_message_is_of_the_schema_of_its_channel(tmp_path):
    records = [
        record(0.0, lost="command", value=math.nan),
        record(0.1, "no measurement", lost="measurement", value=math.nan),
        record(0.2, "infeasible", change=0.3, slack=math.inf, gave_way=("wall",)),
    ]
    written(tmp_path / "a.mcap", records)
    with open(tmp_path / "a.mcap", "rb") as file:
        count = 0
        for schema, _, message in make_reader(file).iter_messages():
            assert schema.encoding == "jsonschema"
            assert fits(json.loads(message.data), json.loads(schema.data)), message.data
            count += 1
    assert count == 3 + 3 + 6  # decisions, interventions, what began and ended


def test_file_that_exists_and_time_that_mcap_has_not_are_refused(tmp_path):
    with DecisionLog(tmp_path / "a.mcap") as log:
        for t in (-1.0, 2e10, math.nan):
            with pytest.raises(OutputError, match="MCAP has no time"):
                log.decided(record(t))
        log.decided(record(1.7e9))
    assert [stamp for _, stamp, _ in messages(tmp_path / "a.mcap")] == [1_700_000_000_000_000_000]
    with pytest.raises(OutputError, match="exists already; choose another file"):
        DecisionLog(tmp_path / "a.mcap")
    with pytest.raises(OutputError, match="cannot be written"):
        DecisionLog(tmp_path / "nowhere" / "a.mcap")
