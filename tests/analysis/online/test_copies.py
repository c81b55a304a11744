"""Filters, controllers and plants are copied and pickled in the middle of a run, and go on alike."""

import copy
import multiprocessing
import pickle
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from tests.carts import BOX, WALLS, D, U, cart

HOLD = 0.05


DRIFTS = hf.System(
    "drifts", WALLS.reads, (hf.Quantity("u", "m/s"),), {"x": U + D},
    disturbances=(hf.Quantity("d", "m/s", role="current"),),
    input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-0.1,), (0.1,)),
)  # fmt: skip


def regions(**options):
    return hf.SafetyFilter(DRIFTS, WALLS, sample_time=HOLD, **options)


@pytest.fixture(scope="module")
def kernel():
    system = cart(0.1)
    return hf.discriminating_kernel(system, WALLS, hf.grid(system, BOX, 41), 4.0)


@pytest.fixture(scope="module")
def certificate():
    return hf.certify(cart(0.1), WALLS, box={"x": (-1, 1), "v": (-2, 2)}, cells=41, sample_time=0.2)


def decided(keep, first, count=6):
    """What a filter decides at some samples, near a wall."""
    width, made = len(keep.measured_states), []
    for k in range(first, first + count):
        state = [0.9 * np.sin(0.7 * k), 0.9 * np.cos(0.4 * k)][:width]
        made.append(keep.step(state, [np.cos(1.3 * k)]))
    return made


FILTERS = {
    "plain": {},
    "slow": {"rates": {"u": 2.0}},
    "observes": {"states": ("x",)},
    "bounds errors": {"states": ("x",), "error_bounds": {"x": 0.01}},
}


def check(keep, decided=decided):
    decided(keep, 0)
    copies = [copy.copy(keep), copy.deepcopy(keep), pickle.loads(pickle.dumps(keep))]
    wanted = decided(keep, 6)
    for other in copies:
        assert type(other) is type(keep)
        assert other == keep
        assert hash(other) == hash(keep)
        assert decided(other, 6) == wanted
    assert any(decided(other, 12) != decided(other, 0) for other in copies)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("options", FILTERS)
def test_a_filter_of_a_region_goes_on_from_its_copy(options):
    check(regions(**FILTERS[options]))
    assert regions(**FILTERS[options]) == regions(**FILTERS[options])
    assert regions(**FILTERS[options]) != regions(fallback=[0.5])


@pytest.mark.filterwarnings("ignore")
def test_a_filter_of_a_certificate_goes_on_from_its_copy(certificate):
    check(hf.CertifiedFilter(certificate))


@pytest.mark.slow("plain", "delay")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "more", [{}, {"rates": {"u": 80.0}}, {"delay": 0.1}], ids=["plain", "rates", "delay"]
)
def test_a_filter_of_a_kernel_goes_on_from_its_copy(kernel, more):
    check(hf.SafetyFilter(cart(0.1), kernel, sample_time=HOLD, **more))


@pytest.mark.filterwarnings("ignore")
def test_what_a_filter_remembers_of_many_vehicles_is_in_its_copy():
    keep = regions(rates={"u": 2.0})
    states = np.random.default_rng(1).uniform(-0.9, 0.9, (20, 1))

    def inputs(of):
        return of.step_many(states, np.sign(states)).input

    inputs(keep)
    other = pickle.loads(pickle.dumps(keep))
    assert np.array_equal(inputs(keep), inputs(other))
    keep.reset()
    assert not np.array_equal(inputs(keep), inputs(other))


def commanded(controller, first, count=5):
    states = np.full(len(controller.system.states), 0.1)
    commands = (controller.step(states + 0.01 * k) for k in range(first, first + count))
    return [[c.input.tolist(), c.mode] for c in commands]


@pytest.mark.slow("inspection")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["ch2-integrator", "inspection"])
def test_a_controller_goes_on_in_its_mode(name):
    check(hf.Controller(hf.load_scenario(name)), commanded)


