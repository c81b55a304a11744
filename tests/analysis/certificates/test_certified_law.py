"""The law of a certificate keeps its promise in closed loops, against the worst disturbances."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, ModelWarning, SimulationError
from holdfast.maths.definitions.quantity import TIME
from holdfast.maths.expressions.functions import sgn
from tests.adversary import starts_in, worst_of
from tests.c_code import built, needs_gcc
from tests.certified_laws import MANY, answers, in_c
from tests.certified_systems import AHEAD, BOX, LEFT, U, X, camera, cart, view


@pytest.fixture(scope="module")
def seen():
    return hf.certify(camera(), view(camera()), box=BOX, cells=61, sample_time=0.1)


@pytest.fixture(scope="module")
def inexact():
    """With inputs that are late, and one state that is measured wrong."""
    return hf.certify(
        camera(), view(camera()), box=BOX, cells=61, sample_time=0.1, delay=0.02,
        errors={"left": 0.01},
    )  # fmt: skip


@pytest.fixture(scope="module")
def briefly():
    """In a current too strong for a certificate for ever."""
    return hf.certify(camera(0.6), view(camera()), box=BOX, cells=41, horizon=0.5)


def certain(answer):
    """The inputs alone, of states in certified cells."""

    def inputs(states):
        found, known = answer(states)
        assert known.all(), states[~known]
        return found

    return inputs


def test_no_target_leaves_the_view_whatever_corner_the_disturbance_takes_between_samples(seen):
    """Three thousand runs of 5 s in exact steps of 10 ms."""
    answer = certain(answers(camera(), seen_law(seen), seen, 3000))
    worst = worst_of(seen, answer, 3000, 50, 10, 1)
    assert -0.01 < worst <= 0


@pytest.mark.heavy
def test_shipped_certificate_keeps_thirty_thousand_targets_in_view_for_a_minute():
    shipped = hf.load_scenario("seen-target")
    found = hf.certify(shipped.system, shipped.region, box=BOX, cells=101, sample_time=0.1)
    answer = certain(answers(shipped.system, hf.certified_law(found), found, 30_000))
    assert worst_of(found, answer, 30_000, 600, 20, 2) <= 0


def seen_law(seen):
    return hf.certified_law(seen, camera())


def test_simulation_runs_the_law_and_no_run_leaves_the_view(seen):
    """Bang-bang disturbances in time and over the states, with 20 steps in a sample."""
    starts = starts_in(seen, seen.kept.members, 1000, 3)
    swing = sgn(sp.sin(7.3 * TIME)) / 10
    for name, wa, wb in (
        ("towards the nearer edge", sgn(1.2 - AHEAD) / 10, -3 * sgn(LEFT) / 20),
        ("swinging", swing, 3 * sgn(sp.cos(11 * TIME)) / 20),
    ):
        result = hf.simulate(
            camera(), seen_law(seen), starts=starts, region=view(camera()), horizon=5.0,
            sample_time=0.1, substeps=20, disturbance={"wa": wa, "wb": wb},
        )  # fmt: skip
        assert result.outcomes["stayed"] == 1000, (name, result.outcomes)


def test_law_gives_the_input_of_the_cell_that_the_certificate_names(seen):
    kept = seen.kept
    low, high = seen.cells.corners(kept.members)
    found, known = answers(camera(), seen_law(seen), seen, len(low))(0.5 * (low + high))
    assert known.all()
    assert np.array_equal(found, seen.candidates[kept.inputs])


def test_outside_of_the_cells_the_outcome_says_so(seen):
    """The input is that of the nearest cell; a state in the box, one beyond it."""
    system, law = camera(), seen_law(seen)
    starts = [[1.2, 1.19], [5.0, 0.0], [1.2, 0.0]]
    result = hf.simulate(system, law, starts=starts, horizon=0.2, sample_time=0.1)
    assert [result.outcomes[k] for k in ("left grid", "stayed")] == [2, 1]
    controller = hf.Controller(system, law)
    assert controller.sample_time == 0.1
    beyond, inside = controller.step(starts[1]), controller.step(starts[2])
    assert beyond.outside
    assert beyond.value == 0.0
    assert not inside.outside
    assert inside.value == math.inf
    low, high = seen.cells.corners(seen.kept.members)
    count = np.abs(0.5 * (low + high) - [2.1, 0.0]) / [1.8 / 61, 2.4 / 61]
    near = np.flatnonzero((count**2).sum(axis=1) <= (count**2).sum(axis=1).min() + 3)
    nearest = seen.candidates[seen.kept.inputs[near]]
    assert (nearest == beyond.input).all(axis=1).any()


def test_certificate_for_a_while_counts_down_and_keeps_for_as_long_as_it_says(briefly):
    """Whatever level a start has, the signal says a time, which falls by at most a sample."""
    system = camera(0.6)
    law = hf.certified_law(briefly, system)
    starts = starts_in(briefly, np.unique(briefly.kept.entries[:, 0]), 2000, 4)
    most_wb = 0.65
    result = hf.simulate(
        system, law, starts=starts, region=view(system), horizon=0.5, sample_time=0.1,
        substeps=20, record_every=0.1,
        disturbance={"wa": 3 * sgn(1.2 - AHEAD) / 5, "wb": -most_wb * sgn(LEFT)},
    )  # fmt: skip
    data = result.arrays
    remaining = data["signal"].values[:, :, 0]
    assert set(np.round(remaining[:, 0] / 0.1).astype(int)) == {1, 2, 3, 4, 5}
    assert (np.diff(remaining, axis=1) >= -0.1 - 1e-12).all()
    exits = np.nan_to_num(data["exit_time"].values, nan=math.inf)
    assert (exits >= remaining[:, 0] - 1e-9).all()


def test_other_sample_times_and_continuous_control_are_refused(seen):
    system, law = camera(), seen_law(seen)
    run = {"starts": [[1.2, 0.0]], "horizon": 0.2}
    with pytest.raises(SimulationError, match=r"sample time is 0\.02 s; expected 0\.1 s"):
        hf.simulate(system, law, **run)
    with pytest.raises(SimulationError, match=r"held for 0\.1 s"):
        hf.simulate(system, law, **run, sample_time=0.1, continuous=True)
    with pytest.raises(SimulationError, match=r"sample time is 0\.05 s"):
        hf.Controller(system, law, sample_time=0.05)


@pytest.mark.few(
    "more2-'ahead' is up to 0\\\\.001, .* with up to 0: its", "more3-'left' has no bound"
)
@pytest.mark.slow("more0-everything 0\\\\.1 s late, .* late by up to 0\\\\.02 s: its promise")
@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"delay": 0.1}, r"everything 0\.1 s late, .* late by up to 0\.02 s: its promise"),
        ({"noise_uniform": {"left": 0.011}}, r"'left' is up to 0\.011, .* with up to 0\.01: its"),
        ({"noise_uniform": {"ahead": 0.001}}, r"'ahead' is up to 0\.001, .* with up to 0: its"),
        ({"noise_normal": {"left": 0.001}}, "'left' has no bound"),
    ],
)
def test_what_is_beyond_that_the_certificate_counts_with_is_said(inexact, more, named):
    with pytest.warns(ModelWarning, match=named):
        hf.simulate(
            camera(), seen_law(inexact), starts=[[1.2, 0.0]], horizon=0.2, sample_time=0.1, **more
        )


def test_noise_that_the_certificate_counts_with_is_no_warning_and_no_run_leaves(inexact):
    """Starts are a noise away from the edges of certified cells; warnings fail tests."""
    starts = starts_in(inexact, inexact.kept.members, 1000, 12)
    near = [seen_in(inexact, starts + np.array([0, e])) for e in (-0.01, 0, 0.01)]
    known = np.array(near).all(axis=0)
    starts = starts[known]
    assert len(starts) > 500
    result = hf.simulate(
        camera(), seen_law(inexact), starts=starts, region=view(camera()), horizon=5.0,
        sample_time=0.1, substeps=20, noise_uniform={"left": 0.01},
        disturbance={"wa": sgn(1.2 - AHEAD) / 10, "wb": -3 * sgn(LEFT) / 20},
    )  # fmt: skip
    assert result.outcomes["stayed"] == len(starts)


def test_with_delay_and_errors_at_their_limits_no_target_leaves_the_view(inexact, seen):
    """Two thousand runs of 5 s: inputs 20 ms late, each measurement a centimetre off."""
    answer = certain(answers(camera(), seen_law(inexact), inexact, 2000))
    worst = worst_of(inexact, answer, 2000, 50, 10, 13, late=2, error=0.01)
    assert -0.02 < worst <= 0
    careless = hf.certified_law(seen, camera())
    asked = answers(camera(), careless, seen, 2000)
    assert worst_of(seen, lambda q: asked(q)[0], 2000, 50, 10, 13, late=2, error=0.01) > 0


def seen_in(certificate, states):
    """Whether states are in certified cells."""
    places = [np.searchsorted(e, q, "right") - 1
              for e, q in zip(certificate.cells.edges, states.T, strict=True)]  # fmt: skip
    flat = np.ravel_multi_index(places, certificate.cells.counts, mode="clip")
    return np.isin(flat, certificate.kept.members)


def test_another_vehicle_is_refused(seen):
    other = camera()
    for change, named in (
        ({"rates": {**other.rates, "ahead": -U}}, "the rate of 'ahead'"),
        (
            {"disturbance_bounds": hf.Box((-0.2, -0.1), (0.1, 0.1))},
            "'wa' of system 'camera' is -0.2",
        ),
        ({"input_bounds": hf.Box((-0.4, -0.8), (0.5, 0.8))}, "that 'u' of system 'camera' cannot"),
        (
            {
                "states": (hf.Quantity("ahead", "m"), hf.Quantity("left", "cm")),
                "empirical": "wrong",
            },
            "the states ahead",
        ),
    ):
        fields = {
            n: getattr(other, n)
            for n in ("name", "states", "inputs", "rates", "disturbances", "disturbance_bounds",
                      "input_bounds")
        }  # fmt: skip
        with pytest.raises(DefinitionError, match=named):
            hf.certified_law(seen, hf.System(**{**fields, **change}))


def test_disturbance_that_is_known_is_the_only_one_of_its_law():
    """The certificate is of that current alone: other bounds and other currents are refused."""
    system = camera()
    known = hf.certify(system, view(system), box=BOX, cells=41, disturbance={"wa": 0.1, "wb": -0.1})
    with pytest.raises(DefinitionError, match=r"within 0\.1 to 0\.1"):
        hf.certified_law(known, system)
    alone = hf.certified_system(known)
    run = {"starts": starts_in(known, known.kept.members, 200, 8), "region": view(system)}
    run |= {"horizon": 5.0, "sample_time": known.hold}
    law = hf.certified_law(known)
    result = hf.simulate(alone, law, **run, disturbance={"wa": 0.1, "wb": -0.1})
    assert result.outcomes["stayed"] == 200
    with pytest.raises(SimulationError, match="disturbance"):
        hf.simulate(alone, law, **run)


def test_certificate_without_a_cell_has_no_law_and_no_filter():
    none = hf.certify(camera(0.6), view(camera()), box=BOX, cells=9)
    for use in (hf.certified_law, hf.CertifiedFilter):
        with pytest.raises(DefinitionError, match="has no cell"):
            use(none)


def turning():
    """A vehicle between two walls, its heading over a whole turn."""
    y, psi, r = (hf.symbol(n) for n in ("y", "psi", "r"))
    car = hf.System(
        "lane", (hf.Quantity("y", "m"), hf.Quantity("psi", "rad")), (hf.Quantity("r", "rad/s"),),
        {"y": sp.sin(psi), "psi": r}, input_bounds=hf.Box((-2.0,), (2.0,)),
    )  # fmt: skip
    lane = hf.Region(
        "lane", car.states, (hf.Inequality("a", y - 1, "m"), hf.Inequality("b", -y - 1, "m"))
    )
    found = hf.certify(
        car, lane, box={"y": (-1, 1), "psi": (-math.pi, math.pi)}, cells=41, sample_time=0.2
    )
    return car, lane, found


def test_heading_turns_on_and_on_and_the_vehicle_stays_in_its_lane():
    car, lane, found = turning()
    starts = starts_in(found, found.kept.members, 1000, 5, corners=0)
    starts[::2, 1] += 6 * math.pi
    result = hf.simulate(
        car, hf.certified_law(found, car), starts=starts, region=lane, horizon=10.0,
        sample_time=0.2, record_every=0.2, substeps=10,
    )  # fmt: skip
    assert result.outcomes["stayed"] == 1000


def three():
    """A cart between walls with a third state that follows it late: three axes."""
    z = hf.symbol("z")
    plain, walls = cart()
    system = hf.System(
        "late", (*plain.states, hf.Quantity("z")), plain.inputs,
        {**plain.rates, "z": X - z}, disturbances=plain.disturbances, parameters=plain.parameters,
        disturbance_bounds=plain.disturbance_bounds, input_bounds=plain.input_bounds,
    )  # fmt: skip
    region = hf.Region(
        "room", system.states,
        (*walls.inequalities, hf.Inequality("up", z - 1), hf.Inequality("down", -1 - z)),
    )  # fmt: skip
    found = hf.certify(
        system, region, box={"x": (-1, 1), "v": (-2, 2), "z": (-1, 1)},
        cells={"x": 21, "v": 31, "z": 9}, sample_time=0.3, horizon=1.2, inputs=3,
    )  # fmt: skip
    return system, region, found


@pytest.mark.heavy
def test_three_states_are_kept_for_as_long_as_is_said():
    system, region, found = three()
    starts = starts_in(found, np.unique(found.kept.entries[:, 0]), 1000, 9)
    for push in (-0.2, 0.2 * sgn(sp.sin(5 * TIME))):
        result = hf.simulate(
            system, hf.certified_law(found, system), starts=starts, region=region, horizon=1.2,
            sample_time=0.3, record_every=0.3, substeps=20, disturbance={"w": push},
        )  # fmt: skip
        data = result.arrays
        says = data["signal"].values[:, 0, 0]
        exits = np.nan_to_num(data["exit_time"].values, nan=math.inf)
        assert (exits >= says - 1e-9).all()
        assert set(np.round(says / 0.3)) == {1, 2, 3, 4}


def halved():
    """Cells of three sizes, for a while."""
    system = camera(0.45)
    return (
        system,
        None,
        hf.certify(system, view(system), box=BOX, cells=20, horizon=0.5, halvings=2),
    )


# -- C -----------------------------------------------------------------------------------------


def edges_of(cells, count, rng):
    """Corners of cells, places on one edge, and the floats on both sides of an edge."""
    found = np.stack([rng.choice(e, count) for e in cells.edges], axis=1)
    free = np.stack([rng.uniform(e[0], e[-1], count) for e in cells.edges], axis=1)
    found = np.where(rng.uniform(size=found.shape) < 0.4, free, found)
    side = rng.choice([-np.inf, 0.0, np.inf], found.shape)
    return np.where(side == 0.0, found, np.nextafter(found, side))


@pytest.mark.few("for a while")
@needs_gcc
@pytest.mark.parametrize("kind", ["for ever", "for a while", "around", "three states", "halved"])
def test_law_in_c_has_the_bits_of_the_simulated_one_inside_outside_and_at_edges(
    kind, seen, briefly, tmp_path
):
    system, _, found = {
        "for ever": lambda: (camera(), None, seen),
        "for a while": lambda: (camera(0.6), None, briefly),
        "around": turning,
        "three states": three,
        "halved": halved,
    }[kind]()
    law = hf.certified_law(found, system)
    c = built(tmp_path, hf.export_c(system, law, "law"), "law", MANY)
    rng = np.random.default_rng(6)
    low, high = (np.array([e[k] for e in found.cells.edges]) for k in (0, -1))
    wide = rng.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low), (20_000, len(low)))
    states = np.ascontiguousarray(np.concatenate([wide, edges_of(found.cells, 20_000, rng)]))
    commands, outside = in_c(c, states, len(system.inputs))
    expected, known = answers(system, law, found, len(states))(states)
    assert np.array_equal(commands.view(np.int64), expected.view(np.int64))
    assert np.array_equal(outside == 0, known)
    assert 500 < known.sum() < len(states) - 500


@needs_gcc
def test_file_alone_is_a_law_in_c(seen, tmp_path):
    """Whoever has only the file: the system, the law, and the C, as of the object."""
    read = hf.read_certificate(seen.write(tmp_path / "view.holdfast"))
    alone = hf.certified_system(read)
    text = hf.export_c(alone, hf.certified_law(read), "law")
    assert text == hf.export_c(alone, hf.certified_law(seen, alone), "law")
    assert "outside: 1 if the state was in no certified cell" in text
    assert "inputs that are held for 0.1 s, without delay" in text
    assert "exact measurements" in text
    built(tmp_path, text, "law")


def test_law_in_c_says_what_its_certificate_counts_with(inexact):
    text = hf.export_c(camera(), hf.certified_law(inexact), "law")
    assert "inputs that are held for 0.1 s, late by up to 0.02 s" in text
    assert "certified for left measured to 0.01\n" in text.replace(" */", "\n")
