"""What `certify` keeps, the checker accepts: its enclosures lie in those of the search."""

import flint
import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.execution.intervals.held_flow import HeldFlow, Sampling
from holdfast.maths.expressions.functions import angle, greatest, least, length, magnitude
from holdfast.maths.expressions.traversal import plain_text
from holdfast_check.checker import check
from holdfast_check.held import HeldFlow as Checked
from holdfast_check.intervals import Expression, add, interval, point, sub

X, Y, Z, U, D, P = (hf.symbol(n) for n in "xyzudp")
PROBLEMS = {
    "cart": ([Y, U + D], [X - 1, -1 - X]),
    "pendulum": ([Y, -4 * sp.sin(X) - Y / 2 + U + D], [Y - 2]),
    "tank": ([U - sp.sqrt(X) / 2 + D], [X - 2, sp.Rational(1, 10) - X]),
    "drag": ([Y, (U + D - 3 * Y * sp.Abs(Y)) / P], [X - 1]),
    "reactor": (
        [1 - X - X * sp.exp(3 * Y / (1 + Y / 5)), -Y + 2 * X * sp.exp(3 * Y / (1 + Y / 5)) + U + D],
        [Y - 1, -X],
    ),
    "van der Pol": ([Y, (1 - X**2) * Y - X + U + D], [X**2 + Y**2 - 4]),
    "growth": (
        [-X * sp.log(X) / 2 + Y * X / (1 + X**2) - U * X, Y * (1 - Y) - X * Y / (1 + X) + D],
        [X - 3, sp.Rational(1, 5) - X],
    ),
    "orbit": ([-sp.cos(Y) + D, U + sp.sin(Y) / X], [X - 3, sp.Rational(1, 2) - X]),
    "bearing": (
        [U + D * sp.cos(sp.atan2(Y, X)), D * sp.sin(angle(Y, X, sp.Rational(1, 100)))],
        [X**2 + Y**2 - 4, angle(Y, X, sp.Rational(1, 100)) - 1],
    ),
    "corridor": (
        [U + D, Z * sp.tanh(3 * X) - least(X, Y), greatest(X - Y, -Z / 2)],
        [least(greatest(sp.Abs(X) - 2, Y), Z - 1), length(X, Y, sp.Rational(1, 100)) - 2],
    ),
    "bicycle": (
        [P * sp.sin(Y + sp.atan(U / 2)), P * U * sp.cos(sp.atan(U / 2)) + D / sp.sqrt(1 + X**2)],
        [sp.tan(Y) - 2, magnitude(X) - 1],
    ),
}  # fmt: skip
SAMPLINGS = {
    "exact": Sampling(0.15),
    "in steps": Sampling(0.4, steps=3),
    "late and inexact": Sampling(0.1, (0.01, 0.002, 0.0), 0.03, ((-0.5, 1.0),), steps=2),
}
RANGES = {"d": (-0.1, 0.2), "p": (0.9, 1.1)}
BOXES = 40


def checked_legs(sampling, u):
    known = {name: interval(*ends) for name, ends in RANGES.items()}
    still = {name: point(0.5 * (a + b)) for name, (a, b) in RANGES.items()}
    legs = [(sub(point(sampling.hold), point(sampling.delay)), {"u": point(u)}, {"u": point(u)})]
    if sampling.delay:
        ((a, b),) = sampling.under_way
        legs.insert(0, (point(sampling.delay), {"u": interval(a, b)}, {"u": point(0.5 * (a + b))}))
    return [(t, known | more, still | middle) for t, more, middle in legs]


