"""The values at every node beside those of hj_reachability, where it is installed.

python -m pip install -e ".[test,benchmark]" && python -m pytest -m peer
"""

import numpy as np
import pytest

pytest.importorskip("hj_reachability", reason="hj_reachability is not installed (extra: benchmark)")
import jax
from level_sets import OURS, Peer, aircraft, game, limited_weno5

pytestmark = pytest.mark.peer

PROBLEMS = {"aircraft": aircraft((51, 40, 50), 60), "game": game(51, 40)}

BEYOND_ENDS = {"upwind": 5e-4, "weno5": 5e-5}
"""What the set of the game differs by: beyond lost ends of the grid, and far below zero, our values
do not go on as they do there."""


@pytest.fixture(params=["float64", "float32"])
def precision(request):
    """Of both: JAX has one for the whole process."""
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", request.param == "float64")
    yield request.param
    jax.config.update("jax_enable_x64", before)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize(("scheme", "slopes"), [("upwind", None), ("weno5", limited_weno5)])
def test_values_are_those_of_hj_reachability_with_the_same_slopes(name, scheme, slopes, precision):
    problem = PROBLEMS[name]
    ours, said = problem.march(scheme, precision=precision)
    theirs = Peer(problem, scheme, slopes).march()[0]
    assert said["steps"] == problem.steps / OURS[scheme].lengths
    assert ours.dtype == theirs.dtype == precision
    assert np.abs(ours - problem.margin).max() > 0.2, "something has happened"
    rounding = {"float64": 1e-11, "float32": 2e-4}[precision]
    if name == "aircraft":
        assert ours == pytest.approx(theirs, abs=rounding)
        return
    near = theirs > -0.1
    assert ours[theirs > 0] == pytest.approx(theirs[theirs > 0], abs=rounding + BEYOND_ENDS[scheme])
    assert np.median(np.abs(ours - theirs)[near]) < rounding
    assert not ((ours > 0) & (theirs <= 0)).any()


@pytest.mark.parametrize("precision", ["float64"], indirect=True)
def test_slopes_that_are_not_limited_keep_what_the_current_takes(precision):
    """The game for a second on 51 nodes, beside a march of first order on 101.

    hj_reachability's own fifth-order slopes hold ridges between the nodes up: a tenth more is kept.
    """
    problem = game(51, 85)
    ours, theirs = problem.march("weno5")[0], Peer(problem, "weno5").march()[0]
    fine = game(101, round(85 * 100 / 50))
    assert fine.final == pytest.approx(problem.final, rel=1e-9)
    known = fine.march("upwind")[0][::2, ::2, ::2]
    apart = np.abs(ours - theirs) > 0.05
    assert apart.mean() > 0.03
    assert np.median(np.abs(ours - known)[apart]) < 0.02
    assert np.median(np.abs(theirs - known)[apart]) > 0.1
    assert (ours > 0).sum() == pytest.approx((known > 0).sum(), rel=0.03)
    assert (theirs > 0).sum() > 1.1 * (ours > 0).sum()
