"""A march whose grid is cut into parts has the answer of one machine, to the bit."""

import warnings

import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability import disk_estimate, one_march, posed_march
from holdfast.analysis.reachability.disk_estimate import traffic
from holdfast.analysis.reachability.divided_march import MarchPart
from holdfast.analysis.reachability.posed_march import PosedMarch
from holdfast.errors import OutputError, SimulationError, SlowWarning
from holdfast.execution import resources
from holdfast.execution.level_set import march, sweeping
from tests.divided_marches import (
    PLACE,
    ROBOT,
    TURNED,
    Here,
    basin,
    cart,
    grid,
    kernel,
    limited_kernel,
    line,
    mirrored_angle,
    mirrored_first,
    mirrored_kernel,
    mirrored_moving_kernel,
    mirrored_on_a_ring,
    moving_kernel,
    moving_set,
    post,
    same,
    set_at,
    tube,
    turned_kernel,
    two_carts,
)  # fmt: skip

STAGE, STEP = False, True

DIVIDED = [
    (kernel, {}, [(2, STAGE), (3, STEP)]),
    (kernel, {"scheme": "eno2", "precision": "float32", "dissipation": "global"}, [(3, STEP)]),
    (kernel, {"scheme": "upwind"}, [(3, STEP)]),
    (turned_kernel, {}, [(2, STEP), (5, STAGE), (17, STEP)]),
    (limited_kernel, {"scheme": "upwind", "order": 2}, [(5, STEP), (21, STAGE)]),
    (mirrored_kernel, {}, [(3, STEP), (3, STAGE)]),
    (moving_kernel, {}, [(3, STEP), (4, STAGE)]),
    (tube, {}, [(4, STEP)]),
    (set_at, {"check_outside": False}, [(2, STAGE)]),
    (basin, {"check_outside": True}, [(4, STEP), (2, STAGE)]),
    (two_carts, {"band": 0.1}, [(3, STEP), (11, STAGE)]),
    (line, {"threads": 1}, [(2, STAGE), (3, STEP)]),
]


@pytest.mark.few("kernel-options2-cuts2", "tube-options7-cuts7")
@pytest.mark.parametrize(
    ("problem", "options", "cuts"), DIVIDED, ids=lambda v: getattr(v, "__name__", None)
)
def test_a_divided_march_has_the_answer_of_one_machine(problem, options, cuts):
    whole = problem(**options)
    for count, by_step in cuts:
        same(whole, problem(**options, cluster=Here(count=count, by_step=by_step)))


@pytest.mark.few("True")
@pytest.mark.parametrize("by_step", [STAGE, STEP])
def test_the_parts_of_two_states_converge_in_the_same_step(by_step):
    """Which of the rows that are computed together have changed depends on the threads."""
    whole = cart()
    assert whole.report.converged
    same(whole, cart(cluster=Here(count=3, by_step=by_step)), "computed_share")


def test_what_is_settled_is_skipped_in_the_parts_too():
    assert kernel(cluster=Here(count=3)).report.computed_share < 0.97


SINGLE = {"scheme": "eno2", "precision": "float32"}


@pytest.mark.few("turned_kernel-options1", "mirrored_kernel-options3")
@pytest.mark.parametrize(
    ("problem", "options"),
    [
        (kernel, {"threads": 2}), (turned_kernel, {}), (basin, {}),
        (mirrored_kernel, {}), (mirrored_kernel, SINGLE | {"threads": 2, "band": 0.1}),
        (mirrored_angle, {}), (mirrored_angle, SINGLE), (mirrored_on_a_ring, {}),
        (mirrored_on_a_ring, SINGLE), (moving_kernel, {}), (mirrored_moving_kernel, SINGLE),
        (moving_set, {}),
    ],
    ids=lambda v: getattr(v, "__name__", None),
)  # fmt: skip
def test_the_stages_of_a_march_from_a_disk_follow_one_another(
    problem, options, tmp_path, monkeypatch
):
    whole = problem(**options)
    monkeypatch.setattr(sweeping, "NODES", 1)  # closely

    alone = sweeping.Streaming._carry_out

    def carry_out(self, order):
        """A march of one stage has nothing to follow."""
        assert self.march.method.order == 1, "a stage has gone through the arrays by itself"
        return alone(self, order)

    monkeypatch.setattr(sweeping.Streaming, "_carry_out", carry_out)
    same(whole, problem(**options, on_disk=tmp_path / "new"))
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.slow("mirrored_first-options1", "cart-options2")
@pytest.mark.parametrize(
    ("problem", "options"),
    [
        (kernel, {"scheme": "upwind"}), (mirrored_first, SINGLE), (cart, {"threads": 1}),
        (moving_kernel, {"scheme": "upwind"}),
    ],
    ids=lambda v: getattr(v, "__name__", None),
)  # fmt: skip
def test_a_march_from_a_disk_whose_stages_do_not_has_the_same_answer(problem, options, tmp_path):
    same(problem(**options), problem(**options, on_disk=tmp_path))


