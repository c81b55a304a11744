"""What every system, law, region and vehicle promises by being in the catalogue."""

from functools import cache

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.analysis.reachability.march_report import Report
from holdfast.analysis.reachability.value_function import to_value_function
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import RK4
from holdfast.maths.catalogue.signature import example
from holdfast.maths.definitions.vehicle_file import vehicle_names
from holdfast.maths.reference_fields.critical_points import meridian
from holdfast.presentation.text.derivation import equations
from holdfast.studies.catalogue import describe
from tests.conftest import number_at

VEHICLES = [hf.load_vehicle(name) for name in vehicle_names()]
HULLS = [v for v in VEHICLES if v.name == "marine_vehicle"]
SYSTEMS = [example(function) for function in hf.systems.ALL] + VEHICLES
LAWS = [example(function) for function in hf.laws.ALL]
REGIONS = [example(function) for function in hf.regions.ALL]
FIELDS = [function() for function in hf.fields.ALL]


# Those that are made from more than numbers promise the same; they are made by the tests of them.
@cache
def chain():
    return hf.load_scenario("ch6-corridor-s")


def law_of_a_chain():
    return chain().law


def region_of_a_chain():
    return chain().region


@cache
def optimal():
    """The optimal inputs for a value function 1 - |q|^2, as a law."""
    boat = hf.systems.drifting_unicycle()
    over = hf.grid(boat, {q.name: (-1.5, 1.5) for q in boat.states}, 9, {"psi": "contained"})
    squares = np.meshgrid(*(a.nodes**2 for a in over.axes), indexing="ij")
    known = Report(kind="viability-kernel", region="room", system=boat.name, converged=True)
    return hf.safety_law(boat, to_value_function(over, 1 - sum(squares), known))


LAWS += [
    pytest.param(law_of_a_chain, id="lead_along, follow_leader"),
    pytest.param(optimal, id="optimal inputs of drifting_unicycle, kept safe"),
]


def named(entry):
    return entry.name


def made(entry):
    return entry() if callable(entry) else entry


def point(quantities, parameters, generator, size=1.0, lookup=None):
    """Numbers for every symbol; those of a lookup table are slopes and values of any size."""
    values = {p.symbol: p.value for p in parameters}
    symbols = [q.symbol for q in quantities] + list(lookup.symbols if lookup else ())
    return values | {s: float(generator.uniform(-size, size)) for s in symbols}


def test_names_of_shared_parts_mean_nothing_else_in_the_system():
    """Of the chain, whose measurements are long, and of a system that has an s1."""
    text = describe("chain")
    assert "s1 = " in text
    assert not any(f"{name} = " in text for name in ("u1", "w1", "x1"))
    long = sum(
        sp.Symbol(f"s{i}") ** 2 * sp.sin(sp.Symbol("s2") + sp.Symbol("s3")) for i in range(9)
    )
    lines = "\n".join(equations([("V", long**2 + long)], taken=["s9"]))
    assert "s10 = " in lines
    assert not any(f"s{i} = " in lines for i in range(10))


@pytest.mark.parametrize(
    "entry",
    [*SYSTEMS, *LAWS, *REGIONS, pytest.param(region_of_a_chain, id="chain_in_view"), *FIELDS],
    ids=named,
)
def test_every_entry_is_described_with_its_source(entry):
    entry = made(entry)
    assert entry.description
    assert entry.source
    for parameter in entry.parameters:
        assert parameter.description
        assert parameter.unit


@pytest.mark.slow(
    "leader_follower",
    "steer_marine",
    "steer_unicycle",
    "align_unicycle",
    "steer_integrator",
    "steer_chained",
    "steer_by_chained_form",
    "follow_field",
    "dock_marine",
    "hold_station",
    "hold_station_unknown",
    "weathervane",
    "inspect_target",
    "rest_in_current",
    "hold_pose",
    "hitch_angles",
    "dipolar",
    "dipole_like",
    "dipole_in_current",
    "electric_dipole",
    "charge_pair",
)
@pytest.mark.parametrize(
    "function",
    [*hf.systems.ALL, *hf.laws.ALL, *hf.regions.ALL, *hf.fields.ALL],
    ids=lambda f: f.__name__,
)
def test_every_entry_can_be_shown(function):
    text = describe(function.__name__)
    assert function.__name__ in text
    assert ("parameters" in text) == bool(example(function).parameters)
    assert max(len(line) for line in text.splitlines()) < 160


