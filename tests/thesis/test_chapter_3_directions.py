"""Chapter 3 in every direction of the current: what `benchmarks/station_keeping.py` found.

Its numbers are in `benchmarks/station_keeping.json`. The page has them, and its extremes are
computed again here.
"""

import json
import math
import re
from functools import cache
from pathlib import Path

import largest_current
import numpy as np
import pytest
import station_keeping as study
from tqdm import tqdm

import holdfast as hf
from holdfast.scenario.load import load_scenario

ROOT = Path(__file__).parents[2]


@cache
def recorded():
    return json.loads((ROOT / "benchmarks/station_keeping.json").read_text("utf-8"))


def table_of_the_page():
    """The numbers of every row of the table of all directions, without the law and the speed."""
    lines = (ROOT / "docs/station_keeping.md").read_text("utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("| law | speed [m/s]")) + 2
    for line in lines[first:]:
        if not line.startswith("|"):
            return
        cells = line.strip("|").split("|")
        yield [
            float(n) for cell in cells[1:] for n in re.findall(r"[\d,]*\.?\d+", cell.split("of")[0])
        ]


def test_page_states_every_number_of_the_study():
    rows = recorded()["kinematic"]
    names = ("speed", "tail", "tail_max", "heading_share", "switches", "switches_max")
    names += ("dwell_min", "entry_max", "chattered")
    units = (1e-4, 1e-3, 1e-3, 0.01, 1, 1, 1e-3, 0.1, 1)
    page = list(table_of_the_page())
    assert len(page) == len(rows) == 12
    for stated, row in zip(page, rows, strict=True):
        for number, name, unit in zip(stated, names, units, strict=True):
            assert number == pytest.approx(row[name], abs=0.501 * unit), (row["law"], name)


def test_study_counts_a_million_runs_none_of_which_is_lost():
    rows = recorded()["kinematic"]
    by_law = {
        law: [r for r in rows if r["law"] == law] for law in dict.fromkeys(r["law"] for r in rows)
    }
    assert [sum(r["runs"] for r in own) for own in by_law.values()] == [600_000, 200_000, 200_000]
    assert [own[0]["directions"] for own in by_law.values()] == [300, 100, 100]
    assert {(r["starts"], len(by_law)) for r in rows} == {(500, 3)}
    assert all(r["entered"] == r["stayed"] == r["runs"] for r in rows)
    known, single, _ = by_law.values()
    assert sum(r["chattered"] for r in single) == 33
    assert min(r["dwell_min"] for r in known) == 0.015
    gained = [a["heading_share"] / b["heading_share"] for a, b in zip(known, single, strict=True)]
    assert [min(gained), max(gained)] == pytest.approx([1.2, 1.8], abs=0.05)
    cost = [a["tail"] - b["tail"] for a, b in zip(known, single, strict=True)]
    assert cost == pytest.approx([0.03] * 4, abs=0.003)


class Quiet:
    """A bar that shows nothing."""

    def update(self, _):
        pass


@cache
def law_of_the_study(told):
    system = hf.systems.drifting_unicycle()
    if told:
        return system, study.unconditional(hf.laws.hold_station(system))
    return system, study.unconditional(hf.laws.hold_station_unknown(system, current_bound=0.25))


def runs_of_the_study(direction, runs, seed, *, told=True, speed=study.FAST, fixed, **settings):
    system, law = law_of_the_study(told)
    return study.simulate(
        Quiet(), system, law, speed, direction, runs, box=2.0, told=told, fixed=fixed,
        seed=seed, horizon=60.0, substeps=1, **settings,
    )  # fmt: skip


@pytest.mark.heavy
@pytest.mark.parametrize("number", range(12))
def test_tail_in_the_worst_direction_is_that_of_the_study(number):
    """500 starts in the direction in which the study found the largest distance after 30 s."""
    row = recorded()["kinematic"][number]
    radius = float(re.search(r"r1 = ([\d.]+|r0)", row["law"])[1].replace("r0", "0.1"))
    seed = round((row["direction_of_tail_max"] + 180) / 360 * row["directions"])
    angle = 2 * math.pi * seed / row["directions"] - math.pi
    result = runs_of_the_study(
        (angle, angle), 500, seed, told=row["law"].startswith("known"), speed=row["speed"],
        fixed={"r1": radius}, sample_time=0.005, record_every=0.05,
    )  # fmt: skip
    found = hf.station_statistics(result, 0.1, settled=30.0)
    assert bool(found["entered"].all())
    assert float(found["tail_radius"].max()) == pytest.approx(row["tail_max"], abs=5e-4)


def tail_in_any_direction(r1=0.1, k2=5.0, sample_time=0.01, noise=False):
    """Median and 99.5 % of the tails of 400 runs, and the share of them that chatter."""
    result = runs_of_the_study(
        study.ANY, 400, 1, fixed={"r1": r1, "k2": k2, "k4": k2, "k5": k2}, sample_time=sample_time,
        record_every=max(0.01, sample_time), noise_uniform=study.NOISE if noise else {},
    )  # fmt: skip
    tail = hf.station_statistics(result, 0.1, settled=30.0)["tail_radius"].values
    return np.median(tail), np.percentile(tail, 99.5), result.outcomes["chattered"] / 400


@pytest.mark.heavy
def test_gain_radius_and_sample_time_make_the_tail_that_the_figure_shows():
    """At 0.22 m/s in any direction, one radius unless an exit radius is given."""
    _, far, chatter = tail_in_any_direction(k2=1.0, sample_time=0.001)
    assert far - 0.1 == pytest.approx(0.139, abs=0.002), "small gains leave the ball by 14 cm"
    assert chatter > 0.5, "most of the runs"
    fars = [tail_in_any_direction(k2=k2, sample_time=0.05)[1] for k2 in (1.0, 2.0, 5.0, 10.0, 20.0)]
    assert fars[0] > fars[1] > fars[2] > fars[3], "larger gains shrink the tail"
    assert fars[3] < fars[4], "until k Ts is 0.5"
    assert tail_in_any_direction(r1=0.11, noise=True)[2] > 0
    assert tail_in_any_direction(r1=0.115, noise=True)[2] == 0
    for k2 in (2.0, 5.0, 10.0):
        assert tail_in_any_direction(k2=k2)[0] == pytest.approx(0.103, abs=1e-3)
        assert tail_in_any_direction(k2=k2, sample_time=0.1)[0] == pytest.approx(0.121, abs=1e-3)
    assert tail_in_any_direction(k2=20.0, sample_time=0.1)[0] > 10, "k Ts = 2 loses the ball"


@pytest.mark.heavy
def test_weathervaning_needs_less_thrust_and_has_the_right_heading_only_by_chance():
    """200 runs of the full vehicle for each law and speed of the current, 0.05 to 0.6 m/s."""
    rows = list(study.marine(tqdm(disable=True), study.Counts()))
    assert [r["runs"] for r in rows] == [200] * 24
    small, large, vane = rows[:8], rows[8:16], rows[16:]
    thrust = [v["thrust"][1] / s["thrust"][1] for v, s in zip(vane, small, strict=True)]
    assert 1 / thrust[0] == pytest.approx(9, abs=0.5)
    assert thrust[-1] == pytest.approx(0.75, abs=0.03)
    assert max(r["tail"][2] for r in vane) < 1e-3
    assert [r["heading_share"][1] for r in vane] == pytest.approx([0.025] * 8, abs=0.001)
    for own, least, most in ((small, 0.07, 0.30), (large, 0.08, 0.38)):
        shares = [r["heading_share"][1] for r in own]
        assert [min(shares), max(shares)] == pytest.approx([least, most], abs=0.006)
    assert [r["tail"][2] for r in large[5:7]] == pytest.approx([0.86, 1.06], abs=0.01)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("limit", "borne", "lost"), [(0.55, 0.50, 0.56), (0.65, 0.59, 0.64), (0.7, 0.59, 0.64)]
)
def test_largest_current_that_the_full_vehicle_bears_depends_on_its_speed_limit(limit, borne, lost):
    """2,000 of 2,000 up to that current in any direction, and not all of 500 in a faster one."""
    for low, high, runs, kept in ((0.0, borne, 2000, True), (borne, lost, 500, False)):
        held = held_in(limit, low, high, runs)
        assert held.all() == kept


@pytest.mark.heavy
def test_vehicle_with_a_high_speed_limit_loses_a_few_starts_in_slow_currents():
    assert 6000 - held_in(0.8, 0.0, 0.18, 6000).sum() == pytest.approx(7, abs=2)


def held_in(limit, low, high, runs):
    """Which runs of ch3-dynamic enter the ball and stay within 36 cm for the last minute."""
    changes = [
        f"law.speed_limit={limit}", "system.current_limit=0.9",
        f"varied.draws.speed={{range = [{low}, {high}], unit = 'm/s'}}",
    ]  # fmt: skip
    result = load_scenario("ch3-dynamic", changes, runs=runs).run()
    found = hf.station_statistics(result, 0.1, settled=60.0)
    return found["entered"].values & (found["tail_radius"].values <= largest_current.HELD)


def test_full_thrust_drives_the_vehicle_at_a_metre_a_second_and_a_fifth():
    assert largest_current.full_ahead() == pytest.approx(1.21, abs=0.005)