def test_a_plant_goes_on_from_where_it_is():
    plant = hf.Plant(cart(0.1), [0.5, 0.0])
    plant.step([0.3], [0.1])
    other, deep = pickle.loads(pickle.dumps(plant)), copy.deepcopy(plant)
    assert plant.step([-1.0], [0.0]).tolist() == other.step([-1.0], [0.0]).tolist()
    assert deep.t == 0.02
    assert plant == other == deep
    assert plant != hf.Plant(cart(0.1), [0.6, 0.0])


def inputs_of(keep):
    return [d.input.tolist() for d in decided(keep, 6)]


@pytest.mark.filterwarnings("ignore")
def test_other_processes_take_filters_and_give_decisions():
    keep = regions(rates={"u": 2.0})
    decided(keep, 0)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(inputs_of, [keep])[0] == inputs_of(copy.copy(keep))
        (decision,) = pool.map(last_of, [keep])
    assert decision == decided(copy.copy(keep), 6)[-1]
    assert decision.why == decided(copy.copy(keep), 6)[-1].why


def last_of(keep):
    return decided(keep, 6)[-1]


def test_decisions_are_equal_where_all_of_them_is():
    keep = regions()
    one, same = keep.step([0.5], [1]), regions().step([0.5], [1])
    other = regions().step([0.6], [1])
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert one != keep.step([0.5], [1]), "it is of a later time"
    assert regions().step([np.nan], [1]) == regions().step([np.nan], [1])


@pytest.mark.filterwarnings("ignore")
def test_a_filter_of_a_kernel_that_stays_in_its_file_goes_on_from_its_copy(kernel, tmp_path):
    path = kernel.save(tmp_path / "kernel.nc")
    keep = hf.SafetyFilter(cart(0.1), hf.load(path, lazy=True), sample_time=HOLD)
    check(keep)
    assert keep.law == hf.SafetyFilter(cart(0.1), hf.load(path, lazy=True), sample_time=HOLD).law


@pytest.mark.filterwarnings("ignore")
def test_what_a_filter_was_made_of_does_not_change_with_the_callers_arguments():
    rates, fallback = {"u": 2.0}, np.array([0.5])
    keep = regions(rates=rates, fallback=fallback)
    before, among = hash(keep), {keep}
    rates["u"], fallback[0] = 0.1, -0.5
    assert hash(keep) == before
    assert keep in among
    other = copy.deepcopy(keep)
    assert other.fallback.tolist() == [0.5]
    assert decided(other, 0) == decided(keep, 0)


def test_filters_and_plants_are_equal_however_their_arguments_are_written():
    assert regions() == hf.SafetyFilter(system=DRIFTS, keep=WALLS, sample_time=HOLD, delay=0)
    assert hf.Plant(DRIFTS, [0.5]) == hf.Plant(DRIFTS, np.array([0.5]), sample_time=0.02)
    assert hf.Plant(DRIFTS, [0.5]) != hf.Plant(DRIFTS, [0.5], substeps=4)


def test_numbers_of_sympy_are_copied():
    plant = hf.Plant(DRIFTS, [sp.sqrt(2) / 2])
    for other in (copy.copy(plant), copy.deepcopy(plant), pickle.loads(pickle.dumps(plant))):
        assert other.state.tolist() == plant.state.tolist()


def test_decisions_of_other_times_are_others():
    one, other = (regions().step([0.5], [1], t) for t in (-1.0, -2.0))
    assert one != other
    lost = regions().step([0.5], [1], np.nan)
    assert pickle.loads(pickle.dumps(lost)) == lost
    assert hash(pickle.loads(pickle.dumps(lost))) == hash(lost)


def test_kernels_are_equal_where_their_values_are(kernel):
    again = pickle.loads(pickle.dumps(kernel))
    assert again == kernel
    assert hash(again) == hash(kernel)
    assert replace(kernel, dataset=kernel.dataset + 5) != kernel
    assert str(kernel) == "<discriminating-kernel of walls, cart: 41 x 41 nodes over x, v>"
