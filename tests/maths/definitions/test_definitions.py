"""What contradicts itself is refused, with cause, expectation and remedy."""

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import Lookup

X, Y, PSI, V = (hf.symbol(n) for n in ("x", "y", "psi", "v"))
STATES = (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True))
SPEED = (hf.Quantity("v", "m/s"),)
RATES = {"x": V * sp.cos(PSI), "y": V * sp.sin(PSI), "psi": sp.S.Zero}


def system(**changes):
    given = {"name": "s", "states": STATES, "inputs": SPEED, "rates": RATES} | changes
    return hf.System(**given)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"rates": {"x": V, "y": V}}, "'psi' has no rate"),
        ({"rates": RATES | {"z": V}}, "'z' has a rate but is not a state"),
        ({"rates": RATES | {"psi": hf.symbol("omega")}}, "undeclared name 'omega'"),
        ({"inputs": (hf.Quantity("x", "m"),)}, "declares 'x' twice"),
        ({"input_bounds": hf.Box((-1, -1), (1, 1))}, "dimension 2; expected 1"),
        ({"input_bounds": hf.Box((-hf.symbol("F"),), (1,))}, "undeclared name 'F'"),
        ({"pfaffian": (hf.PfaffianRow({"x": 1}),)}, "leave Pfaffian row 1"),
        ({"pfaffian": (hf.PfaffianRow({"z": 1}),)}, "'z', which is not a state"),
        ({"states": ()}, "no states"),
    ],
)
def test_contradictory_system_is_refused(changes, complaint):
    with pytest.raises(DefinitionError) as caught:
        system(**changes)
    assert complaint in str(caught.value)


def test_rates_that_respect_the_pfaffian_constraint_are_accepted():
    row = hf.PfaffianRow({"x": -sp.sin(PSI), "y": sp.cos(PSI)})
    assert system(pfaffian=(row,)).pfaffian == (row,)


@pytest.mark.parametrize("name", ["", "2x", "lambda", "sin", "t", "a b", "x.y"])
def test_reserved_or_malformed_names_are_refused(name):
    with pytest.raises(DefinitionError):
        hf.Quantity(name)


def test_an_angle_is_in_radians():
    with pytest.raises(DefinitionError, match="unit 'deg'"):
        hf.Quantity("psi", "deg", angle=True)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), True, "3"])
def test_parameter_without_a_finite_number_is_refused(value):
    with pytest.raises(DefinitionError):
        hf.Parameter("k", value=value)


def test_one_parameter_name_is_one_number():
    one, other = hf.Parameter("k", value=1.0), hf.Parameter("k", value=2.0)
    with pytest.raises(DefinitionError, match="declared twice: 1 1 and 2 1"):
        hf.Law("law", STATES, {"v": X}, parameters=(one, other))


def test_law_reads_only_what_it_declares():
    with pytest.raises(DefinitionError, match="undeclared name 'y'"):
        hf.Law("law", STATES[:1], {"v": X + Y})


def test_switching_refuses_unknown_modes_and_unequal_outputs():
    go, stop = hf.Law("go", STATES, {"v": sp.S.One}), hf.Law("stop", STATES, {"w": sp.S.Zero})
    with pytest.raises(DefinitionError, match="the same outputs in every mode"):
        hf.Switching("s", {"go": go, "stop": stop})
    with pytest.raises(DefinitionError, match="did you mean 'go'"):
        hf.Switching("s", {"go": go}, (hf.Transition("go", "gone", X),))
    with pytest.raises(DefinitionError, match="undeclared name 'z'"):
        hf.Switching("s", {"go": go}, (hf.Transition("go", "go", hf.symbol("z")),))


def test_guards_read_no_kernel():
    """A law and its signals may; the modes are chosen before it is looked up."""
    lookup = Lookup((X,), None)
    go = hf.Law("go", (hf.Quantity("x", "m"),), {"u": lookup.value}, lookup=lookup)
    hf.Switching("s", {"go": go}, signals={"V": lookup.value})
    with pytest.raises(DefinitionError, match="guard go -> go"):
        hf.Switching("s", {"go": go}, (hf.Transition("go", "go", lookup.value),))


def test_region_refuses_duplicate_and_undeclared_names():
    with pytest.raises(DefinitionError, match="'c' twice"):
        hf.Region("r", STATES, (hf.Inequality("c", X), hf.Inequality("c", Y)))
    with pytest.raises(DefinitionError, match="undeclared name 'v'"):
        hf.Region("r", STATES, (hf.Inequality("c", V),))
    with pytest.raises(DefinitionError, match="no inequalities"):
        hf.Region("r", STATES, ())


def test_margin_of_chapter_7_is_minus_the_worst_inequality():
    region = hf.Region("r", STATES, (hf.Inequality("a", X), hf.Inequality("b", Y)))
    assert float(region.margin.subs({X: -0.2, Y: -0.5})) == pytest.approx(0.2)


def test_promoting_states_keeps_the_subsystem_and_refuses_what_inputs_drive(vehicle):
    kinematic = hf.promote(vehicle, ("u", "r"))
    assert kinematic.state_names == ("x", "y", "psi", "v")
    assert kinematic.input_names == ("u", "r")
    with pytest.raises(DefinitionError, match="depends on an input"):
        hf.promote(vehicle, ("u",))
    with pytest.raises(DefinitionError, match="did you mean 'psi'"):
        hf.promote(vehicle, ("psy",))
