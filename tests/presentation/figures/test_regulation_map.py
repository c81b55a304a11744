"""The regulation map as a picture: everything it shows lies where it says."""

import math

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Polygon

import holdfast as hf
from holdfast.errors import OutputError


def drawn(state):
    found = hf.regulation_map(hf.systems.marine_vehicle(), hf.regions.camera_view(), state)
    figure = hf.regulation_map_figure(found)
    axis = figure.axes[0]
    patches = [p.get_xy() for p in axis.patches if isinstance(p, Polygon)]
    title = axis.get_title()
    plt.close(figure)
    return found, patches, title


def test_green_patch_is_the_regulation_map_inside_the_thrusters_parallelogram():
    found, patches, title = drawn([-0.35, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert title == ""
    assert {tuple(np.round(p, 9)) for p in patches[0]} == {(10, 0), (0, 1), (-10, 0), (0, -1)}
    assert {tuple(np.round(p, 9)) for p in patches[1]} == {
        tuple(np.round(v, 9)) for v in found.vertices
    }
    assert found.vertices[:, 0].max() == pytest.approx(0, abs=1e-9)


def test_lost_state_is_drawn_empty_with_its_reason():
    found, patches, title = drawn([-0.35, 0.0, 0.0, 0.2, 0.0, 0.0])
    assert found.empty
    assert len(patches) == 1
    assert title == "empty: too near"


def test_one_input_cannot_be_drawn():
    x, v, a = (hf.symbol(n) for n in "xva")
    states = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
    cart = hf.System(
        "cart", states, (hf.Quantity("a"),), {"x": v, "v": a}, input_bounds=hf.Box((-1,), (1,))
    )
    room = hf.Region("room", states, (hf.Inequality("wall", x - math.pi, "m"),))
    with pytest.raises(OutputError, match="1 inputs cannot be drawn"):
        hf.regulation_map_figure(hf.regulation_map(cart, room, [0.0, 0.0]))
