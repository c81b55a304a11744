"""What a log depends on: the states that move what is measured, and the slopes of their rates."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.leaf import Evaluator
from holdfast.maths.identification import measured_motion

ALL = ("x", "y", "psi", "u", "v", "r")


def test_motion_has_only_the_states_that_the_measured_ones_depend_on():
    otter = hf.load_vehicle("otter")
    motion = measured_motion(otter, ["u", "v", "r"], ["Xu", "Vx", "current_limit"])
    assert [q.name for q in motion.states] == ["u", "v", "r"]
    assert [q.name for q in motion.unknown] == ["Xu"]
    motion = measured_motion(otter, ["psi"], ["Xu"])
    assert [q.name for q in motion.states] == ["psi", "u", "v", "r"]


def test_slopes_of_rates_and_outputs_are_those_of_finite_differences():
    otter = hf.load_vehicle("otter")
    over_ground = hf.parse_expression(
        "u + Vx*cos(psi) + Vy*sin(psi)", {n: hf.symbol(n) for n in ("u", "Vx", "Vy", "psi")}
    )
    unknown = [*(p.name for p in otter.parameters), "Vx", "Vy"]
    motion = measured_motion(otter, ALL, unknown, {"u": over_ground})
    random = np.random.default_rng(0)
    n, m = len(motion.states), len(motion.unknown)
    values = {p.name: p.value for p in otter.parameters}
    point = random.uniform(-1, 1, n + len(motion.inputs) + m)
    point[-m:] = [values.get(q.name, 0.1) for q in motion.unknown]
    for expressions, count in (
        (motion.sensitivities, len(motion.rates)),
        (motion.output_sensitivities, len(motion.outputs)),
    ):
        compute = Evaluator(expressions, motion.columns, motion.parameters)
        found = compute.values(point[None, :])[0]
        for first, width, offset in ((0, n, 0), (n + len(motion.inputs), m, n)):
            start = count + count * offset
            slopes = found[start : start + count * width].reshape(count, width)
            for k in range(width):
                h = 1e-6 * max(abs(point[first + k]), 0.1)
                ends = np.repeat(point[None, :], 2, axis=0)
                ends[:, first + k] += [h, -h]
                high, low = compute.values(ends)[:, :count]
                assert slopes[:, k] == pytest.approx((high - low) / (2 * h), rel=1e-5, abs=1e-8)


def test_names_that_are_not_there_and_rates_of_time_are_refused():
    otter = hf.load_vehicle("otter")
    with pytest.raises(DefinitionError, match="no parameter 'Xuv'"):
        measured_motion(otter, ["u"], ["Xuv"])
    with pytest.raises(DefinitionError, match="no state of system"):
        measured_motion(otter, ["speed"], ["Xu"])
    with pytest.raises(DefinitionError, match="the log has no signal 'v'"):
        measured_motion(otter, ["u"], ["Xu"], {"v": hf.symbol("v")})
    with pytest.raises(DefinitionError, match="undeclared name 'wind'"):
        measured_motion(otter, ["u"], ["Xu"], {"u": hf.symbol("u") + hf.symbol("wind")})
    swinging = hf.System(
        "swinging",
        (hf.Quantity("x", "m"),),
        (),
        {"x": hf.parse_expression("sin(t)", {"t": hf.TIME})},
    )
    with pytest.raises(DefinitionError, match="depend on time"):
        measured_motion(swinging, ["x"], [])
