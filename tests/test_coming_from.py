"""The programs of docs/coming_from.md: what ours answer, and that those of the peers answer the same."""

import re
from pathlib import Path

import coming_from
import numpy as np
import pytest

PAGE = (Path(__file__).parent.parent / "docs/coming_from.md").read_text("utf-8")


@pytest.fixture(scope="module")
def ours():
    """What each of our programs computes, run once."""
    answers = {}

    def of(peer):
        if peer not in answers:
            answers[peer] = coming_from.run(peer, "ours")
        return answers[peer]

    return of


def test_page_shows_every_program_once():
    shown = re.findall(r'^--8<-- "benchmarks/side_by_side/(\w+)\.py"$', PAGE, re.M)
    assert sorted(shown) == sorted(p.stem for p in coming_from.PROGRAMS.glob("*.py"))
    assert sorted(shown) == sorted(f"{p}_{h}" for p in coming_from.PEERS for h in ("peer", "ours"))


def exact_distance(x, y, psi):
    """The most that a Dubins car of speed 1 and turn 1 keeps between itself and a disc of radius 1.

    Heading away it goes straight on; else it turns as fast as it can, until it is nearest.
    """
    now = np.hypot(x, y)
    turns = [np.abs(np.hypot(x - s * np.sin(psi), y + s * np.cos(psi)) - 1) for s in (1, -1)]
    nearest = np.minimum(now, np.maximum(*turns))
    return np.where(x * np.cos(psi) + y * np.sin(psi) >= 0, now, nearest) - 1


def test_dubins_car_that_cannot_avoid_a_disc_is_called_so(ours):
    """But for nodes a few millimetres from the exact boundary, of cells of 15 cm."""
    answer = ours("hj_reachability")
    nodes = np.meshgrid(*(a.nodes for a in answer["grid"].axes), indexing="ij")
    exact = exact_distance(*nodes)
    wrong = (answer["avoid"] <= 0) != (exact <= 0)
    assert (wrong.size, wrong.sum()) == (67_240, 49)
    assert np.abs(exact[wrong]).max() < 4e-3
    assert answer["grid"].axes[0].step == pytest.approx(0.15)


def test_puck_goes_around_the_disc(ours):
    path = ours("cbfpy")["path"]
    assert len(path) == 500
    assert np.hypot(path[:, 0], path[:, 1]).min() > 1
    assert np.linalg.norm(path[-1] - [3, 0, 0, 0]) < 0.05


def test_pendulum_comes_to_rest_under_the_gain_of_python_control(ours):
    answer = ours("control")
    assert answer["gain"] == pytest.approx(np.full((1, 2), 1 + np.sqrt(2)))
    assert abs(answer["angles"][-1]) < 1e-3


def test_car_has_least_times_where_it_arrives_and_none_elsewhere(ours):
    answer = ours("casadi")
    assert answer["grid"].axes[0].step == pytest.approx(0.15)
    assert answer["least"] == pytest.approx([4.11, 4.47, np.nan], abs=5e-3, nan_ok=True)


@pytest.mark.peer
@pytest.mark.parametrize("peer", coming_from.PEERS)
def test_the_peer_gives_the_same_answer(peer, ours):
    pytest.importorskip(peer, reason=f"{peer} is not installed (extra: benchmark)")
    theirs = coming_from.run(peer, "peer")
    differences = coming_from.apart(peer, theirs, ours(peer))
    if peer == "hj_reachability":
        assert (differences["nodes"], differences["avoid: nodes that differ"]) == (67_240, 0)
        assert differences["avoid: 99 % of the values within [m]"] < 5e-3
        assert differences["reach: nodes that differ"] <= 112
        assert differences["reach: these are as near to the boundary as [m]"] < 0.021
    elif peer == "casadi":
        assert theirs["least"] == pytest.approx([3.854, 4.289, np.nan], abs=5e-4, nan_ok=True)
        later = [*differences.values()]
        assert later == pytest.approx([0.25, 0.18, np.nan], abs=5e-3, nan_ok=True)
    else:
        assert differences["largest difference"] < {"cbfpy": 1e-8, "control": 1e-6}[peer]
