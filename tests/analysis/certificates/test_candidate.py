"""The set of a kernel as a candidate of what is certified: proved, checked, and no less is found."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast_check.checker import check
from tests.certified_systems import cart

X, Y, Z, U, W, S = (hf.symbol(n) for n in ("x", "y", "z", "u", "w", "s"))
SPREADING = hf.System(
    "spreading", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("u"), hf.Quantity("w")),
    {"x": X + U, "y": Y + W},
    input_bounds=hf.Ball(1.0, 2),
)  # fmt: skip
SIDES = {"east": X - 2, "west": -2 - X, "north": Y - 2, "south": -2 - Y}
SQUARE = hf.Region("square", SPREADING.states, tuple(hf.Inequality(n, e) for n, e in SIDES.items()))
BOX = {"x": (-2.3, 2.3), "y": (-2.3, 2.3)}


@pytest.fixture(scope="module")
def kernel():
    """The disc of 1 m can be held: the march finds it 0.17 of a cell too large."""
    return hf.viability_kernel(SPREADING, SQUARE, hf.grid(SPREADING, BOX, 41), 20, scheme="upwind")


def corners(found):
    """All corners of the certified cells, shape (corners, 2)."""
    low, high = found.cells.corners(found.kept.members)
    picks = [np.stack([x[:, 0], y[:, 1]], axis=1) for x in (low, high) for y in (low, high)]
    return np.concatenate(picks)


@pytest.mark.few("2-0.87")
@pytest.mark.parametrize(("halvings", "share"), [(1, 0.79), (2, 0.87), (3, 0.92)])
def test_set_that_is_too_large_is_certified_where_it_can_be_held(kernel, halvings, share, tmp_path):
    """Nothing beyond the exact disc, most of it, and every cell holds for the checker."""
    states = np.random.default_rng(0).uniform(-2, 2, (20_000, 2))
    beyond = np.hypot(*states[kernel.contains(states)].T).max() - 1.0
    assert beyond / kernel.grid.axes[0].step == pytest.approx(0.17, abs=0.05)
    found = kernel.certified(SPREADING, SQUARE, sample_time=0.2, halvings=halvings)
    assert np.hypot(*corners(found).T).max() <= 1.0
    low, high = found.cells.corners(found.kept.members)
    assert (high - low).prod(axis=1).sum() / np.pi == pytest.approx(share, abs=0.005)
    told = check(str(found.write(tmp_path / "c.holdfast")), share=1.0 if halvings == 1 else 0.2)
    assert told.startswith(f"{len(found.kept.members)} cells for ever: ")


def test_candidate_gives_what_the_search_of_the_whole_region_gives(kernel):
    whole = hf.certify(SPREADING, SQUARE, box=BOX, cells=40, sample_time=0.2)
    found = kernel.certified(SPREADING, SQUARE, sample_time=0.2)
    assert np.array_equal(found.kept.members, whole.kept.members)
    assert found.kept.inside == whole.kept.inside
    deeper = kernel.certified(SPREADING, SQUARE, sample_time=0.2, margin=1.5)
    assert set(deeper.kept.members) < set(found.kept.members)


def test_only_cells_that_the_set_touches_are_tried(kernel):
    tried = []
    for search in (
        lambda tell: kernel.certified(SPREADING, SQUARE, sample_time=0.2, progress=tell),
        lambda tell: hf.certify(
            SPREADING, SQUARE, box=BOX, cells=40, sample_time=0.2, progress=tell
        ),
    ):
        said = []
        search(lambda what, share, said=said: said.append(what))
        tried.append(int(said[0].split()[0].replace(",", "")))
    assert tried[0] < 0.45 * tried[1]


def test_certified_disc_is_kept_in_the_loop(kernel):
    """The law of the certificate, from corners of its cells, by the simulator."""
    found = kernel.certified(SPREADING, SQUARE, sample_time=0.2)
    law = hf.certified_law(found, SPREADING)
    starts = 0.999 * corners(found)[::7]
    run = hf.simulate(
        SPREADING, law, starts=starts, region=SQUARE, horizon=10, sample_time=0.2, record_every=0.2
    )
    assert run.outcomes["stayed"] == len(starts)


@pytest.mark.heavy
def test_basin_is_a_candidate_of_what_leads_to_its_target():
    pushed, floor = cart()
    grid = hf.grid(pushed, {"x": (-1.2, 1.2), "v": (-2.4, 2.4)}, 41)
    x, v = (q.symbol for q in pushed.states)
    near = hf.Inequality("near", x**2 + v**2 - 0.16)
    rest = hf.Region("rest", pushed.states, (near,), empirical="a disc of numbers")
    basin = hf.capture_basin(pushed, rest, floor, grid, 4, arrival_steps=0)
    found = basin.certified(pushed, floor, target=rest, sample_time=0.2, cells=61)
    whole = hf.certify(
        pushed, floor, target=rest, sample_time=0.2, cells=61,
        box={a.name: (a.low, a.high) for a in grid.axes},
    )  # fmt: skip
    assert set(found.kept.members) <= set(whole.kept.members)
    assert len(found.kept.members) > 0.95 * len(whole.kept.members) > 100


SPACE = hf.System(
    "in space", (*SPREADING.states, hf.Quantity("z")), (*SPREADING.inputs, hf.Quantity("s")),
    {"x": X + U, "y": Y + W, "z": Z + S},
    input_bounds=hf.Ball(1.0, 3),
)  # fmt: skip


@pytest.mark.heavy
def test_set_in_three_states_is_certified_where_it_can_be_held(tmp_path):
    """The ball of 1 m can be held: nothing beyond it is certified, and most of it is."""
    region = hf.Region("ball", SPACE.states, (hf.Inequality("near", X**2 + Y**2 + Z**2 - 2),))
    grid = hf.grid(SPACE, dict.fromkeys("xyz", (-1.5, 1.5)), 25)
    kernel = hf.viability_kernel(SPACE, region, grid, 20, scheme="upwind")
    found = kernel.certified(SPACE, region, sample_time=0.2, halvings=1)
    low, high = found.cells.corners(found.kept.members)
    assert np.linalg.norm(np.maximum(abs(low), abs(high)), axis=1).max() <= 1.0
    assert (high - low).prod(axis=1).sum() / (4 / 3 * np.pi) == pytest.approx(0.63, abs=0.005)
    assert check(str(found.write(tmp_path / "c.holdfast")), share=200 / len(found.kept.members))


@pytest.mark.heavy
def test_set_in_four_states_is_certified_where_it_can_be_held(tmp_path):
    """A cart in a square, pushed by a tenth of what it brakes with: |v| <= sqrt(1.8 (1 -+ x))."""
    cart = hf.load_scenario("pushed-cart", ["grid.nodes=15"])
    kernel = cart.solve()
    found = kernel.certified(cart.system, cart.region, sample_time=0.6, cells=15, inputs=3)
    low, high = found.cells.corners(found.kept.members)
    for k in (0, 1):  # the corner that is nearest to a wall and fastest towards it
        assert (high[:, k + 2] <= np.sqrt(1.8 * (1 - high[:, k]))).all()
        assert (low[:, k + 2] >= -np.sqrt(1.8 * (1 + low[:, k]))).all()
    exact = (2 * np.sqrt(1.8) * 2**1.5 / 1.5) ** 2
    assert (high - low).prod(axis=1).sum() / exact == pytest.approx(0.455, abs=0.005)
    assert check(str(found.write(tmp_path / "c.holdfast")), share=200 / len(found.kept.members))


def test_what_is_no_candidate_is_refused(kernel):
    pushed, floor = cart()
    with pytest.raises(SimulationError, match="candidate belongs to system 'spreading'"):
        kernel.certified(pushed, floor)
    with pytest.raises(SimulationError, match="kind 'viability-kernel' with a target"):
        kernel.certified(SPREADING, SQUARE, target=SQUARE)
    with pytest.raises(SimulationError, match="no node of the candidate has V > 5"):
        kernel.certified(SPREADING, SQUARE, margin=5.0)
    with pytest.raises(SimulationError, match="a candidate with a law"):
        kernel.certified(SPREADING, SQUARE, law=hf.Law("still", SPREADING.states, {"u": 0, "w": 0}))
    with pytest.raises(SimulationError, match="no box"):
        hf.certify(SPREADING, SQUARE)
