"""Rest in a current that varies in place and time: 600 starts of the VideoRay in every case."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.maths.control.barrier_conditions import viability_conditions
from holdfast.maths.definitions.variation import Varied
from holdfast.maths.expressions.functions import magnitude
from tests.runs_at_rest import settled

VEERING = (
    "varied.draws.veering=[-0.3,0.3]",
    "disturbance.Vx=speed*cos(direction + veering*t)",
    "disturbance.Vy=speed*sin(direction + veering*t)",
)
EDDIES = (
    "varied.draws.phase_x=[-3.14159,3.14159]",
    "varied.draws.phase_y=[-3.14159,3.14159]",
    "disturbance.Vx=speed*(0.7*cos(direction) + 0.3*sin(2*y + phase_x))",
    "disturbance.Vy=speed*(0.7*sin(direction) + 0.3*sin(2*x + phase_y))",
)
SHEAR = (
    "disturbance.Vx=speed*cos(direction)*(1 + tanh(y))/2",
    "disturbance.Vy=speed*sin(direction)*(0.5 - x/4)",
)
GROWTH = {VEERING: 0.3, EDDIES: 0.6}
"""The largest rate of what the vehicle feels over the speed of the current, in 1/s."""


def of_set(rate=None, bandwidth=40, u=0.005, r=0.1):
    """The observer of a set, of currents that are constant or change by `rate` [m/s^2]."""
    more = f",rate_bounds={{Vx={rate},Vy={rate}}}" if rate else ""
    return (
        f'observer={{measured=["x","y","psi"],bandwidth={bandwidth},error_bounds={{x="1 mm",'
        f'y="1 mm",psi="1 mrad",u={u},v={u},r={r}}}{more}}}'
    )


def in_view(speed, *changes, horizon=150):
    """How many of 600 starts stay in view, at a current of so many m/s."""
    given = [
        f"varied.draws.speed=[{speed},{speed}]", f"run.horizon={horizon}",
        f"run.record_every={horizon}", *changes,
    ]  # fmt: skip
    found = hf.load_scenario("inspection-current", given).run().dataset["outcome"].values
    return int((found != hf.Outcome.LEFT).sum())


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("current", "speed", "counts"),
    [
        (VEERING, 0.05, (598, 594, 596)),
        (VEERING, 0.1, (591, 572, 569)),
        (EDDIES, 0.05, (599, 600, 600)),
        (EDDIES, 0.1, (599, 600, 600)),
    ],
)
def test_starts_that_stay_in_view_in_a_current_that_varies(current, speed, counts):
    """The current measured; the pose alone and a set that follows it; a set of a constant one."""
    sets = of_set(GROWTH[current] * speed), of_set()
    assert (
        in_view(speed, *current),
        *(in_view(speed, *current, observer) for observer in sets),
    ) == counts


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("current", "speed", "counts"),
    [(VEERING, 0.05, (600, 600)), (VEERING, 0.1, (592, 599)), (EDDIES, 0.1, (600, 600))],
)
def test_starts_that_stay_in_view_in_a_current_that_varies_at_100_hz(current, speed, counts):
    observer = of_set(GROWTH[current] * speed, bandwidth=90)
    often = "run.sample_time=0.01"
    assert (in_view(speed, often, *current), in_view(speed, often, *current, observer)) == counts


def turning(period, speed):
    """How many stay in view for 300 s, and how far they are from the place at rest with the bow.

    The median of all samples of the second half at which the vehicle has the bow to the current and
    the current is 7 degrees or more off the wall.
    """
    rate = 2 * math.pi / period
    given = [
        f"varied.draws.speed=[{speed},{speed}]", "run.horizon=300", "run.record_every=1",
        f"disturbance.Vx=speed*cos(direction + {rate}*t)",
        f"disturbance.Vy=speed*sin(direction + {rate}*t)",
    ]  # fmt: skip
    data = hf.load_scenario("inspection-current", given).run().dataset
    kept = data["outcome"].values != hf.Outcome.LEFT
    felt = data["disturbance"].values[kept][:, 150:]
    x, y = np.moveaxis(data["state"].values[kept][:, 150:, :2], -1, 0)
    along = np.arctan(felt[..., 1] / felt[..., 0])
    away = np.hypot(x + 1.2 * np.cos(along), y + 1.2 * np.sin(along))
    counted = (felt[..., 0] < 0) & (np.abs(along) < math.radians(83))
    return int(kept.sum()), float(np.median(away[counted]))


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "period", "count", "away"),
    [
        (0.05, 1200, 599, 0.060), (0.05, 600, 600, 0.120), (0.05, 300, 600, 0.239),
        (0.1, 1200, 599, 0.048), (0.1, 600, 489, 0.095), (0.1, 300, 255, 0.191),
    ],
)  # fmt: skip
def test_starts_that_stay_in_view_in_a_current_that_turns_once_and_how_far_they_lag(
    speed, period, count, away
):
    found = turning(period, speed)
    assert found[0] == count
    assert found[1] == pytest.approx(away, abs=0.001)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "bow", "stern"),
    [(0.05, (600, 0.17), (600, 0.16)), (0.1, (600, 0.14), (600, 0.17))],
)
def test_starts_that_follow_a_swing_of_60_degrees_off_the_wall(speed, bow, stern):
    """To both sides of a current away from the wall, and to the wall, in 300 s: in view, lag."""
    for middle, wanted in (("pi", bow), ("0", stern)):
        way = f"{middle} + pi/3*sin(2*pi*t/300 + phase)"
        given = [
            "run.horizon=300", "run.record_every=1", "goal=",
            f"varied.draws={{speed=[{speed},{speed}],phase=[-3.14159,3.14159]}}",
            f"disturbance.Vx=speed*cos({way})", f"disturbance.Vy=speed*sin({way})",
        ]  # fmt: skip
        data = hf.load_scenario("inspection-current", given).run().dataset
        kept = data["outcome"].values != hf.Outcome.LEFT
        felt = data["disturbance"].values[kept][:, 150:]
        x, y = np.moveaxis(data["state"].values[kept][:, 150:, :2], -1, 0)
        along = np.arctan(felt[..., 1] / felt[..., 0])
        away = float(np.median(np.hypot(x + 1.2 * np.cos(along), y + 1.2 * np.sin(along))))
        assert (int(kept.sum()), round(away, 2)) == wanted


@pytest.mark.heavy
@pytest.mark.parametrize(("speed", "count"), [(0.05, 595), (0.1, 599)])
def test_starts_that_stay_in_view_in_a_shear(speed, count):
    assert in_view(speed, *SHEAR, horizon=300) == count


def against_the_worst(speed, *changes):
    """How many of 600 stay in view for 60 s while the current pushes to the nearest constraint.

    d = V grad c / |grad c| for the largest c of the region: it jumps wherever another c is largest.
    """
    given = [
        "run.horizon=60", "run.record_every=60", "run.switch_limit=100000",
        f"system.current_limit={speed}", *changes,
    ]  # fmt: skip
    s = hf.load_scenario("inspection-current", given)
    gradient = [s.region.worst.diff(hf.symbol(n)) for n in ("x", "y")]
    _, worst = s.system.disturbance_bounds.support(gradient, 1)
    field = dict(zip(("Vx", "Vy"), worst, strict=True))
    s = replace(s, disturbance=field, varied=Varied(), goal=None)
    return int((s.run().dataset["outcome"].values != hf.Outcome.LEFT).sum())


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "counts"),
    [(0.02, (582, 590, 588)), (0.05, (568, 513, 324)), (0.1, (573, 428, 573))],
)
def test_starts_that_stay_in_view_in_the_worst_current_within_its_bounds(speed, counts):
    """Measured; the whole of the bounds counted at every sample; a set of a constant current."""
    sets = of_set(20), of_set()
    found = against_the_worst(speed), *(against_the_worst(speed, one) for one in sets)
    assert found == counts


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("speed", "usual", "tight"),
    [
        (0.1, (600, 543, 556, 543), (600, 564, 556, 554)),
        (0.15, (600, 528, 556, 528), (600, 556, 556, 547)),
        (0.2, (597, 466, 556, 466), (599, 518, 556, 511)),
    ],
)
def test_starts_that_come_to_rest_from_the_pose_alone_at_100_hz(speed, usual, tight):
    """The bounds of 50 Hz, and those that hold at 100 Hz: 1 mm/s and 0.03 rad/s."""
    for bounds, counts in (((0.005, 0.1), usual), ((0.001, 0.03), tight)):
        observer = of_set(bandwidth=90, u=bounds[0], r=bounds[1])
        found = settled(speed, "run.record_every=150", "run.sample_time=0.01", observer)
        assert found == counts


@pytest.mark.heavy
def test_shipped_scenarios_stay_in_view_and_come_to_rest_from_most_starts():
    """Those with eddies all the time, from the pose alone; in the tide for its first minute."""
    eddies = hf.load_scenario("inspection-eddy", ["run.record_every=150"], 64).run().outcomes
    assert eddies["left region"] == 0
    assert eddies["reached goal"] > 45
    tide = hf.load_scenario("inspection-tide", ["run.horizon=60"], 64).run()
    assert tide.outcomes["left region"] <= 1
    felt = tide.dataset["disturbance"].values
    assert np.abs(np.diff(felt, axis=1)).max() < 0.1 * 2 * math.pi / 1200 * 1.001


@pytest.mark.heavy
@pytest.mark.parametrize(("speed", "count"), [(0.05, 593), (0.1, 592)])
def test_rate_of_the_current_in_the_conditions_of_the_filter_moves_its_boundary_by_a_millimetre(
    speed, count
):
    """d2c/dt2 has the term (d(dc/dt)/dd) dd/dt, at most rho |d(dc/dt)/dd|: counted, as it is not."""
    rho = GROWTH[VEERING] * speed
    s = hf.load_scenario(
        "inspection-current",
        [f"varied.draws.speed=[{speed},{speed}]", "run.record_every=150", *VEERING],
    )
    gains = {p.name: p.value for p in s.law.parameters}
    assert rho / (gains["kappa1"] * gains["kappa2"]) < 1e-3
    added = [
        rho * sp.Add(*(magnitude(c.rate.diff(d.symbol)) for d in s.system.disturbances))
        for c in viability_conditions(s.system, s.region)
    ]

    def counted(law, name=""):
        guard = law.safeguard
        offsets = list(guard.offsets)
        for k, more in enumerate(added):
            offsets[guard.hard + k] -= more
        return replace(law, safeguard=replace(guard, offsets=tuple(offsets)))

    found = replace(s, law=s.law.map_laws(counted, s.law.name)).run().dataset["outcome"].values
    assert int((found != hf.Outcome.LEFT).sum()) == count


@pytest.mark.heavy
def test_starts_in_a_tide_of_twenty_minutes_that_stay_in_view_and_are_at_rest_after_ten():
    found = hf.load_scenario("inspection-tide", ["run.record_every=600"]).run().outcomes
    assert (200 - found["left region"], found["reached goal"]) == (191, 157)


@pytest.mark.heavy
def test_starts_among_eddies_that_come_to_rest_from_the_pose_alone():
    found = hf.load_scenario("inspection-eddy", ["run.record_every=150"]).run().outcomes
    assert (found["left region"], found["reached goal"]) == (0, 169)
