"""What a controller measures and remembers is decided once, and every target prints the same."""

import re

import pytest

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.execution.codegen.closed_loop_program import closed_loop_program, controller_program
from holdfast.execution.simulation.settings import RK4
from holdfast.interop.numeric_system import closed_expressions
from holdfast.maths.definitions.system import Measurement

X, V, A, W, Z = map(hf.symbol, "xvawz")
CART = hf.System(
    "cart",
    states=(hf.Quantity("x"), hf.Quantity("v")),
    inputs=(hf.Quantity("a"),),
    disturbances=(hf.Quantity("w"), hf.Quantity("tide")),
    rates={"x": V, "v": A + W + hf.symbol("tide")},
    input_bounds=hf.Box((-1,), (1,)),
    measurements=(Measurement("range", expression=2 * X),),
)
RANGE = CART.measurements[0]


def law(name, outputs, *reads, **more):
    return hf.Law(name, reads, outputs, **more)


def of_range():
    return law("of range", {"a": -RANGE.symbol - W}, RANGE, CART.disturbances[0])


def remembering():
    memory = hf.Memory(
        (hf.Quantity("z"),), {"z": X}, {"z": Z + A}, reads=CART.states, inputs=CART.inputs
    )
    modes = {
        "near": law("near", {"a": -X - Z}, *CART.states, hf.Quantity("z")),
        "far": law("far", {"a": -V}, *CART.states),
    }
    leaving = (hf.Transition("near", "far", X - 1), hf.Transition("far", "near", 0.5 - X))
    return hf.Switching("two", modes, leaving, initial="far", memory=memory)


def test_measurements_are_written_out_and_measured_disturbances_follow_the_states():
    program = controller_program(CART, of_range())
    assert [q.name for q in program.seen] == ["x", "v", "w"]
    assert program.commands("of range") == [-2 * X - W]
    assert program.remembered == ()


def test_modes_guards_and_memory_are_in_order():
    program = controller_program(CART, remembering())
    assert program.modes == ("near", "far")
    assert program.initial_mode == 1
    assert program.transitions == {"near": [(X - 1, 1)], "far": [(0.5 - X, 0)]}
    assert (program.initial_memory, program.next_memory) == ([X], [Z + A])
    with pytest.raises(DefinitionError, match="has modes"):
        program.check_function_of_state()


@pytest.mark.parametrize("made", [of_range, remembering])
def test_the_compiled_loop_and_c_see_the_same(made):
    """Both unpack every quantity that the law sees from the same place."""
    program = controller_program(CART, made())
    loop = closed_loop_program(CART, made(), region=None, goal=None, disturbance={}, stepper=RK4)
    text = hf.export_c(CART, made())
    assert loop.modes == program.modes
    assert loop.remembered == tuple(q.name for q in program.remembered)
    for place, quantity in enumerate(program.seen):
        assert f"seen[{place}]: {quantity.name}" in text
    assert len(re.findall(r"mode \d+: ", text)) == len(program.modes)


MISFITS = {
    "gives b": law("other", {"b": X}, *CART.states),
    "reads 'z', which is neither a state": law("odd", {"a": -Z}, *CART.states, hf.Quantity("z")),
}


@pytest.mark.parametrize("told", MISFITS)
def test_every_target_refuses_a_law_that_does_not_fit_with_the_same_message(told):
    def compiled(system, law):
        closed_loop_program(system, law, region=None, goal=None, disturbance={}, stepper=RK4)

    said = []
    for target in (compiled, hf.export_c, hf.export_c_header, closed_expressions):
        with pytest.raises(DefinitionError, match=told) as caught:
            target(CART, MISFITS[told])
        said.append(str(caught.value))
    assert len(set(said)) == 1


def test_function_of_the_state_is_closed_within_its_bounds():
    rates, inputs, _ = closed_expressions(CART, of_range())
    assert [e.subs({X: 3, W: 0}) for e in inputs] == [-1]
    assert [e.subs({X: 0.25, V: 0, W: 0.1, hf.symbol("tide"): 0}) for e in rates] == pytest.approx(
        [0, -0.5]
    )