@pytest.mark.few(
    "slipping_unicycle",
    "nonholonomic_integrator",
    "chained_form",
    "marine_vehicle1",
    "marine_vehicle2",
    "marine_craft4",
    "unicycle1",
    "marine_vehicle3",
)
@pytest.mark.parametrize("system", SYSTEMS, ids=named)
def test_velocities_respect_the_pfaffian_constraint_in_compiled_code(system):
    zero = hf.Law("zero", system.states, dict.fromkeys(system.input_names, sp.S.Zero))
    drift = {name: sp.Float(0.3 - 0.5 * i) for i, name in enumerate(system.disturbance_names)}
    program = closed_loop_program(
        system, zero, region=None, goal=None, disturbance=drift, stepper=RK4
    )
    loop, generator = ClosedLoop(program), np.random.default_rng(1)
    q, u = (generator.uniform(-1, 1, (20, len(x))) for x in (system.states, system.inputs))
    found = loop.values("rates", 20, len(system.states), np.zeros(1), q, u, loop.parameter_array())
    for k in range(20):
        rates = dict(zip(system.state_names, found[k], strict=True))
        at = {s.symbol: v for s, v in zip(system.states, q[k], strict=True)}
        at |= {s.symbol: v for s, v in zip(system.inputs, u[k], strict=True)}
        at |= {s.symbol: drift[s.name] for s in system.disturbances}
        at |= {s.symbol: s.value for s in system.parameters}
        for row in system.pfaffian:
            left = sum(number_at(c, at) * rates[n] for n, c in row.coefficients.items())
            assert left == pytest.approx(number_at(row.rhs, at), abs=1e-12)


@pytest.mark.parametrize("system", SYSTEMS, ids=named)
def test_every_system_is_affine_in_its_inputs_and_disturbances(system):
    driven = [q.symbol for q in system.inputs + system.disturbances]
    for rate in system.rates.values():
        for a in driven:
            for b in driven:
                assert rate.diff(a).diff(b) == 0


@pytest.mark.few(
    "back_off",
    "move_ahead",
    "follow_integrator",
    "steer_chained",
    "project_marine",
    "approach_leader",
    "follow_leader",
    "optimal inputs of drifting_unicycle, kept safe",
)
@pytest.mark.parametrize("law", LAWS, ids=named)
def test_every_law_is_finite_everywhere_and_bounded_near_its_goal(law):
    """A law with modes: in the mode it starts in, that is, after the guards of its first one."""
    law = made(law)
    generator = np.random.default_rng(2)
    for size in (1e-9, 1e-3, 1.0, 30.0):
        for _ in range(10):
            at = point(law.reads, law.parameters, generator, size, law.lookup)
            for name in ("x", "y"):
                if hf.symbol(name) in at:
                    at[hf.symbol(name)] += at.get(hf.symbol(f"goal_{name}"), 0.0)
            for output in active(law, at).outputs.values():
                value = number_at(output, at)
                assert np.isfinite(value)
                if isinstance(law, hf.Law):
                    assert abs(value) < 60 * max(1.0, size) ** 2


def active(law, at):
    if isinstance(law, hf.Law):
        return law
    mode = law.initial
    for change in law.transitions:
        now = at | {hf.TIME: 0, hf.TIME_IN_MODE: 0}
        if change.source == mode and number_at(change.when, now) >= 0:
            return law.modes[change.target]
    return law.modes[mode]