@pytest.mark.few("exact-cart", "exact-tank")
@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("how", SAMPLINGS)
def test_checker_says_more_than_the_search(name, how):
    flint.ctx.prec = 80
    (rates, constraints), sampling = PROBLEMS[name], SAMPLINGS[how]
    states, n = [X, Y, Z][: len(rates)], len(rates)
    sampling = Sampling(
        sampling.hold, sampling.errors[:n], sampling.delay, sampling.under_way, None, sampling.steps
    )
    flow = HeldFlow(rates, constraints, states, [U], {D: RANGES["d"]}, {P: RANGES["p"]}, sampling)
    texts = ([Expression(plain_text(e)) for e in group] for group in (rates, constraints))
    rates, constraints = texts
    checker = Checked(rates, [s.name for s in states], constraints, sampling.steps)
    errors = [interval(-e, e) for e in sampling.errors or [0.0] * n]
    generator = np.random.default_rng(7)
    low = generator.uniform(-1, 1.5, (BOXES, n)).round(2)
    high = low + generator.choice([0.01, 0.1, 0.3], (BOXES, n))
    inputs = generator.choice([-0.5, 0.0, 1.0], (BOXES, 1))
    said = flow.held(low, high, inputs)
    compared = 0
    for k in range(BOXES):
        if not np.isfinite([*said.low[k], *said.high[k]]).all():
            continue
        seen = [interval(a, b) for a, b in zip(low[k].tolist(), high[k].tolist(), strict=True)]
        middle = [point(0.5 * (a + b)) for a, b in zip(low[k], high[k], strict=True)]
        box = [add(q, e) for q, e in zip(seen, errors, strict=True)]
        end, fails = checker.held(box, middle, checked_legs(sampling, float(inputs[k, 0])))
        if said.kept[k]:
            compared += 1
            assert end is not None, k
            assert fails is None, k
            for q, e, a, b in zip(end, errors, said.low[k], said.high[k], strict=True):
                q = add(q, e)
                assert float(q[0]) >= a, k
                assert float(q[1]) <= b, k
    assert compared >= 3


@pytest.mark.heavy
def test_file_of_every_kind_of_rate_is_valid(tmp_path):
    """The checker refused 7 of 20 files like these."""
    tank = hf.System(
        "tank", (hf.Quantity("x"),), (hf.Quantity("u"),), {"x": PROBLEMS["tank"][0][0]},
        disturbances=(hf.Quantity("d"),), input_bounds=hf.Box((0.0,), (1.0,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    level = hf.Region("level", tank.states, (
        hf.Inequality("low", sp.Rational(1, 10) - X), hf.Inequality("high", X - 2),
    ))  # fmt: skip
    found = hf.certify(tank, level, box={"x": (0.05, 2.1)}, cells=150, sample_time=0.5)
    assert found.kept.share == 1
    assert "138 of 138 entries hold" in check(str(found.write(tmp_path / "tank.holdfast")))
    reactor = hf.System(
        "reactor", (hf.Quantity("x"), hf.Quantity("y")), (hf.Quantity("u", "1/s"),),
        dict(zip("xy", PROBLEMS["reactor"][0], strict=True)),
        disturbances=(hf.Quantity("d", "1/s"),), input_bounds=hf.Box((-3.0,), (1.0,)),
        disturbance_bounds=hf.Box((-0.1,), (0.1,)),
    )  # fmt: skip
    safe = hf.Region("safe", reactor.states, tuple(
        hf.Inequality(f"c{k}", e) for k, e in enumerate((-X, X - 1, -Y - 1, Y - 1))
    ))  # fmt: skip
    found = hf.certify(
        reactor, safe, box={"x": (0.0, 1.0), "y": (-1.0, 1.0)}, cells=41, sample_time=0.05
    )
    assert found.sampling.steps > 1
    assert found.kept.share > 0.6
    path = found.write(tmp_path / "reactor.holdfast")
    assert "entries hold" in check(str(path), share=0.3)
    assert hf.read_certificate(path).sampling.steps == found.sampling.steps


@pytest.mark.heavy
def test_long_holds_of_a_lake_are_certified_in_steps(tmp_path):
    """Phosphorus P and its load L, which changes slowly (a benchmark of viability theory)."""
    load, p, u = (hf.symbol(n) for n in "LPu")
    lake = hf.System(
        "lake", (hf.Quantity("L"), hf.Quantity("P")), (hf.Quantity("u", "1/s"),),
        {"L": u, "P": -sp.Rational(4, 5) * p + load + p**8 / (1 + p**8)},
        input_bounds=hf.Box((-0.09,), (0.09,)),
    )  # fmt: skip
    ends = (sp.Rational(1, 10) - load, load - 1, -p, p - sp.Rational(7, 5))
    clear = hf.Region("clear", lake.states, tuple(
        hf.Inequality(f"c{k}", e) for k, e in enumerate(ends)
    ))  # fmt: skip

    def certified(hold, steps=None):
        return hf.certify(
            lake, clear, box={"L": (0.1, 1.0), "P": (0.0, 1.4)}, cells=150, sample_time=hold,
            inputs=3, steps=steps,
        )  # fmt: skip

    found = [certified(0.2), certified(1.5), certified(1.5, steps=1)]
    assert [len(c.kept.members) for c in found] == [10_519, 9_847, 0]
    assert {c.kept.inside for c in found} == {22_201}
    assert found[1].sampling.steps > 8
    assert "entries hold" in check(str(found[1].write(tmp_path / "lake.holdfast")), share=0.01)