def test_obstacles_that_move_are_renewed_some_planes_at_a_time(monkeypatch):
    whole, parts = moving_set(scheme="eno2"), Here(count=3, by_step=STAGE)
    monkeypatch.setattr(posed_march, "NODES_RENEWED_AT_ONCE", 1000)  # two planes
    monkeypatch.setattr(march, "TOGETHER", 600)  # of which a part may have one and a half
    same(whole, moving_set(scheme="eno2"))
    same(whole, moving_set(scheme="eno2", cluster=parts))


@pytest.mark.few("disk")
@pytest.mark.parametrize(
    ("first", "then"),
    [
        ({"cluster": Here(2)}, {}),
        ({"on_disk": "disk"}, {"cluster": Here()}),
        ({"cluster": Here(3, STAGE)}, {"cluster": Here()}),
        ({}, {"cluster": Here(4)}),
    ],
    ids=["two parts", "disk", "three parts", "whole"],
)
def test_any_march_goes_on_from_the_checkpoint_of_another(first, then, tmp_path):
    """Of one in parts a march cut otherwise, and of one in a file one in parts.

    It is the first of two marches, which are half the way each.
    """
    told = []

    def stop(share):
        told.append(share)
        if share > 0.25:
            raise KeyboardInterrupt

    if "on_disk" in first:
        first = {"on_disk": tmp_path / "disk"}
    options = {"checkpoint": tmp_path, "checkpoint_every": 0}
    with pytest.raises(KeyboardInterrupt):
        basin(**options, progress=stop, **first)
    rest = []
    found = basin(**options, progress=rest.append, **then)
    same(basin(), found, "computed_share")
    rest = [share for share in rest if share <= 0.5]
    assert len(told) + len(rest) - 1 <= found.report.steps <= len(told) + len(rest)


def test_where_the_value_is_not_finite_is_the_same_node():
    x, y = hf.symbol("x"), hf.symbol("y")
    huge = hf.Region("huge", PLACE, (hf.Inequality("c", 1e300 * (x**2 - y - 1), "m"),))

    def said(**options):
        with pytest.raises(SimulationError) as found:
            hf.backward_reachable_at(ROBOT, huge, grid(y=9), 0.1, order=2, **options)
        return str(found.value)

    for scheme in ("upwind", "eno2"):
        whole = said(scheme=scheme)
        assert "the value is not finite at x = -2, y = -1.3, psi = -3.14159 after" in whole
        for by_step in (STAGE, STEP):
            assert said(scheme=scheme, cluster=Here(count=3, by_step=by_step)) == whole


def test_the_disk_says_the_same_of_what_cannot_be_marched_on(tmp_path, monkeypatch):
    monkeypatch.setattr(sweeping, "NODES", 1)
    x, y = hf.symbol("x"), hf.symbol("y")
    huge = hf.Region("huge", PLACE, (hf.Inequality("c", 1e300 * (y - x**2 - 1), "m"),))
    wider = hf.Inequality("left", y - 1 - 2 * (0.3 - hf.TIME), "m")
    beyond = hf.Region("lane", PLACE, (wider, hf.Inequality("right", -1 - y, "m")))
    gap = hf.Region("gap", PLACE, (hf.Inequality("c", sp.sqrt(hf.TIME - 0.1 * x) - 1, "m"),))
    for say, region, problem in (
        ("the value is not finite at x", huge, hf.backward_reachable_at),
        ("the grid cuts off region 'lane' at y = 1.3", beyond, hf.discriminating_kernel),
        ("of a region are NaN at some nodes", gap, hf.backward_reachable_tube),
    ):
        found = []
        for options in ({}, {"on_disk": tmp_path}):
            with pytest.raises(SimulationError) as error:
                problem(ROBOT, region, grid(y=9), 0.3, **options)
            found.append(str(error.value))
        assert found[0] == found[1]
        assert say in found[0]


def test_what_a_step_reads_and_writes_is_counted_by_passes_over_the_arrays(monkeypatch):
    counted = []

    def count(posed, *_):
        counted.append(posed)
        raise KeyboardInterrupt

    monkeypatch.setattr(one_march, "check_disk", count)
    for problem in (mirrored_kernel, mirrored_first, moving_kernel, moving_set):
        with pytest.raises(KeyboardInterrupt):
            problem(**SINGLE, on_disk=".")
    array = 21 * 24 * 20 * 4
    found = [[one / array for one in traffic(posed)] for posed in counted]
    half, turned = (12 + 2) / 24, (11 + 4) / 20  # with what it reads
    assert found == [[3 * half] * 2, [7 * turned, 3 * turned], [4, 4], [5, 5]]


