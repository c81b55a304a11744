"""Reachable tubes and the sets at exactly a time, beside closed forms; former names."""

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import RenamedWarning, SimulationError

x, y, u = (hf.symbol(n) for n in ("x", "y", "u"))
LINE = (hf.Quantity("x", "m"),)
NEAR = hf.Region("near", LINE, (hf.Inequality("far", sp.Abs(x) - 0.2, "m"),))
ENDS = {"x": "extrapolated"}


def river():
    return hf.System("river", LINE, (), {"x": sp.Integer(1)})


def boat():
    inputs = (hf.Quantity("u", "m/s"),)
    return hf.System("boat", LINE, inputs, {"x": 1 + u}, input_bounds=hf.Box((-0.5,), (0.5,)))


def grid(system):
    return hf.grid(system, {"x": (-3, 3)}, 301, ENDS)


@pytest.mark.parametrize(
    ("system", "seconds", "at", "tube"),
    [
        (river(), 1.0, (-1.2, -0.8), (-1.2, 0.2)),
        (boat(), 1.0, (-1.7, -0.3), (-1.7, 0.2)),  # 0.5 to 1.5 m/s
    ],
)
def test_set_at_a_time_is_not_the_tube_up_to_it(system, seconds, at, tube):
    inside = grid(system)
    for function, (low, high) in (
        (hf.backward_reachable_at, at),
        (hf.backward_reachable_tube, tube),
    ):
        found = function(system, NEAR, inside, seconds)
        nodes = inside.axes[0].nodes
        members = nodes[found.values() > 0]
        assert (members.min(), members.max()) == pytest.approx((low, high), abs=0.03)
        assert found.dataset.attrs["reached_s"] == seconds


def test_turning_target_comes_round_again():
    """After a whole turn the set is the target itself; the tube is the ring that it swept."""
    plane = (hf.Quantity("x"), hf.Quantity("y"))
    system = hf.System("turn", plane, (), {"x": -y, "y": x})
    disc = hf.Region("disc", plane, (hf.Inequality("far", (x - 1) ** 2 + y**2 - 0.16),))
    box = {"x": (-2, 2), "y": (-2, 2)}
    over = hf.grid(system, box, 101, dict.fromkeys(box, "extrapolated"))
    back = hf.backward_reachable_at(system, disc, over, 2 * np.pi)
    swept = hf.backward_reachable_tube(system, disc, over, 2 * np.pi)
    assert back.contains([[1.0, 0.0]]).all()
    assert not back.contains([[-1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]).any()
    assert swept.contains([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]]).all()
    half = hf.backward_reachable_at(system, disc, over, np.pi)
    assert half.contains([[-1.0, 0.0]]).all()
    assert not half.contains([[1.0, 0.0]]).any()


def test_former_name_is_the_tube_with_a_warning(tmp_path):
    with pytest.warns(RenamedWarning, match="is now backward_reachable_tube"):
        before = hf.backward_reachable_set(river(), NEAR, grid(river()), 0.5)
    now = hf.backward_reachable_tube(river(), NEAR, grid(river()), 0.5)
    assert np.array_equal(before.values(), now.values())
    file = tmp_path / "river.toml"
    file.write_text("""
[scenario]
title = "a river"
kind = "backward-reachable-set"
[system]
states = { x = { unit = "m" } }
rates = { x = "1" }
[goal]
constraints = { far = "abs(x) - 0.2" }
[grid]
nodes = 31
box = { x = [-3, 3] }
ends = { x = "extrapolated" }
[march]
horizon = 0.5
""")
    with pytest.warns(RenamedWarning, match="is now 'backward-reachable-tube'"):
        loaded = hf.load_scenario(str(file))
    assert loaded.kind == "backward-reachable-tube"
    assert loaded.solve().contains([[-0.6], [0.0]]).all()


def test_set_at_a_time_refuses_what_is_about_tubes():
    with pytest.raises(SimulationError, match="ask for the tube"):
        hf.backward_reachable_at(river(), NEAR, grid(river()), 0.5, check_outside=True)
