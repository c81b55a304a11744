"""A region without an end along an axis: the advice that is given ends the search for a grid."""

import math
import re
from dataclasses import replace

import pytest

import holdfast as hf
from holdfast.errors import SimulationError

ROBOT = hf.systems.unicycle()
TURN = (-math.pi, math.pi)


def kernel(region, along):
    """Over the poses up to so many metres along the wall."""
    box = {"x": (-2.2, 0.1), "y": (-along, along), "psi": TURN}
    over = hf.grid(ROBOT, box, {"x": 24, "y": 15, "psi": 25})
    return hf.viability_kernel(ROBOT, region, over, horizon=0.1)


@pytest.mark.parametrize("along", [2.0, 4.0, 400.0])
def test_region_without_an_end_is_told_from_one_that_the_grid_cuts_off(along):
    """A camera that looks along the wall sees its target from any distance."""
    region = replace(hf.regions.camera_view(), name="seen")
    with pytest.raises(SimulationError) as refusal:
        kernel(region, along)
    said = str(refusal.value)
    assert "region 'seen' has no end along 'y', and no grid contains it" in said
    assert "widen" not in said
    assert f"to region '{region.name}', or give ends" in said
    assert float(re.search(r"constraint abs\(y\) - ([\d.e+]+) <= 0", said)[1]) < along


def test_advice_for_a_region_without_an_end_is_the_last_one():
    value = kernel(hf.regions.camera_view(along_wall=1.8), 2.0)
    assert not value.summary()["empty"]
    with pytest.raises(SimulationError, match=r"cuts off region 'camera_view' at y = -2; .*widen"):
        kernel(hf.regions.camera_view(along_wall=2.5), 2.0)
    assert kernel(hf.regions.camera_view(along_wall=2.5), 2.8) is not None


def test_camera_view_ends_where_along_wall_says():
    view = hf.regions.camera_view(along_wall=1.5)
    assert [c.name for c in view.inequalities][4:] == ["too_high", "too_low"]
    at = {p.symbol: p.value for p in view.parameters}
    for y, inside in ((1.4, True), (1.6, False), (-1.4, True), (-1.6, False)):
        heading = -math.copysign(math.radians(70), y)
        pose = {hf.symbol("x"): -0.3, hf.symbol("y"): y, hf.symbol("psi"): heading}
        margin = float(view.margin.subs(at | pose).evalf())
        assert (margin > 0) == inside, y
    assert len(hf.regions.camera_view().inequalities) == 4