@pytest.mark.parametrize("planes", [7, 8, 10])
def test_stages_follow_one_another_around_a_ring_that_is_hardly_longer_than_they_reach(
    tmp_path, planes
):
    ring = grid(TURNED, psi=planes)
    of_disk = hf.discriminating_kernel(TURNED, post(), ring, 0.4, on_disk=tmp_path)
    in_memory = hf.discriminating_kernel(TURNED, post(), ring, 0.4)
    assert (of_disk.values() == in_memory.values()).all()


def test_grids_that_cannot_be_cut_are_refused():
    with pytest.raises(SimulationError, match=r"the symmetry reflects 'psi', along which the grid"):
        hf.discriminating_kernel(
            TURNED, post(), grid(TURNED), 0.1, symmetry={"y": -1, "psi": -1},
            cluster=Here(count=2),
        )  # fmt: skip
    with pytest.raises(SimulationError, match="cluster: 'tcp://a:1'; expected a cluster; make one"):
        kernel(cluster="tcp://a:1")
    with pytest.raises(SimulationError, match="on_disk: 3; expected a folder"):
        kernel(on_disk=3)
    with pytest.raises(SimulationError, match="begin or until with a cluster"):
        kernel(cluster=Here(), until=lambda value: True, scheme="upwind")


def test_a_disk_that_is_full_or_cannot_be_written_is_refused_before_the_march(
    tmp_path, monkeypatch
):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"file/d cannot be written \(Not a directory"):
        kernel(on_disk=tmp_path / "file" / "d")
    large = hf.grid(ROBOT, {"x": (-2, 1), "y": (-1.3, 1.3), "psi": (0, 6.283185307179586)}, 8000,
                    {"x": "extrapolated"})  # fmt: skip
    with pytest.raises(OutputError, match=r"nodes take 1.91e\+04 GiB, and .* has .* GiB left"):
        hf.discriminating_kernel(ROBOT, post(), large, 0.1, on_disk=tmp_path)


def test_a_disk_for_the_answer_of_a_cluster_is_refused_before_the_march(tmp_path):
    (tmp_path / "file").write_text("")
    told = []
    with pytest.raises(OutputError, match=r"file/d cannot be written \(Not a directory"):
        tube(cluster=Here(count=2), on_disk=tmp_path / "file" / "d", progress=told.append)
    assert told == []


@pytest.mark.parametrize("problem", [basin, tube])
def test_all_large_arrays_of_a_march_from_a_disk_are_there(problem, tmp_path, monkeypatch):
    """Also those that bound it where leaving the grid is taken for lost, or for won."""
    held, begun = [], PosedMarch.__enter__

    def begin(march):
        bounds = (march._obstacles.upper, march._obstacles.lower)
        held.extend(a for a in (march.now(), *bounds) if a is not None)
        return begun(march)

    monkeypatch.setattr(PosedMarch, "__enter__", begin)
    problem(on_disk=tmp_path, check_outside=True)
    assert len(held) > 3
    assert all(a._mmap is not None for a in held)


def test_few_nodes_are_timed_of_a_grid_with_large_planes(tmp_path, monkeypatch):
    timed = []

    class Timed(MarchPart):
        def open(self):
            timed.append(len(self.now()))
            super().open()

    monkeypatch.setattr(disk_estimate, "MarchPart", Timed)
    monkeypatch.setattr(disk_estimate, "total_memory", lambda: 1e5)
    monkeypatch.setattr(disk_estimate, "PROBE", 2**20)
    monkeypatch.setattr(disk_estimate, "TIMED", 4000)
    with pytest.warns(SlowWarning):
        two_carts(on_disk=tmp_path)
    assert set(timed) == {7 * 7 * 8 * 10}


def test_how_slow_a_disk_is_is_said_beforehand(tmp_path, monkeypatch):
    monkeypatch.setattr("holdfast.analysis.reachability.disk_estimate.total_memory", lambda: 1e5)
    monkeypatch.setattr("holdfast.analysis.reachability.disk_estimate.PROBE", 2**20)
    said = (
        r"the arrays take 0.000.* GiB of .*: where nothing is settled a step takes about .* times"
    )
    with pytest.warns(SlowWarning, match=said):
        found = tube(on_disk=tmp_path)
    same(tube(), found)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        monkeypatch.setattr(
            "holdfast.analysis.reachability.disk_estimate.total_memory", resources.total_memory
        )
        tube(on_disk=tmp_path)
