"""Expressions whose units do not fit are refused, and no others are.

The judge shares nothing with the check: an expression has a unit exactly where numbers in other
units give the same quantity, e(s q) = s^d e(q).
"""

import math
import random
from dataclasses import replace

import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError, HoldfastError
from holdfast.maths.catalogue.signature import example
from holdfast.maths.definitions.quantity import _dimension_by_library, alike, dimension
from holdfast.maths.definitions.system import check_output_units
from holdfast.maths.definitions.units import Units
from holdfast.maths.definitions.vehicle_file import vehicle_names
from holdfast.maths.expressions.functions import (
    angle,
    clip,
    greatest,
    least,
    length,
    magnitude,
    select,
    sgn,
    wrap,
)
from holdfast.maths.nonholonomic.structure import kinematic_system
from holdfast.scenario.files import scenario_names

BASE = ("m", "s", "kg")
SCALES = {"m": 1.7, "s": 0.6, "kg": 1.3}
GUARD = sp.Float(1e-40)


def unit_of(powers):
    """The text of a unit with these powers of m, s and kg."""
    return " ".join(f"{n}^{p}" for n, p in zip(BASE, powers, strict=True) if p) or "1"


class Growing:
    """A random tree of a unit, and the units of its symbols."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.units = {}

    def leaf(self, powers):
        alike = [n for n, p in self.units.items() if p == powers]
        if alike and self.random.random() < 0.4:
            return hf.symbol(self.random.choice(alike))
        name = f"q{len(self.units)}"
        self.units[name] = powers
        return hf.symbol(name)

    def any_unit(self):
        return tuple(self.random.randint(-1, 1) for _ in BASE)

    def tree(self, powers, depth):
        if depth == 0:
            return self.leaf(powers)

        def of(p=powers):
            return self.tree(p, depth - 1)

        def level(parts=(1, 1, 2, 3)):
            units = [of(self.any_unit()) for _ in range(self.random.choice(parts))]
            return ({2: least, 3: select}.get(len(units)) or (lambda only: only))(*units)

        other = self.any_unit()
        sums = {
            "sum": lambda: of() + of(),
            "difference": lambda: of() - of(),
            "product": lambda: (
                of(other) * of(tuple(p - q for p, q in zip(powers, other, strict=True)))
            ),
            "quotient": lambda: (
                of(tuple(p + q for p, q in zip(powers, other, strict=True))) / of(other)
            ),
            "root": lambda: sp.sqrt(magnitude(of(tuple(2 * p for p in powers)))),
            "length": lambda: length(of(), of(), GUARD),
            "least": lambda: least(of(), of()),
            "greatest": lambda: greatest(of(), of()),
            "clip": lambda: clip(of(), of(), of()),
            "magnitude": lambda: magnitude(of()),
            "choice": lambda: select(least(level(), level()), of(), of()),
            "sign": lambda: sgn(level()) * of(),
        }
        if all(p % 2 == 0 for p in powers):
            sums["square"] = lambda: of(tuple(p // 2 for p in powers)) ** 2
        if not any(powers):
            bounded = self.random.choice((sp.sin, sp.cos, sp.tanh, sp.atan))
            sums |= {
                "function": lambda: bounded(of()) * of(),
                "angle": lambda: angle(*(self.tree(other, depth - 1) for _ in "yx"), GUARD),
                "wrap": lambda: wrap(of()),
            }
        return sums[self.random.choice(sorted(sums))]()


def grown(seed):
    made = Growing(seed)
    powers = made.any_unit()
    return made.tree(powers, 3), powers, made


def has_numbers(e):
    return any(
        p.is_Mul and p.args[0].is_Number and p.args[0] != -1 for p in sp.preorder_traversal(e)
    )


def judged(e, powers, units, generator):
    """Whether numbers in other units give another quantity at one of many points."""
    factor = math.prod(SCALES[n] ** p for n, p in zip(BASE, powers, strict=True))
    for _ in range(6):
        point = {hf.symbol(n): generator.uniform(0.5, 2.0) for n in units}
        scaled = {
            s: v * math.prod(SCALES[n] ** p for n, p in zip(BASE, units[s.name], strict=True))
            for s, v in point.items()
        }
        here, there = (
            complex(e.xreplace({s: sp.Float(v) for s, v in values.items()}))
            for values in (point, scaled)
        )
        if not all(math.isfinite(n.real) and n.imag == 0 for n in (here, there)):
            continue
        if abs(there.real - factor * here.real) > 1e-6 * max(abs(there.real), 1e-6):
            return True
    return False


def refused(e, powers, units):
    quantities = [hf.Quantity(n, unit_of(p)) for n, p in units.items()]
    checked = Units("a tree", quantities)
    try:
        checked.check(e, "it", dimension(unit_of(powers)), "asked for")
    except DefinitionError:
        return True
    return False


@pytest.mark.parametrize("part", range(4))
def test_expressions_of_one_unit_pass_and_those_of_another_are_refused(part):
    wrong = 0
    for seed in range(60 * part, 60 * part + 60):
        e, powers, made = grown(seed)
        assert not refused(e, powers, made.units), e
        names = sorted(s.name for s in e.free_symbols)
        if not names or has_numbers(e) or e.has(sp.zoo):  # x + x is 2 x, whose 2 may have a unit
            continue
        name = made.random.choice(names)
        axis = made.random.randrange(len(BASE))
        changed = [*made.units[name]]
        changed[axis] += made.random.choice((-1, 1))
        units = made.units | {name: tuple(changed)}
        if judged(e, powers, units, made.random):
            wrong += 1
            assert refused(e, powers, units), (e, units)
    assert wrong > 20


def test_the_judge_finds_the_unmutated_expressions_to_have_their_unit():
    for seed in range(30):
        e, powers, made = grown(seed)
        assert e.has(sp.zoo) or not judged(e, powers, made.units, made.random), e


@pytest.mark.parametrize("unit", ["m/s^2", "N s^2/m^2", "kg m^2", "km", "deg", "1/s", "kN", "cm/s", "min", "N m s"])  # fmt: skip
def test_units_read_without_the_library_are_those_of_the_library(unit):
    assert alike(dimension(unit), _dimension_by_library(unit))


X, V, TH, B, T = (hf.symbol(n) for n in ("x", "v", "th", "brake", "t"))
STATES = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"), hf.Quantity("th", "rad", angle=True))
INPUTS = (hf.Quantity("brake", "m/s^2"),)
RATES = {"x": V, "v": B, "th": sp.Float(0.1)}


def car(parameters=(), **changed):
    rates = RATES | {n: e for n, e in changed.items() if n in RATES}
    more = {n: e for n, e in changed.items() if n not in RATES}
    return hf.System("car", STATES, INPUTS, rates, parameters, **more)


@pytest.mark.parametrize(
    "rate",
    [
        B - 0.5 * X,  # the unit of a number is not written
        B * sp.cos(TH),
        sp.cos(TH),  # of a car at unit acceleration
        sp.tanh(2 * X) + B,
        B * sp.sin(T),
        B * sgn(sp.Max(X - 1, TH)),  # which is greater than 0 in any unit
        select(select(V, X, TH), B, -B),
        sp.Max(B, -1),
        sp.S.Zero,
    ],
)
def test_numbers_and_values_of_functions_have_the_unit_that_fits(rate):
    car(v=rate)


@pytest.mark.parametrize(
    ("rate", "term"),
    [
        (V * sp.cos(V) + B, "the term 'cos(v)', whose 'v' is in m/s"),
        (V + B, "adds 'brake' in m/s^2 and 'v' in m/s"),
        (B + TH, "'th' in rad"),
        (sp.Min(B, V), "compares"),
        (B * sp.exp(X), "the term 'exp(x)'"),
        (B * V, "'brake*v' is in m^2/s^3; expected m/s^2, the unit of it per second"),
        (B * sgn(X + TH), "adds"),
        (B * sgn(sp.Max(X, TH) - 1), "compares"),
        (B * 2**X, "the term '2**x'"),
        (sp.Piecewise((B, X > 0), (V, True)), "chooses between"),
    ],
)
def test_a_rate_names_the_term_that_does_not_fit(rate, term):
    with pytest.raises(DefinitionError) as told:
        car(v=rate)
    assert str(told.value).startswith("the rate of 'v' of system 'car': ")
    assert term in str(told.value)
    assert "empirical" in told.value.remedy


def test_what_lacks_is_named_by_its_unit():
    with pytest.raises(DefinitionError, match=r"multiply it by a parameter in 1/s; "):
        car(x=-X)


def test_an_empirical_model_is_not_checked_and_is_the_same_value():
    fitted = car(v=V + B, empirical="a fit to logs")
    assert replace(fitted, name="cart").empirical == "a fit to logs"
    assert car(empirical="a fit") == car()
    assert hf.promote(fitted, ("v",), hf.Box((-1,), (1,))).empirical == "a fit to logs"
    with pytest.raises(HoldfastError, match="expected the reason as text"):
        car(v=V + B, empirical=True)


def test_bounds_are_in_the_units_of_what_they_bound():
    most = hf.symbol("most")

    def bounded(unit, bounds):
        return car((hf.Parameter("most", unit, value=2.0),), input_bounds=bounds)

    box, ball = hf.Box((-most,), (most,)), hf.Ball(most, 1)
    image = hf.LinearImage(sp.Matrix([[3.0]]), box)
    for bounds in (box, ball, hf.Product((box,)), image):
        bounded("m/s^2", bounds)
    for bounds in (box, ball, hf.Product((box,))):
        with pytest.raises(DefinitionError, match=r"'brake' is bounded in m/s; expected m/s\^2"):
            bounded("m/s", bounds)
    lever = hf.LinearImage(sp.Matrix([[most]]), hf.Box((-most,), (most,)))
    with pytest.raises(DefinitionError, match=r"'brake' is bounded in m\^2/s\^2"):
        bounded("m/s", lever)


def test_units_of_systems_without_units_are_not_checked():
    for unit in ("1", ""):
        q = (hf.Quantity("x", unit), hf.Quantity("v", unit))
        hf.System("plain", q, (hf.Quantity("u", unit),), {"x": "v", "v": "u - x - 3*sin(t)"})
    hf.System("nothing", (hf.Quantity("x"),), (hf.Quantity("u", "m"),), {"x": "u - x"})
    with pytest.raises(DefinitionError, match="'k'"):  # a "1" that is written counts
        hf.System(
            "half", STATES[:1], (), {"x": "k - x/s"},
            (hf.Parameter("k", "1", value=1.0), hf.Parameter("s", "s", value=1.0)),
        )  # fmt: skip


def test_other_units_than_those_of_the_si_are_told_apart():
    with pytest.raises(DefinitionError, match="write units of the SI"):
        hf.System("far", (hf.Quantity("x", "km"),), (hf.Quantity("u", "m/s"),), {"x": "u"})
    with pytest.raises(DefinitionError, match=r"the term 'cos\(a\)'"):
        hf.System("turned", (hf.Quantity("a", "deg"),), (), {"a": "cos(a)"})
    with pytest.raises(DefinitionError, match="'x' of system 'odd' has the unit 'wink'"):
        hf.System("odd", (hf.Quantity("x", "wink"),), (), {"x": "0"})
    with pytest.raises(
        DefinitionError, match="inequality 'wall' of region 'odd' has the unit 'wink'"
    ):
        hf.Region("odd", STATES, (hf.Inequality("wall", X, "wink"),))
    with pytest.raises(DefinitionError, match="'seen' of system 'car' has the unit 'wink'"):
        car(measurements=(hf.Measurement("seen", "wink", X),))


@pytest.mark.parametrize(
    ("expression", "unit", "message"),
    [
        (X**2, "m", "'x**2' is in m^2; expected m, its unit"),
        (TH - 1, "m", "'th - 1' is in 1"),
        (X - V, "m", "adds"),
    ],
)
def test_an_inequality_is_in_its_unit(expression, unit, message):
    with pytest.raises(DefinitionError) as told:
        hf.Region("room", STATES, (hf.Inequality("wall", expression, unit),))
    assert str(told.value).startswith("inequality 'wall' of region 'room': ")
    assert message in str(told.value)
    word = "lengths count as areas"
    hf.Region("room", STATES, (hf.Inequality("wall", expression, unit),), empirical=word)


def test_an_inequality_without_a_unit_may_have_any():
    hf.Region("room", STATES, (hf.Inequality("wall", X**2 - 4), hf.Inequality("slow", V - 1)))


def test_a_law_gives_inputs_in_their_units_and_reads_states_in_theirs():
    def run(law):
        return hf.simulate(car(), law, starts=[[0.0, 0.0, 0.0]], horizon=0.1)

    gain = (hf.Parameter("k", "1/s", value=1.0),)
    run(hf.Law("brakes", STATES, {"brake": "-k*v"}, gain))
    with pytest.raises(DefinitionError, match=r"gives '-k\*x' in m/s; expected m/s\^2, as in sys"):
        run(hf.Law("home", STATES, {"brake": "-k*x"}, gain))
    with pytest.raises(DefinitionError, match=r"adds '-x' in m and '-k\*v' in m/s\^2"):
        hf.Law("home", STATES, {"brake": "-k*v - x"}, gain)
    other = (hf.Quantity("v", "km/h"),)
    with pytest.raises(DefinitionError, match="the law reads it in"):
        run(hf.Law("far", other, {"brake": "-0.1*v"}))
    fitted = hf.Law("home", STATES, {"brake": "-k*x"}, gain, empirical="tuned on the lake")
    run(fitted)


def test_guards_and_memories_of_a_switching_are_checked():
    modes = {n: hf.Law(n, STATES, {"brake": "0"}) for n in ("go", "stop")}

    def turns(when, **more):
        return hf.Switching("car", modes, (hf.Transition("go", "stop", when),), **more)

    turns(least(X - 1, V - 2))  # the parts of a condition have units of their own
    turns(greatest(X - 1, -least(V, hf.symbol("time_in_mode") - 3)))
    with pytest.raises(DefinitionError, match="guard go -> stop of switching 'car'"):
        turns(X - V)
    z = (hf.Quantity("z", "m"),)
    hf.Memory(z, {"z": "x"}, {"z": "x"}, STATES)
    odd = hf.Memory(z, {"z": "x"}, {"z": "v"}, STATES)
    with pytest.raises(DefinitionError, match="following value of 'z' of the memory of"):
        turns(X, memory=odd)


def test_measurements_and_pfaffian_rows_are_checked():
    with pytest.raises(DefinitionError, match=r"'far' of system 'car': 'x\*\*2' is in m\^2"):
        car(measurements=(hf.Measurement("far", "m", expression=X**2),))
    robot = hf.systems.unicycle()
    rows = (hf.PfaffianRow({"x": -sp.sin(hf.symbol("psi")), "y": sp.cos(hf.symbol("psi"))}),)
    assert {q.unit for q in kinematic_system("robot", robot.states, rows).inputs} == {
        "m/s", "1/s",
    }  # fmt: skip
    odd = (hf.PfaffianRow({"x": hf.symbol("y"), "psi": hf.symbol("y")}),)
    with pytest.raises(DefinitionError, match="Pfaffian row 1 of system 'robot'"):
        kinematic_system("robot", robot.states, odd)


SYSTEMS = [*(example(f) for f in hf.systems.ALL), *map(hf.load_vehicle, vehicle_names())]
LAWS = [example(f) for f in hf.laws.ALL]
REGIONS = [example(f) for f in hf.regions.ALL]


def parts(definition):
    yield definition
    if isinstance(definition, hf.Switching):
        yield from definition.modes.values()


@pytest.mark.parametrize("entry", [*SYSTEMS, *LAWS, *REGIONS], ids=lambda e: e.name)
def test_units_of_the_catalogue_fit_or_its_entries_say_why_not(entry):
    for part in parts(entry):
        part.check_units()


def test_the_catalogue_says_so_only_where_it_has_to():
    saying = [p for e in (*SYSTEMS, *LAWS, *REGIONS) for p in parts(e) if p.empirical]
    assert {p.name for p in saying} == {"align_unicycle", "approach", "dock_marine"}
    for part in saying:
        if part.name != "dock_marine":  # whose output is in 1/s: its system alone tells
            with pytest.raises(DefinitionError):
                replace(part, empirical="")


def test_a_region_in_another_unit_than_the_system_is_refused():
    st = (hf.Quantity("x", "m"), hf.Quantity("v", "m/s"))
    cart = hf.System(
        "cart", st, (hf.Quantity("a", "m/s^2"),), {"x": "v", "v": "a"},
        input_bounds=hf.Box((-1,), (1,)),
    )  # fmt: skip
    near = hf.Region(
        "near", (hf.Quantity("x", "cm"),), (hf.Inequality("end", "abs(x) - 20", "cm"),)
    )
    with pytest.raises(
        DefinitionError, match=r"'x' of region 'near': the region reads it in .*; exp"
    ):
        hf.simulate(
            cart, hf.Law("none", st, {"a": 0}), starts=[[15.0, 0.0]], goal=near, horizon=0.1
        )
    with pytest.raises(DefinitionError, match="'x' of region 'near': the region reads it"):
        hf.SafetyFilter(cart, near)
    grid = hf.grid(cart, {"x": (-2, 2), "v": (-2, 2)}, 9)
    with pytest.raises(DefinitionError, match="'x' of region 'near': the region reads it"):
        hf.viability_kernel(cart, near, grid, 1.0)


def test_a_measurement_that_a_law_reads_in_another_unit_is_refused():
    st = (hf.Quantity("x", "m"),)
    seen = hf.System(
        "seen", st, (hf.Quantity("u", "m/s"),), {"x": "u"}, input_bounds=hf.Box((-1,), (1,)),
        measurements=(hf.Measurement("range", "m", expression="abs(x)"),),
    )  # fmt: skip
    gain = hf.Parameter("k", "m/(s cm)", value=0.01)
    law = hf.Law("home", (hf.Quantity("range", "cm"),), {"u": "-k*range"}, parameters=(gain,))
    with pytest.raises(DefinitionError, match="'range' of law 'home': the law reads it"):
        hf.simulate(seen, law, starts=[[1.0]], horizon=0.1)


@pytest.mark.parametrize("gain", ["1", "1.0", "0.5", "2"])
def test_a_written_gain_of_one_has_a_unit_as_any_other(gain):
    st = (hf.Quantity("x", "m"),)
    line = hf.System("line", st, (hf.Quantity("u", "m/s"),), {"x": "u"})
    law = hf.Law("home", st, {"u": f"-{gain}*x"})
    assert hf.simulate(line, law, starts=[[1.0]], horizon=0.1)
    assert hf.Law("home", st, {"u": f"x/{gain}"}) is not None
    bare = hf.Law("home", st, {"u": "-x"})
    with pytest.raises(DefinitionError, match="multiply it by a parameter in 1/s"):
        hf.simulate(line, bare, starts=[[1.0]], horizon=0.1)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.few("ch4-marine", "ch2-unicycle", "inspection")
@pytest.mark.parametrize("name", scenario_names())
def test_a_copy_of_a_shipped_law_by_a_user_fits_its_system(name):
    scenario = hf.load_scenario(name)
    law = getattr(scenario, "law", None)
    if isinstance(law, hf.Switching):
        law = replace(law, modes={n: replace(mode) for n, mode in law.modes.items()})
    elif law is not None:
        law = replace(law, name="mine")
    if law is not None:
        check_output_units(scenario.system, law)
