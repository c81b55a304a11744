"""Laws from value functions: what a kernel promises is what the closed loop does."""

import hashlib
import math

import numpy as np
import pytest

import holdfast as hf
from holdfast.analysis.safety.safety_filter import decided
from holdfast.analysis.safety.sampled_value import sampled_value
from holdfast.analysis.safety.validation import CONSTANT, SWINGING, SWITCHING, schedules
from holdfast.errors import DefinitionError, SimulationError
from holdfast.execution.simulation.settings import SafeguardAnswer
from tests.carts import BOX, STATES, WALLS, U, V, X, cart, swinging


@pytest.fixture(scope="module")
def kernel():
    system = cart()
    return hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, 81), horizon=6)


@pytest.mark.heavy
def test_every_state_of_the_kernel_stays_whatever_pushes_it(kernel):
    """The exact kernel brakes at 1 - 0.5; every start against every push that was thought of."""
    promise = hf.check_promise(cart(), kernel, WALLS, runs=200, horizon=20, seed=3)
    assert [t.what for t in promise.inside] == [
        "every disturbance tried",
        "the gradient of the value",
        "the gradient of the constraints",
        "constant extremes",
        "constants within the bounds",
        "switching extremes",
        "random swings",
        "restarts from the nearest starts",
    ]
    assert promise.held
    assert promise.confirmed
    assert promise.verdict == ""
    assert promise.beaten == ()
    assert all(t.kept.value == 1.0 and t.excursion < 0 for t in promise.inside)
    assert 0.5 < promise.share < 0.95
    assert promise.outside.kept.count == 0
    assert promise.outside.excursion > 0


@pytest.mark.heavy
def test_filtered_law_keeps_the_promise_too(kernel):
    promise = hf.check_promise(cart(), kernel, WALLS, law=swinging(), runs=400, horizon=20)
    assert promise.held
    assert promise.law == "swing, kept safe"
    alone = hf.simulate(
        cart(), swinging(), starts=[[0.5, 0.3]], region=WALLS, horizon=20
    ).outcomes  # fmt: skip
    assert alone["left region"] == 1


def test_filter_leaves_the_law_alone_well_inside_and_takes_over_at_the_boundary(kernel):
    kept = hf.safety_law(cart(), kernel, swinging(), rate=2.0)
    result = hf.simulate(cart(), kept, starts=[[0.0, 0.0], [0.95, 0.2]], region=WALLS, horizon=0.8)
    asked = 0.9 * np.sin(result.dataset["time"].values)
    given = result.dataset["input"].values[:, :, 0]
    assert np.abs(given[0] - asked).max() < 1e-9
    assert given[1, 0] < -0.9
    value = result.dataset["signal"].sel(signal_name="value").values
    of_kernel = kernel.at([[0.0, 0.0]])[0]
    assert of_kernel - 0.1 < value[0, 0] <= of_kernel, "what held inputs keep is less"
    data = result.dataset
    assert data["signal"].attrs["value_of_kernel"] == "value"
    assert data["signal_unit"].values.tolist() == [kernel.dataset.attrs["value_unit"]]
    assert data["nominal"].values[0, :, 0] == pytest.approx(asked, abs=1e-12)
    answers = data["safeguard"].values
    assert (answers[0] == SafeguardAnswer.KEPT).all()
    assert answers[1, 0] != SafeguardAnswer.KEPT
    assert np.array_equal(answers == SafeguardAnswer.INFEASIBLE, data["slack"].values > 0)
    assert data["slack"].attrs["units"] == kernel.dataset.attrs["value_unit"]


def test_margin_for_a_held_input_is_what_a_sample_can_lose(kernel):
    """V = 1 - max(|x|, |x + v |v||) falls at up to 4 |v|: |u + d| is 1.5, |dV/dv| is 2 |v|.

    Most at the corner (-1, sqrt 2) of the kernel, from which the stencil of three nodes to either
    side sees one branch of V only beyond three nodes.
    """
    small, large = (hf.sampled_margin(cart(), kernel, s) for s in (0.01, 0.02))
    assert large == pytest.approx(2 * small)
    fastest, node = math.sqrt(2), kernel.grid.axes[1].step
    assert 4 * (fastest - 3 * node) < large / 0.02 <= 4 * fastest


@pytest.mark.heavy
def test_held_input_loses_nothing_at_any_sample_time(kernel):
    for sample_time in (0.01, 0.05, 0.1):
        margin = hf.sampled_margin(cart(), kernel, sample_time)
        promise = hf.check_promise(
            cart(), kernel, WALLS, law=swinging(), runs=200, horizon=10,
            sample_time=sample_time, margin=margin,
        )  # fmt: skip
        assert promise.held, sample_time


