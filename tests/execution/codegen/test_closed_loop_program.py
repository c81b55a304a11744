"""The leaves of a closed loop compute what their expressions say."""

import itertools

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import holdfast as hf
from holdfast.errors import CacheWarning, DefinitionError
from holdfast.execution import leaf
from holdfast.execution.codegen.closed_loop_program import closed_loop_program
from holdfast.execution.leaf import Evaluator
from holdfast.execution.simulation.closed_loop import ClosedLoop
from holdfast.execution.simulation.settings import RK4
from holdfast.host.files import cache_directory
from holdfast.maths.expressions.functions import angle, greatest, least, length, select, sgn, wrap
from tests.conftest import number_at

X, Y = hf.symbol("x"), hf.symbol("y")

leaves = st.one_of(
    st.sampled_from([X, Y]),
    st.integers(-3, 3).map(sp.Integer),
    st.floats(0.1, 3.0).map(lambda v: sp.Float(round(v, 3))),
    st.sampled_from([sp.Rational(1, 3), sp.pi]),
)


def grown(children):
    two, three = st.tuples(children, children), st.tuples(children, children, children)
    return st.one_of(
        two.map(lambda p: p[0] + p[1]),
        two.map(lambda p: p[0] - 2 * p[1]),
        two.map(lambda p: p[0] * p[1]),
        two.map(lambda p: p[0] / (p[1] ** 2 + 1)),
        children.map(lambda a: a**3),
        children.map(lambda a: sp.sqrt(a**2 + 1)),
        children.map(lambda a: (a**2 + 1) ** sp.Rational(-3, 2)),
        children.map(sp.sin),
        children.map(sp.tanh),
        children.map(sp.Abs),
        children.map(sgn),
        children.map(wrap),
        two.map(lambda p: least(*p)),
        two.map(lambda p: greatest(*p)),
        two.map(lambda p: length(*p, 1e-6)),
        two.map(lambda p: angle(*p, 1e-6)),
        three.map(lambda p: select(*p)),
    )


@pytest.mark.heavy
@settings(max_examples=250)
@given(st.recursive(leaves, grown, max_leaves=7), st.floats(-2, 2), st.floats(-2, 2))
def test_compiled_expression_has_its_value(expression, x, y):
    expression = sp.sympify(expression)
    value = Evaluator([expression], [X, Y], ()).values(np.array([[x, y]]))[0, 0]
    expected = float(expression.subs({X: sp.Float(x, 30), Y: sp.Float(y, 30)}))
    nearby = [
        float(expression.subs({X: x + a, Y: y + b}))
        for a, b in itertools.product((-1e-9, 1e-9), repeat=2)
    ]
    if max(nearby) - min(nearby) > 1e-4:  # at a jump either side is right
        return
    assert value == pytest.approx(expected, rel=1e-9, abs=1e-7)


def test_leaves_agree_with_their_expressions(vehicle):
    law = hf.track_velocity(vehicle, hf.laws.steer_marine(vehicle), {"u": 5.0, "r": 10.0})
    region = hf.regions.camera_view()
    program = closed_loop_program(
        vehicle, law, region=region, goal=None, disturbance={"Vx": sp.Float(0.1)}, stepper=RK4
    )
    loop = ClosedLoop(program)
    p, none = loop.parameter_array(), np.zeros(1)
    values = {q.symbol: q.value for q in program.parameters}
    generator = np.random.default_rng(0)
    low, high = [-2, -1, -1, -0.3, -0.1, -1], [-0.7, 1, 1, 0.3, 0.1, 1]
    q, u, d = generator.uniform(low, high, (5, 6)), np.array([1.5, -0.2]), (0.1, 0.0)
    c = [e.expression for e in region.inequalities]
    slopes = list(hf.outward_rates(vehicle, region).values())

    def found(name, width, x=none):
        return loop.values(name, 5, width, none, q, x, p)

    rates = found("rates", 6, u)
    assert loop.disturbances(np.zeros(1)).tolist() == [list(d)]
    for k in range(5):
        point = values | {s.symbol: v for s, v in zip(vehicle.states, q[k], strict=True)}
        point |= {s.symbol: v for s, v in zip(vehicle.inputs, u, strict=True)}
        point |= {s.symbol: v for s, v in zip(vehicle.disturbances, d, strict=True)}

        def exact(expressions, point=point):
            return pytest.approx([number_at(e, point) for e in expressions], rel=1e-9, abs=1e-12)

        assert rates[k] == exact(vehicle.rates.values())
        assert found("law0", 2)[k] == exact(law.outputs.values())
        assert loop.constraints(q)[k] == exact(c)
        assert found("constraint_rates", len(c), rates)[k] == exact(slopes)