@pytest.mark.few("camera_view", "hitch_angles", "near_pose", "steering_angle")
@pytest.mark.parametrize("region", REGIONS, ids=named)
def test_gradients_of_every_region_are_the_limits_of_difference_quotients(region):
    generator = np.random.default_rng(4)
    for _ in range(20):
        at = point(region.reads, region.parameters, generator)
        x = hf.symbol("x")
        if x in at:
            at[x] = -abs(at[x]) - 0.2
        for c in region.inequalities:
            for q in region.reads:
                h = 1e-6
                if abs(float(at[q.symbol])) < 1e-3:  # a kink of |q|
                    continue
                up, down = dict(at), dict(at)
                up[q.symbol] += h
                down[q.symbol] -= h
                slope = (number_at(c.expression, up) - number_at(c.expression, down)) / (2 * h)
                derived = number_at(c.expression.diff(q.symbol), at)
                assert derived == pytest.approx(slope, rel=1e-3, abs=1e-4)


def test_gradients_of_a_chain_in_view_are_the_limits_of_difference_quotients():
    """In compiled code: the distances to walls have no number in SymPy."""
    region, h = region_of_a_chain(), 1e-6
    generator = np.random.default_rng(7)
    rows = generator.uniform(-2, 2, (20, len(region.reads)))
    symbols = [q.symbol for q in region.reads]
    values = Evaluator([c.expression for c in region.inequalities], symbols, region.parameters)
    for i, s in enumerate(symbols):
        slopes = [c.expression.diff(s) for c in region.inequalities]
        derived = Evaluator(slopes, symbols, region.parameters).values(rows)
        step = h * np.eye(len(symbols))[i]
        quotients = (values.values(rows + step) - values.values(rows - step)) / (2 * h)
        assert derived == pytest.approx(quotients, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("system", HULLS)
def test_kinetic_energy_of_a_hull_never_grows_without_thrust(system):
    """Drag only takes: d/dt (m11 u^2 + m22 v^2 + m33 r^2) / 2 <= 0 in still water."""
    p = {q.name: q.value for q in system.parameters}
    inertia = {"u": p["mass"] - p["Xudot"], "v": p["mass"] - p["Yvdot"], "r": p["Iz"] - p["Nrdot"]}
    generator = np.random.default_rng(5)
    for _ in range(50):
        at = point(system.states, system.parameters, generator, 2.0)
        at |= {q.symbol: 0.0 for q in system.inputs + system.disturbances}
        power = sum(
            m * at[hf.symbol(n)] * number_at(system.rates[n], at) for n, m in inertia.items()
        )
        assert power <= 1e-12


@pytest.mark.slow("dipole_in_current", "charge_pair")
@pytest.mark.parametrize("field", FIELDS, ids=named)
def test_index_of_every_field_by_its_sectors_is_the_one_counted_on_a_circle(field):
    """Bendixson's 1 + (e - h) / 2 against the turns of F; in N > 2 in a plane through p."""
    planar = field if field.dimension == 2 else meridian(field)
    found = hf.critical_points(planar)
    for point, critical in zip(found.points, found.critical_points, strict=True):
        centre = [float(c) for c in point]
        assert hf.winding_number(planar, 0.05, centre) == critical.index
        assert critical.index == 1 + (critical.count("elliptic") - critical.count("hyperbolic")) / 2


@pytest.mark.parametrize("field", [f for f in FIELDS if f.potential is not None], ids=named)
def test_field_with_a_potential_is_its_negative_gradient(field):
    generator = np.random.default_rng(6)
    values = field.values
    for _ in range(10):
        at = values | {s: sp.Float(generator.uniform(0.2, 1.0)) for s in field.symbols}
        for s, component in zip(field.symbols, field.vector, strict=True):
            slope = float(sp.N(-field.potential.diff(s).xreplace(at)))
            assert float(sp.N(component.xreplace(at))) == pytest.approx(slope, rel=1e-9)


@pytest.mark.parametrize("craft", VEHICLES, ids=lambda v: v.name)
def test_every_craft_has_half_spaces_within_its_bounds(craft):
    """Those that a filter asks for; thrusters may be more than the inputs."""
    assert craft.input_bounds.inscribed()