def test_value_at_several_times_is_followed_down():
    """No input can hold a falling point, but until T it can be late: V at the time that is left."""
    system = hf.System(
        "drift", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V, "v": U - 2},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    grid = hf.grid(system, {"x": (-1.3, 1.3), "v": (-2.5, 2.5)}, 81)
    times = np.linspace(0.1, 1.5, 15)
    kernel = hf.viability_kernel(system, WALLS, grid, 1.5, times=times)
    assert not kernel.dataset.attrs["converged"]
    promise = hf.check_promise(system, kernel, WALLS, runs=300)
    assert promise.held
    assert promise.outside.kept.count == 0
    with pytest.raises(SimulationError, match="has not converged"):
        hf.check_promise(system, kernel, WALLS, horizon=2.0)


def disc(name, radius):
    near = hf.Inequality("near", (X**2 + V**2) ** 0.5 - radius, "m")
    return hf.Region(name, STATES, (near,), empirical="a disc of numbers")


def test_basin_reaches_its_goal():
    system = hf.System(
        "line", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V, "v": U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    goal = disc("goal", 0.2)
    grid = hf.grid(system, {"x": (-1.3, 1.3), "v": (-1.5, 1.5)}, 81)
    basin = hf.capture_basin(
        system, goal, WALLS, grid, 2.0, times=np.linspace(0.1, 2.0, 20), arrival_steps=0
    )
    promise = hf.check_promise(system, basin, WALLS, goal=goal, runs=300)
    assert promise.inside[0].what == "no disturbance"
    assert promise.inside[0].kept.value == 1.0
    assert promise.outside.kept.value < 0.05


@pytest.mark.few("random swings")
@pytest.mark.parametrize("kind", [CONSTANT, SWITCHING, SWINGING])
def test_scheduled_current_is_at_the_rim_of_its_ball(kind):
    vehicle = hf.promote(hf.systems.marine_vehicle(), ("u", "r"), hf.Box((-1, -1), (1, 1)))
    found = schedules(vehicle)
    varied = found.drawn(kind, horizon=3.0, sample_time=0.02)
    generator = np.random.default_rng(0)
    headings = set()
    for _ in range(20):
        at = {hf.symbol(n): generator.uniform(*r) for n, r in varied.draws.items()}
        at |= {hf.symbol("current_limit"): 0.5}
        early, late = (
            np.array([float(e.subs(at | {hf.TIME: t})) for e in found.expressions.values()])
            for t in (0.1, 2.9)
        )
        assert np.hypot(*early) == pytest.approx(0.5, abs=1e-6)
        assert (kind != CONSTANT) or early == pytest.approx(late)
        headings.add(round(float(np.arctan2(early[1], early[0])), 3))
    assert len(headings) > 10, "directions are spread"


def test_scheduled_push_is_an_extreme_of_its_box_and_switches():
    found = schedules(cart())
    at = dict.fromkeys(found.drawn(SWITCHING, 3.0, 0.02).draws, 0.0) | {
        "schedule_gain": 1e6, "schedule_amplitude_0": 1.0, "schedule_pace_0": 1.0,
    }  # fmt: skip
    (push,) = (e.subs({hf.symbol(n): v for n, v in at.items()}) for e in found.expressions.values())
    pushes = {round(float(push.subs(hf.TIME, t)), 6) for t in np.linspace(0.05, 3, 13)}
    assert pushes == {-0.5, 0.5}


def test_what_is_no_value_of_this_system_is_refused(kernel):
    other = hf.System(
        "other", STATES, cart().inputs, {"x": V, "v": U}, input_bounds=hf.Box((-1,), (1,))
    )
    with pytest.raises(SimulationError, match="belongs to system 'cart'"):
        hf.safety_law(other, kernel)
    invariant = hf.invariance_kernel(cart(), WALLS, hf.grid(cart(), BOX, 21), 0.2)
    with pytest.raises(SimulationError, match="invariance-kernel"):
        hf.safety_law(cart(), invariant)
    with pytest.raises(SimulationError, match="rate 100"):
        hf.safety_law(cart(), kernel, swinging(), rate=100.0)
    guarded = hf.safety_law(cart(), kernel, swinging())
    with pytest.raises(DefinitionError, match="safeguard already"):
        hf.safety_law(cart(), kernel, guarded)


def test_value_of_a_vehicle_with_other_parameters_is_refused():
    k = hf.Parameter("k", "1/s", "", value=1.0)

    def system(value):
        return hf.System(
            "tank", STATES[:1], (hf.Quantity("u", "m/s"),), {"x": U - k.symbol * X},
            parameters=(hf.Parameter("k", "1/s", "", value=value),), input_bounds=hf.Box((-1,), (1,)),
        )  # fmt: skip

    grid = hf.grid(system(1.0), {"x": (-1.3, 1.3)}, 41)
    found = hf.viability_kernel(system(1.0), WALLS, grid, 1.0)
    hf.safety_law(system(1.0), found)
    with pytest.raises(SimulationError, match="computed with k = 1"):
        hf.safety_law(system(2.0), found)


@pytest.mark.heavy
def test_converged_kernel_at_several_times_is_kept_by_its_last():
    """A figure of how it shrinks does not change the law."""
    grid = hf.grid(cart(), BOX, 81)
    found = hf.discriminating_kernel(cart(), WALLS, grid, 6, times=np.linspace(0.5, 6, 12))
    assert found.dataset.attrs["converged"]
    promise = hf.check_promise(cart(), found, WALLS, law=swinging(), runs=200, horizon=20)
    assert promise.held


def test_backward_set_reaches_its_target_through_anything():
    system = hf.System(
        "line", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V, "v": U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    target = disc("target", 0.3)
    grid = hf.grid(system, {"x": (-2, 2), "v": (-2, 2)}, 81)
    found = hf.backward_reachable_tube(system, target, grid, 1.5, times=np.linspace(0.1, 1.5, 15))
    promise = hf.check_promise(system, found, None, goal=target, runs=200)
    assert promise.inside[0].kept.value == 1.0
    assert promise.outside.kept.value < 0.05


def test_value_of_other_bounds_is_refused(kernel):
    with pytest.raises(SimulationError, match="rates or the bounds"):
        hf.safety_law(cart(push=0.4), kernel)


@pytest.mark.parametrize("margin", [-0.1, math.nan, math.inf])
def test_margin_that_is_outside_the_set_is_refused(kernel, margin):
    with pytest.raises(SimulationError, match=r"margin is .*; expected 0 or more: below 0 is"):
        hf.safety_law(cart(), kernel, swinging(), margin=margin)


def two_pushes(*inputs):
    a, b = (hf.symbol(n) for n in ("a", "b"))
    return hf.System(
        "pushed", STATES, tuple(hf.Quantity(n, "m/s^2") for n in inputs), {"x": V, "v": a - b},
        input_bounds=hf.Box((-1, -0.1), (1, 0.1)),
    )  # fmt: skip


def test_value_of_other_inputs_with_the_same_bounds_is_refused():
    """The first input of the kernel has the larger bounds, whatever its name."""
    system = two_pushes("a", "b")
    value = hf.viability_kernel(system, WALLS, hf.grid(system, BOX, 21), 0.2, scheme="upwind")
    assert hf.safety_law(system, value).lookup is not None
    with pytest.raises(SimulationError, match="rates or the bounds"):
        hf.safety_law(two_pushes("b", "a"), value)
    with pytest.raises(SimulationError, match="rates or the bounds"):
        hf.safety_law(system, value.reported(definition="9b07eafac9e9d5bb"))
    # files of before know nothing of names
    said = [*system.rates.items(), system.input_bounds, system.disturbance_bounds]
    digest = hashlib.sha256(repr(said).encode()).hexdigest()[:16]
    assert hf.safety_law(system, value.reported(definition=digest)).lookup is not None


POINT = STATES[:1]
MOVER = hf.System(
    "mover", POINT, (U_IN := hf.Quantity("u", "m/s"),), {"x": U}, input_bounds=hf.Box((-1,), (1,))
)
AWAY = hf.Law("away", POINT, {"u": hf.parse_expression("1.0 if x > 0 else -1.0", {"x": X})})
NEAR = hf.Region("near", POINT, (hf.Inequality("near", abs(X) - 0.2, "m"),))  # fmt: skip


def reaching(times):
    """V = 0.2 - |x| + tau: as time runs down it falls by 1 /s where nothing moves."""
    grid = hf.grid(MOVER, {"x": (-2, 2)}, 201)
    return hf.backward_reachable_tube(MOVER, NEAR, grid, 1.0, times=times)


@pytest.mark.parametrize("gaps", [10, 50])
def test_margin_counts_what_a_value_falls_by_as_time_runs_down(gaps):
    """Away from the target at 1 m/s, and 1 m/s less that can be made good: 2 m/s."""
    found = reaching(np.linspace(0, 1, gaps + 1))
    assert hf.sampled_margin(MOVER, found, 0.02) == pytest.approx(0.04, rel=1e-3)


@pytest.mark.parametrize(("first", "fall"), [(0, 2.0), (1, 3.0)])
def test_margin_counts_what_a_value_rises_by_as_time_runs_down(first, fall):
    """x' = u - 2 falls at 3 m/s at most, and V = 1 + x - tau gives 1 m/s back, down to its first time."""
    falling = hf.System("falling", POINT, (U_IN,), {"x": U - 2}, input_bounds=hf.Box((-1,), (1,)))
    floor = hf.Region("floor", POINT, (hf.Inequality("floor", -1 - X, "m"),))
    grid = hf.grid(falling, {"x": (-2, 2)}, 201, {"x": "extrapolated"})
    found = hf.viability_kernel(falling, floor, grid, 1.0, times=np.linspace(0, 1, 11)[first:])
    assert hf.sampled_margin(falling, found, 0.02) == pytest.approx(0.02 * fall, rel=1e-3)


def test_margin_of_a_value_that_jumps_does_not_grow_with_the_grid():
    """x' = 2x + u/2 is held within 1/4, where V = 1 - |x| jumps: from .75 m all is lost at once."""
    system = hf.System(
        "unstable", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": 2 * X + U / 2},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    walls = hf.Region("walls", POINT, (hf.Inequality("both", abs(X) - 1, "m"),))
    margins = []
    for nodes in (41, 161, 641):
        grid = hf.grid(system, {"x": (-1.2, 1.2)}, nodes)
        found = hf.viability_kernel(system, walls, grid, 20, scheme="upwind")
        margins.append(hf.sampled_margin(system, found, 0.1))
    assert margins == sorted(margins, reverse=True)
    assert margins[0] < 0.9
    assert margins[2] == pytest.approx(0.75 + 0.1 * 1.0, abs=0.02)


def test_state_with_the_margin_has_some_value_left_at_the_next_sample():
    found = reaching(np.linspace(0, 1, 51))
    margin = hf.sampled_margin(MOVER, found, 0.02)
    start = [[1.2 - 1.02 * margin]]
    assert found.at(start) == pytest.approx(1.02 * margin, rel=1e-3)
    run = hf.simulate(MOVER, AWAY, starts=start, horizon=0.02, record_every=0.02)
    left = found.at(run.dataset["state"].values[:, -1], time=0.98)
    assert 0 < left < 0.1 * margin


def test_law_that_is_kept_in_a_basin_arrives_in_time():
    """One that stays where it is, and one that runs away, are let do so as long as time allows."""
    found = reaching(np.linspace(0, 1, 11))
    resting = hf.Law("rest", POINT, {"u": hf.parse_expression("0", {})})
    starts = np.linspace(-1.1, 1.1, 45)[:, None]
    for law in (resting, AWAY):
        kept = hf.safety_law(MOVER, found, law)
        run = hf.simulate(MOVER, kept, starts=starts, goal=NEAR, horizon=1.0)
        assert run.outcomes["reached goal"] == 45, law.name
        farthest = np.abs(run.dataset["state"].values[:, :, 0]).max(axis=1)
        assert (farthest > np.abs(starts[:, 0]) + 0.1).any() == (law is AWAY)


@pytest.mark.parametrize("times", [None, np.linspace(0.1, 1, 10)])
def test_law_is_not_kept_in_a_basin_whose_end_is_not_known(times):
    with pytest.raises(SimulationError, match="need not arrive"):
        hf.safety_law(MOVER, reaching(times), AWAY)


def test_law_that_is_kept_in_the_basin_of_two_walls_arrives_too():
    system = hf.System(
        "line", STATES, (hf.Quantity("u", "m/s^2"),), {"x": V, "v": U},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    goal = disc("goal", 0.2)
    grid = hf.grid(system, {"x": (-1.3, 1.3), "v": (-1.5, 1.5)}, 81)
    times = np.linspace(0, 2, 11)
    basin = hf.capture_basin(system, goal, WALLS, grid, 2.0, times=times, arrival_steps=0)
    resting = hf.Law("rest", STATES, {"u": hf.parse_expression("0", {})})
    promise = hf.check_promise(system, basin, WALLS, goal=goal, law=resting, runs=300)
    assert promise.held
    assert promise.inside[0].kept.count == promise.inside[0].kept.total == 300


@pytest.mark.heavy
def test_law_that_sees_the_state_late_keeps_what_one_that_does_not_keeps(kernel):
    """A law that pushes to the right, and is pushed there: seen 0.1 s late, it brakes in time.

    It predicts where the state is, so that what the disturbance does meanwhile is all that is lost.
    """
    push = hf.Law("push", STATES, {"u": hf.parse_expression("1", {})})
    late, pushed = {"delay": 0.1}, {"disturbance": {"d": 0.5}}
    at_once, margin = (hf.sampled_margin(cart(), kernel, 0.02, d) for d in (0.0, 0.1))
    assert margin == pytest.approx(6 * at_once)
    points = np.random.default_rng(1).uniform([-1, -1.5], [1, 1.5], (4000, 2))
    starts = points[kernel.contains(points, at_once)][:200]
    assert len(starts) == 200

    def stay(**options):
        kept = hf.safety_law(cart(), kernel, push, rate=6.0, **late, **options)
        return hf.simulate(
            cart(), kept, starts=starts, region=WALLS, horizon=10, **late, **pushed
        ).viable

    assert stay() == 200
    without = stay(margin=at_once, ahead=False)
    assert without < 150, "by slopes, which know nothing of the inputs that are on their way"


@pytest.mark.few("0.05-0.0-0.993-0.63")
@pytest.mark.parametrize(
    ("sample_time", "delay", "kept", "by_margin"),
    [
        (0.05, 0.0, 0.993, 0.63), (0.05, 0.1, 0.933, 0.10), (0.02, 0.1, 0.931, 0.23),
        (0.02, 0.02, 0.977, 0.72), (0.1, 0.1, 0.939, 0.0),
    ],
)  # fmt: skip
def test_delay_costs_what_the_disturbance_does_meanwhile(
    kernel, sample_time, delay, kept, by_margin
):
    """Shares of the kernel's nodes, beside those that are deeper than V may fall meanwhile."""
    game = sampled_value(decided(cart(), kernel), kernel, sample_time, delay=delay)
    margin = hf.sampled_margin(cart(), kernel, sample_time, delay)
    inside = (kernel.values() > 0).mean()
    assert (game.table > game.least).mean() / inside == pytest.approx(kept, abs=0.01)
    assert (kernel.values() > margin).mean() / inside == pytest.approx(by_margin, abs=0.01)


@pytest.mark.heavy
def test_law_that_sees_the_state_late_keeps_it_for_long(kernel):
    """From states that are little deeper than a law without a delay needs.

    Its rate is bounded by the sample time alone: what is predicted is as good as seen.
    """
    push = hf.Law("push", STATES, {"u": hf.parse_expression("1", {})})
    points = np.random.default_rng(1).uniform([-1, -1.5], [1, 1.5], (40_000, 2))
    depth = kernel.at(points)
    needed = hf.sampled_margin(cart(), kernel, 0.02)
    starts = points[(depth > needed) & (depth < needed + 0.02)][:100]
    assert len(starts) == 100
    for delay, rate in ((0.1, 20.0), (0.04, None)):
        kept = hf.safety_law(cart(), kernel, push, delay=delay, rate=rate)
        assert hf.simulate(
            cart(), kept, starts=starts, region=WALLS, horizon=200, delay=delay,
            record_every=200, disturbance={"d": 0.5},
        ).viable == 100  # fmt: skip


def test_rate_that_nobody_gave_is_what_the_sample_time_and_the_delay_bear(kernel):
    """A slow vehicle is the same in minutes as a fast one in seconds."""
    for hold, late, pace in ((0.02, 0.0, 2.0), (0.8, 0.0, 1.25), (0.5, 1.5, 0.5)):
        law = hf.safety_law(
            cart(), kernel, swinging(), sample_time=hold, delay=late, margin=0.1, ahead=False
        )
        rates = {q.name: float(q.value) for q in law.parameters}
        assert rates["safety_rate"] == pytest.approx(pace)


def test_delay_that_no_state_has_the_margin_for_is_refused(kernel):
    with pytest.raises(
        SimulationError, match=r"V may fall by 2.71 before an input answers, .* nowhere above 0.999"
    ):
        hf.safety_law(cart(), kernel, swinging(), delay=0.5)
    with pytest.raises(SimulationError, match=r"rate 2 1/s .* and a delay of 0.5 s"):
        hf.safety_law(cart(), kernel, swinging(), delay=0.5, rate=2.0)
    with pytest.raises(SimulationError, match=r"have no margin for a delay of 0.1 s"):
        hf.safety_law(cart(), kernel, delay=0.1)
    with pytest.raises(SimulationError, match=r"delay is -0.1"):
        hf.sampled_margin(cart(), kernel, 0.02, -0.1)
