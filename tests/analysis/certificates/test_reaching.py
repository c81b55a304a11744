"""Reach-avoid: from every certified cell a target is reached in the time that is said."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import SimulationError
from holdfast_check.checker import NotValidError, check
from tests.certified_systems import changed, rows, to_goal

X, W, V = (hf.symbol(n) for n in "xwv")


def runner(push=0.0):
    """x' = v + w on a line from 0 to 1, the target its first tenth."""
    system = hf.System(
        "runner", (hf.Quantity("x", "m"),), (hf.Quantity("v", "m/s"),), {"x": V + W},
        disturbances=(hf.Quantity("w", "m/s"),), disturbance_bounds=hf.Box((-push,), (push,)),
        input_bounds=hf.Box((-1.0,), (1.0,)),
    )  # fmt: skip
    return system, rows("line", system, (-X, X - 1)), rows("goal", system, (X - 0.125,))


@pytest.fixture(scope="module")
def parked():
    return to_goal()


def test_cells_are_as_many_holds_away_as_the_distance_needs():
    """Cells of 1/16 m, holds of 0.13 s at 1 m/s: two cells a hold, none lost to rounding."""
    found = hf.certify(*runner()[:2], target=runner()[2], box={"x": (0, 1)}, cells=16,
                       sample_time=0.13, inputs=5)  # fmt: skip
    assert found.kept.members.tolist() == list(range(2, 16))
    assert found.kept.entries[:, 2].tolist() == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7]
    assert found.kept.holds == 7


def test_push_that_is_as_strong_as_the_runner_keeps_all_from_the_target():
    for push, some in ((0.5, True), (1.1, False)):
        system, line, goal = runner(push)
        found = hf.certify(system, line, target=goal, box={"x": (0, 1)}, cells=64)
        assert bool(len(found.kept.members)) == some


def test_horizon_counts():
    system, line, goal = runner()
    found = hf.certify(system, line, target=goal, box={"x": (0, 1)}, cells=16, sample_time=0.13,
                       horizon=0.26)  # fmt: skip
    assert found.kept.members.tolist() == [2, 3, 4, 5]


def test_goal_behind_a_block_is_reached_in_closed_loop_in_the_time_that_is_said(parked):
    """2,000 starts, the current at a bound that changes at random: in the room, at the goal."""
    cells, kept = parked.cells, parked.kept
    assert kept.share > 0.6
    levels = np.full(int(np.prod(cells.counts)), -1)
    inputs = levels.copy()
    levels[kept.entries[:, 0]], inputs[kept.entries[:, 0]] = kept.entries[:, 2], kept.entries[:, 1]
    generator = np.random.default_rng(3)
    low, high = cells.corners(generator.choice(kept.members, 2000))
    q = low + (high - low) * generator.random(low.shape)
    level, under_way = None, np.ones(len(q), dtype=bool)
    while under_way.any():
        turned = q.copy()
        turned[:, 2] = (q[:, 2] + np.pi) % (2 * np.pi) - np.pi
        place = [np.searchsorted(e, turned[:, k], side="right") - 1
                 for k, e in enumerate(cells.edges)]  # fmt: skip
        flat = np.ravel_multi_index(place, cells.counts, mode="clip")
        at_goal = (q[:, 0] >= 2.2) & (q[:, 1] <= 0.8)
        under_way &= ~(at_goal & (levels[flat] < 0))
        now = levels[flat]
        assert (now[under_way] > 0).all()
        if level is not None:
            assert (now < level)[under_way].all()
        level = now
        u, r = parked.candidates[inputs[flat]].T
        for _ in range(10):
            w = generator.choice([-0.05, 0.05], len(q))
            middle = q[:, 2] + 0.0125 * r
            rates = np.stack([u * np.cos(middle) + w, u * np.sin(middle), r], axis=1)
            q = np.where(under_way[:, None], q + 0.025 * rates, q)
            x, y = q[:, 0], q[:, 1]
            depth = np.minimum(np.minimum(x - 1.0, 1.4 - x), 1.1 - y)
            assert max(depth.max(), -x.min(), x.max() - 3, -y.min(), y.max() - 2) < 1e-3


def test_checker_agrees_and_finds_what_is_wrong(parked, tmp_path):
    path = parked.write(tmp_path / "parked.certificate")
    assert "cells reach the target within" in check(str(path), share=0.05)

    def farther(header):
        header["target"][0]["expression"] = "5/2 - x"

    def slower(header):
        header["rates"][0] = "9*u*cos(psi)/10 + w"

    def nearer(raw):
        rows = np.frombuffer(raw, dtype=[("c", "<u4"), ("i", "<u2"), ("l", "<u4")]).copy()
        rows["l"] = np.maximum(rows["l"] - 1, 1)
        return rows.tobytes()

    def staying(header):
        header["target"] = []

    for alter, entries in ((farther, None), (slower, None), (lambda h: None, nearer)):
        with pytest.raises(NotValidError, match=r"which is not kept|may fail on the way"):
            check(str(changed(path, alter, entries=entries)), share=0.2, seed=0)
    with pytest.raises(NotValidError):
        check(str(changed(path, staying)), share=0.2, seed=0)


def test_goal_that_no_cell_lies_in_is_refused():
    system, line, _ = runner()
    tiny = rows("tiny", system, (X - 0.01,))
    with pytest.raises(SimulationError, match="no cell lies in 'tiny'"):
        hf.certify(system, line, target=tiny, box={"x": (0, 1)}, cells=16)