def test_outputs_are_matched_to_inputs_by_name_not_by_order(vehicle):
    law = hf.Law("swapped", vehicle.states, {"tau_r": sp.Float(0.25), "tau_u": sp.Float(1.0)})
    result = hf.simulate(vehicle, law, starts=np.zeros((1, 6)), horizon=0.1)
    assert result.dataset["input"].values[0, 0] == pytest.approx([1.0, 0.25])


def test_law_that_does_not_fit_the_system_is_refused_with_the_remedy(vehicle):
    with pytest.raises(DefinitionError, match="let the inputs track them"):
        hf.simulate(vehicle, hf.laws.steer_marine(vehicle), starts=np.zeros((1, 6)), horizon=1)
    unicycle = hf.systems.unicycle()
    law = hf.Law("l", vehicle.states, {"v": hf.symbol("u"), "r": sp.S.Zero})
    with pytest.raises(DefinitionError, match="reads 'u'"):
        hf.simulate(unicycle, law, starts=np.zeros((1, 3)), horizon=1)


def test_a_second_process_finds_the_compiled_code(tmp_path, monkeypatch, double_integrator):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path))
    law = hf.Law("coast", double_integrator.states, {"a": sp.Float(0.123)})
    program = closed_loop_program(
        double_integrator, law, region=None, goal=None, disturbance={}, stepper=RK4
    )
    first = ClosedLoop(program)
    (path,) = tmp_path.glob("leaf-*.code")
    written = path.stat().st_mtime_ns
    forget()
    again = ClosedLoop(program)
    assert again.leaves is not first.leaves
    assert path.stat().st_mtime_ns == written
    assert not list(tmp_path.glob("*.partial"))
    path.write_bytes(path.read_bytes()[:-8])  # a truncated file is compiled again
    forget()
    ClosedLoop(program)
    assert path.stat().st_mtime_ns != written


def test_a_cache_folder_that_cannot_be_written_is_replaced_with_a_warning(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(file / "cache"))
    forget()
    with pytest.warns(CacheWarning, match="set HOLDFAST_CACHE_DIR to a folder that can"):
        product = Evaluator([X * Y], [X, Y], ())
    assert product.values(np.array([[2.0, 3.0]])).tolist() == [[6.0]]


def test_code_for_another_processor_is_not_run(tmp_path, monkeypatch):
    monkeypatch.setenv("HOLDFAST_CACHE_DIR", str(tmp_path))
    Evaluator([X * Y + 7], [X, Y], ())
    forget()
    found = leaf._processor()
    monkeypatch.setattr(leaf, "_processor", lambda: (found[0], found[1] + ",-prefer-256-bit"))
    Evaluator([X * Y + 7], [X, Y], ())
    assert len(list(tmp_path.glob("leaf-*.code"))) == 2


def forget():
    """The leaves of this process, so that they are read from the disk."""
    leaf._known.clear()


def test_an_unwritable_user_cache_is_replaced_for_this_process(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.delenv("HOLDFAST_CACHE_DIR", raising=False)
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(file / name))
    replaced = cache_directory()
    assert replaced.is_dir()
    assert cache_directory() == replaced


def test_no_declared_name_collides_with_one_of_the_printer():
    """Every name the printer makes up, declared by a user as a parameter."""
    names = [
        "q",
        "p",
        "u",
        "d",
        "mode",
        "table",
        "c_0",
        "psi_sin",
        "psi_cos",
        "levels",
        "math",
        "compiled",
        "wrap_",
        "rates",
        "law",
        "x_",
        "np",
    ]
    psi = hf.symbol("psi")
    total = sum((hf.symbol(n) for n in names), start=sp.sin(psi) + sp.cos(psi) + sp.tan(psi) ** 2)
    system = hf.System(
        "names",
        (hf.Quantity("psi", "rad", angle=True),),
        (hf.Quantity("u0", "rad/s"),),
        {"psi": total + hf.symbol("u0")},
        parameters=tuple(hf.Parameter(n, value=1.0 + i) for i, n in enumerate(names)),
    )
    law = hf.Law("zero", system.states, {"u0": sp.tan(psi) ** 2 - sp.tan(psi) ** 2 * sp.S.One})
    start = 0.3
    end = (
        hf.simulate(
            system,
            law,
            starts=[[start]],
            horizon=1e-3,
            sample_time=1e-3,
            substeps=1,
            record_every=1e-3,
        )
        .dataset["state"]
        .values[0, -1, 0]
    )
    slope = sum(1.0 + i for i in range(len(names)))
    expected = slope + np.sin(start) + np.cos(start) + np.tan(start) ** 2
    assert (end - start) / 1e-3 == pytest.approx(expected, rel=1e-2)
