"""From A(q) alone: structure, nonholonomy, field, output, and the laws that follow."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

import holdfast as hf
from holdfast.errors import DefinitionError
from holdfast.maths.expressions.random_points import Sampler, rank, value_at
from holdfast.maths.nonholonomic.chained_search import bracket, find_chained_form, growth, plain
from holdfast.maths.nonholonomic.structure import (
    alignment,
    kinematic_system,
    signed_minors,
    structure,
)
from tests.conftest import number_at

X, Y, PSI, LAM = (hf.symbol(n) for n in ("x", "y", "psi", "lam"))
POSE = (hf.Quantity("x", "m"), hf.Quantity("y", "m"), hf.Quantity("psi", "rad", angle=True))
NO_SLIP = hf.PfaffianRow({"x": -sp.sin(PSI), "y": sp.cos(PSI)})


def names(quantities):
    return [q.name for q in quantities]


@pytest.mark.slow(
    "car-like robot, by the middle of its rear axle-x y psi-delta-1-grown4",
    "tractor with 1 trailer-x y psi1-psi0-1-grown6",
    "tractor with 2 trailers-x y psi2 psi1-psi0-1-grown7",
    "underactuated marine vehicle, two aft thrusters, in a current-x y-psi-1-grown8",
)
@pytest.mark.parametrize(
    ("system", "leaf", "transverse", "choices", "grown"),
    [
        (hf.systems.unicycle(), "x y", "psi", 1, (2, 3)),
        (hf.systems.nonholonomic_integrator(), "x1 x2 x3", "", 2, (2, 3)),
        (hf.systems.chained_form(3), "x1 x3", "x2", 1, (2, 3)),
        (hf.systems.chained_form(6), "x1 x3 x4 x5 x6", "x2", 1, (2, 3, 4, 5, 6)),
        (hf.systems.car(), "x y psi", "delta", 1, (2, 3, 4)),
        (hf.systems.front_axle_car(), "x y psi", "delta", 1, (2, 3, 4)),
        (hf.systems.tractor_trailer(1), "x y psi1", "psi0", 1, (2, 3, 4)),
        (hf.systems.tractor_trailer(2), "x y psi2 psi1", "psi0", 1, (2, 3, 4, 5)),
        (hf.systems.marine_vehicle(), "x y", "psi", 1, (2, 3)),
    ],
    ids=lambda v: v.description if isinstance(v, hf.System) else None,
)
def test_zero_columns_split_the_states_and_brackets_show_nonholonomy(
    system, leaf, transverse, choices, grown
):
    found = structure(system)
    assert names(found.leaf) == leaf.split()
    assert names(found.transverse) == transverse.split()
    assert len(found.admissible) == choices
    result = growth(found)
    assert result.vector == grown
    assert result.origin == len(found.coordinates)
    assert result.integrable == 0
    assert result.integrable_rows == ()


@pytest.mark.parametrize(
    "system", [hf.systems.car(), hf.systems.tractor_trailer(2)], ids=lambda s: s.name
)
def test_directions_satisfy_the_constraint(system):
    found = structure(system)
    sampler = found.sampler()
    for g in found.directions:
        for residual in found.matrix * sp.Matrix(g):
            assert sampler.vanishes(residual)


def test_unicycle_gives_the_output_of_the_thesis():
    """(4.8), (4.10): h = Fy cos - Fx sin with Fx = 2 x^2 - y^2, Fy = 3 x y at lambda = 3."""
    found = structure(hf.systems.unicycle())
    expected = 3 * X * Y * sp.cos(PSI) - (2 * X**2 - Y**2) * sp.sin(PSI)
    assert sp.expand(found.output[0].subs(LAM, 3) - expected) == 0
    assert found.moment == (1, 0)
    assert found.catastatic


def test_integrator_gives_the_output_of_the_thesis():
    """(4.17): h = 3 x1 x3 - x2 (x1^2 + x2^2 + x3^2)."""
    x1, x2, x3 = (hf.symbol(f"x{i}") for i in (1, 2, 3))
    found = structure(hf.systems.nonholonomic_integrator())
    expected = 3 * x1 * x3 - x2 * (x1**2 + x2**2 + x3**2)
    assert sp.expand(found.output[0].subs(LAM, 3) - expected) == 0


def test_chained_form_gives_the_outputs_of_the_thesis():
    """(4.24): h1 = -3 x1 (x1 x2 - x3) + x2 (x1^2 + x3^2)."""
    x1, x2, x3 = (hf.symbol(f"x{i}") for i in (1, 2, 3))
    found = structure(hf.systems.chained_form(3))
    expected = -3 * x1 * (x1 * x2 - x3) + x2 * (x1**2 + x3**2)
    assert sp.expand(found.output[0].subs(LAM, 3) - expected) == 0


def test_user_chooses_the_moment_where_two_dimensions_remain():
    ndi = hf.systems.nonholonomic_integrator()
    assert structure(ndi).moment == (1, 0, 0)
    assert structure(ndi, [0, 2, 0]).moment == (0, 2, 0)
    assert structure(ndi, [1, 1, 0]).field != structure(ndi).field


@pytest.mark.parametrize(
    ("moment", "complaint"),
    [
        ([0, 0, 0], "moment p is zero"),
        ([1, 0], "2 components; expected 3, one for each of x1, x2, x3"),
        ([0, 0, 1], r"A\(0\) p = \(1,\); expected A\(0\) p = 0"),
    ],
)
def test_moment_off_the_constraint_is_refused(moment, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        structure(hf.systems.nonholonomic_integrator(), moment)


def test_marine_vehicle_is_acatastatic_and_rests_only_without_sway_and_cross_current():
    found = structure(hf.systems.marine_vehicle())
    assert not found.catastatic
    v, vx, vy = (hf.symbol(n) for n in ("v", "Vx", "Vy"))
    assert sp.expand(found.rhs[0] - (v - vx * sp.sin(PSI) + vy * sp.cos(PSI))) == 0


def rows_only(states, *rows):
    return kinematic_system("given", states, rows)


def test_motions_follow_from_the_rows_alone():
    """A unicycle known by its constraint only gets the inputs of the unicycle."""
    system = rows_only(POSE, NO_SLIP)
    w1, w2 = hf.symbol("w1"), hf.symbol("w2")
    assert system.rates == {"x": w1 * sp.cos(PSI), "y": w1 * sp.sin(PSI), "psi": w2}
    assert structure(system).output == structure(hf.systems.unicycle()).output


def test_rows_follow_from_the_rates_alone():
    """A unicycle without a declared row: what annihilates its input directions, smoothly."""
    v, r = hf.symbol("v"), hf.symbol("r")
    system = given({"x": v * sp.cos(PSI), "y": v * sp.sin(PSI), "psi": r})
    found = structure(system)
    assert names(found.leaf) == ["x", "y"]
    assert found.sampler().vanishes(
        found.matrix[0, 0] * sp.cos(PSI) + found.matrix[0, 1] * sp.sin(PSI)
    )
    assert growth(found).vector == (2, 3)
    assert alignment(found).everywhere


def test_signed_minors_turn_smoothly_where_elimination_flips():
    """(cos, sin) all the way round; SymPy's null space is (cot, 1), which changes sides."""
    row = sp.Matrix([[-sp.sin(PSI), sp.cos(PSI)]])
    g = signed_minors(row)
    assert g == sp.Matrix([sp.cos(PSI), sp.sin(PSI)])
    other = row.nullspace()[0]
    angles = np.linspace(-3.1, 3.1, 200)
    ours = np.array([[float(e.subs(PSI, a)) for e in g] for a in angles])
    theirs = np.array([[float(e.subs(PSI, a)) for e in other] for a in angles])
    assert (np.sum(ours[1:] * ours[:-1], axis=1) > 0).all()
    assert not (np.sum(theirs[1:] * theirs[:-1], axis=1) > 0).all()


@pytest.mark.parametrize(
    ("rows", "states", "said"),
    [
        # x dx + y dy = 0 keeps x^2 + y^2: but A(0) = 0
        ([{"x": X + 1, "y": Y}], POSE, "1 of its 1 constraints can be integrated"),
        # y' = psi x' is nonholonomic, x' = 0.. a second row that is exact
        (
            [{"x": -PSI, "y": 1}, {"z": 1, "x": 2 * X}],
            (*POSE, hf.Quantity("z", "m")),
            r"1 of its 2 constraints can be integrated \(row 2 on its own\)",
        ),
    ],
)
def test_holonomic_constraint_is_refused_with_the_reason(rows, states, said):
    system = rows_only(states, *(hf.PfaffianRow(row) for row in rows))
    with pytest.raises(DefinitionError, match=said) as caught:
        hf.explain(system)
    assert "eliminate a coordinate" in str(caught.value)


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ({"x": X, "y": Y}, "of rank 0; expected rank 1"),
        ({"x": 1 / X, "y": sp.S.One}, "expected numbers"),
    ],
)
def test_constraint_degenerate_at_the_origin_is_refused(row, complaint):
    v, r = hf.symbol("v"), hf.symbol("r")
    a, b = row["x"], row["y"]
    system = hf.System(
        "s",
        POSE,
        (hf.Quantity("v"), hf.Quantity("r")),
        {"x": v * b, "y": -v * a, "psi": r},
        pfaffian=(hf.PfaffianRow(row),),
    )
    with pytest.raises(DefinitionError, match=complaint):
        structure(system)


@pytest.mark.parametrize("lam", [1.0, 0.5])
def test_exponent_that_makes_no_rose_is_refused(lam):
    with pytest.raises(DefinitionError, match=rf"'lam' is {lam:g}; expected above 1"):
        hf.laws.follow_field(hf.systems.unicycle(), lam=lam)


def test_dependent_rows_are_refused():
    with pytest.raises(DefinitionError, match="rank"):
        rows_only((*POSE, hf.Quantity("z")), NO_SLIP, NO_SLIP)


def test_system_without_a_constraint_is_refused(double_integrator):
    with pytest.raises(DefinitionError, match="no Pfaffian constraint"):
        structure(double_integrator)


@pytest.mark.few("10000000000.0")
@pytest.mark.parametrize("size", [1e-10, 1e-3, 1e10])
def test_verdict_does_not_depend_on_the_scale_of_the_coordinates(size):
    """z' + c y x' = 0 is nonholonomic for every c; short trailers are like long ones."""
    states = tuple(hf.Quantity(n) for n in ("x", "y", "z"))
    c = sp.Rational(size)
    system = rows_only(states, hf.PfaffianRow({"x": c * Y, "z": 1}))
    assert growth(structure(system)).vector == (2, 3)
    assert growth(structure(hf.systems.car(wheelbase=size))).vector == (2, 3, 4)
    assert find_chained_form(structure(hf.systems.car(wheelbase=size))).found is not None


def test_short_trailers_are_nonholonomic_too():
    system = hf.systems.tractor_trailer(2, length_1=1e-3, length_2=1e-3)
    assert growth(structure(system)).vector == (2, 3, 4, 5)


def test_dimension_at_the_origin_may_take_longer_brackets():
    """z' = x^3 y': three brackets more with d/dx are needed where x = 0."""
    states = tuple(hf.Quantity(n) for n in ("x", "y", "z"))
    result = growth(structure(rows_only(states, hf.PfaffianRow({"y": -(X**3), "z": 1}))))
    assert result.vector == (2, 3)
    assert result.origin == 3


def test_zero_column_in_disguise_is_a_zero_column():
    disguise = 2 * sp.sin(PSI) ** 2 + 2 * sp.cos(PSI) ** 2 - 2
    row = hf.PfaffianRow({**NO_SLIP.coefficients, "psi": disguise})
    assert names(structure(rows_only(POSE, row)).transverse) == ["psi"]


def given(rates, rows=(), **more):
    quantities = {n: hf.Quantity(n) for n in ("v", "r")}
    return hf.System("given", POSE, tuple(quantities.values()), rates, pfaffian=tuple(rows), **more)


@pytest.mark.parametrize(
    ("system", "complaint"),
    [
        (
            lambda: rows_only(POSE, hf.PfaffianRow({"x": -hf.TIME, "y": sp.S.One})),
            "A depends on 't'",
        ),
        (
            lambda: rows_only(
                POSE,
                hf.PfaffianRow(
                    {"x": -hf.parse_expression("abs(psi)", {"psi": PSI}), "y": sp.S.One}
                ),
            ),
            "A contains abs; expected smooth",
        ),
        (
            lambda: given(
                {
                    "x": hf.symbol("v") ** 3 * sp.cos(PSI),
                    "y": hf.symbol("v") ** 3 * sp.sin(PSI),
                    "psi": hf.symbol("r"),
                },
                [NO_SLIP],
            ),
            "not affine in its inputs",
        ),
        (
            lambda: rows_only(
                (hf.Quantity("x"), hf.Quantity("y"), hf.Quantity("lam")),
                hf.PfaffianRow({"x": -hf.symbol("lam"), "y": 1}),
            ),
            "calls a quantity 'lam'",
        ),
        (
            lambda: rows_only(POSE, hf.PfaffianRow({"q": sp.S.One})),
            "names 'q', which is not a state",
        ),
    ],
)
def test_what_the_logic_cannot_judge_is_refused(system, complaint):
    with pytest.raises(DefinitionError, match=complaint):
        structure(system())


def test_integrability_agrees_with_an_exact_form():
    """d(x y + z) = 0 is integrable, z' = x y' - y x' is not."""
    states = tuple(hf.Quantity(n) for n in ("x", "y", "z"))
    exact = structure(rows_only(states, hf.PfaffianRow({"x": Y, "y": X, "z": 1})))
    assert growth(exact).vector == (2,)
    assert growth(exact).integrable_rows == (1,)
    twisted = structure(rows_only(states, hf.PfaffianRow({"x": Y, "y": -X, "z": 1})))
    assert growth(twisted).vector == (2, 3)


def test_bracket_of_the_integrator_is_constant():
    g1, g2 = (sp.Matrix(g) for g in structure(hf.systems.nonholonomic_integrator()).directions)
    assert bracket(g1, g2, [hf.symbol(f"x{i}") for i in (1, 2, 3)]) == sp.Matrix([0, 0, 2])


def test_derived_law_of_the_unicycle_is_that_of_the_thesis():
    """(4.13), (4.14) typed in the catalogue, without its input limits, equals the derived one."""
    system = hf.systems.unicycle(speed_limit=1e6, turn_limit=1e6)
    derived, typed = hf.laws.follow_field(system), hf.laws.steer_unicycle(system)
    values = {p.symbol: p.value for p in typed.parameters}
    generator = np.random.default_rng(0)
    for _ in range(40):
        q = generator.uniform([-2, -2, -np.pi], [2, 2, np.pi])
        at = values | dict(zip((X, Y, PSI), map(float, q), strict=True))
        for name in ("v", "r"):
            assert number_at(derived.outputs[name], at) == pytest.approx(
                number_at(typed.outputs[name], at), rel=1e-9, abs=1e-9
            )


def test_derived_law_brings_the_unicycle_home_from_everywhere():
    """Reference 200 of 200."""
    system = hf.systems.unicycle(speed_limit=1e3, turn_limit=1e3)
    result = hf.simulate(
        system,
        hf.laws.follow_field(system),
        goal=hf.regions.near_origin(system),
        starts=hf.Starts(random=200, box={"x": (-2, 2), "y": (-2, 2), "psi": (-np.pi, np.pi)}),
        horizon=25.0,
        sample_time=0.01,
        record_every=25.0,
    )
    assert result.success_fraction == 1.0


def test_derived_law_works_for_a_system_nobody_thought_of():
    """A sled whose blade is steered through 2 psi, known by its constraint alone."""
    system = rows_only(POSE, hf.PfaffianRow({"x": -sp.sin(2 * PSI), "y": sp.cos(2 * PSI)}))
    result = hf.simulate(
        system,
        hf.laws.follow_field(system),
        goal=hf.regions.near_origin(system),
        starts=hf.Starts(random=200, box={"x": (-2, 2), "y": (-2, 2), "psi": (-1.5, 1.5)}),
        horizon=25.0,
        sample_time=0.01,
        record_every=25.0,
    )
    assert result.success_fraction > 0.97


def test_field_following_of_the_chained_form_is_local():
    """g = (1, x2) cannot turn round: reference 111 of 200 everywhere, 64 of 68 near the p axis."""
    system = hf.systems.chained_form(3)
    assert alignment(structure(system)).turns is False
    starts = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    result = hf.simulate(
        system,
        hf.laws.follow_field(system),
        goal=hf.regions.near_origin(system),
        starts=starts,
        horizon=30.0,
        sample_time=0.01,
        record_every=30.0,
    )
    reached = result.dataset["outcome"].values == hf.Outcome.REACHED
    near = np.abs(starts[:, 2]) < 0.7 * np.abs(starts[:, 0])
    assert reached.mean() < 0.8
    assert reached[near].mean() > 0.85


def test_law_that_would_divide_by_zero_is_refused_at_the_origin_and_called_local_elsewhere():
    cubed = rows_only(POSE, hf.PfaffianRow({"x": -sp.sin(PSI**3), "y": sp.cos(PSI**3)}))
    with pytest.raises(DefinitionError, match="does not turn the direction g at the origin"):
        hf.laws.follow_field(cubed)
    bent = PSI + 2 * PSI**2
    pieces = alignment(
        structure(rows_only(POSE, hf.PfaffianRow({"x": -sp.sin(bent), "y": sp.cos(bent)})))
    )
    assert not pieces.regular
    assert not pieces.everywhere
    assert alignment(structure(hf.systems.unicycle())).everywhere


@pytest.mark.parametrize(
    ("system", "reason"),
    [
        (hf.systems.nonholonomic_integrator(), "the system has no transverse state"),
        (hf.systems.chained_form(4), "relative-degree deficit: h2 contains no transverse"),
        (hf.systems.tractor_trailer(2), "relative-degree deficit: h1, h2 contain no transverse"),
        (hf.systems.marine_vehicle(), "acatastatic: b = .+ moves the system across F"),
    ],
    ids=lambda v: v.name if isinstance(v, hf.System) else None,
)
def test_what_is_missing_for_following_the_field_is_said(system, reason):
    assert hf.laws.follow_field(hf.systems.chained_form(3))
    with pytest.raises(DefinitionError, match=reason):
        hf.laws.follow_field(system)


CHAINED = [
    hf.systems.unicycle(),
    hf.systems.car(),
    hf.systems.chained_form(5),
    *(hf.systems.tractor_trailer(k) for k in (1, 2)),
    pytest.param(hf.systems.tractor_trailer(3), marks=pytest.mark.heavy),
    hf.systems.front_axle_car(),
    hf.systems.tractor_trailer(1, hitch_1=0.2),
    *(
        pytest.param(system, marks=pytest.mark.heavy)
        for system in (
            hf.systems.tractor_trailer(1, hitch_1=-0.2),
            hf.systems.tractor_trailer(1, hitch_1=0.5),
            hf.systems.tractor_trailer(2, hitch_2=0.2),
        )
    ),
]


@pytest.mark.few(
    "wheeled robot that cannot move sideways",
    "car-like robot, by the middle of its rear axle",
    "chained form with 5 states",
)
@pytest.mark.parametrize("system", CHAINED, ids=lambda s: s.description)
def test_found_coordinates_are_exactly_in_chained_form(system):
    """z1' = v1, z2' = v2, zj' = z(j-1) v1 along the system's rates, at random states."""
    found = structure(system)
    form = find_chained_form(found).found.written_out()
    v = hf.symbol("v1"), hf.symbol("v2")
    inputs = {
        u.symbol: a * v[0] + b * v[1]
        for u, (a, b) in zip(found.inputs, form.coefficients, strict=True)
    }
    z = form.coordinates
    wanted = [v[0], v[1], *(e * v[0] for e in z[1:-1])]
    states = [q.symbol for q in system.states]
    for number in range(5):
        # wherever a divisor has shrunk, rounding is measured and not the identity
        at = Sampler({p.symbol: p.value for p in system.parameters}, reach=0.5).point(
            [*states, *v], number
        )
        u = {s: sp.Float(value_at(e, at)) for s, e in inputs.items()}
        for coordinate, expected in zip(z, wanted, strict=True):
            rate = value_at(system.derivative(coordinate).xreplace(u), at)
            assert rate == pytest.approx(value_at(expected, at), rel=1e-7, abs=1e-7)


UNDECLARED = replace(hf.systems.front_axle_car(), flat_output=None)


def test_search_says_why_there_is_no_chain():
    search = find_chained_form(structure(UNDECLARED))
    assert search.found is None
    assert search.tried == search.pairs == 12
    assert "moved by the second input too early" in search.reason
    assert "partial differential equations" in search.reason


def test_search_is_bounded_in_time_and_reports_its_progress():
    heard = []
    found = structure(UNDECLARED)
    assert find_chained_form(found, progress=heard.append).found is None
    assert heard == sorted(heard)
    assert len(heard) == 12
    stopped = find_chained_form(found, limit=0.0)
    assert stopped.found is None
    assert "stopped after 0 s with 0 of 12 pairs" in stopped.reason


@pytest.mark.parametrize("trailers", [1, 2])
def test_chained_coordinates_of_a_tractor_are_those_of_the_literature(trailers):
    """Sordalen: z_n = y, z_(n-1) = tan of the last heading."""
    z = find_chained_form(structure(hf.systems.tractor_trailer(trailers))).found.coordinates
    assert z[0] == X
    assert z[-1] == Y
    assert z[-2] == sp.tan(hf.symbol(f"psi{trailers}"))


def test_coordinates_of_the_car_are_those_of_the_page():
    """(x, tan(delta)/(L cos(psi)^3), tan(psi), y)."""
    found = structure(hf.systems.car(wheelbase=0.3))
    delta, wheelbase = hf.symbol("delta"), hf.symbol("wheelbase")
    expected = (X, sp.tan(delta) / (wheelbase * sp.cos(PSI) ** 3), sp.tan(PSI), Y)
    for coordinate, stated in zip(
        find_chained_form(found).found.coordinates, expected, strict=True
    ):
        assert found.sampler().vanishes(coordinate - stated)


def test_simplification_keeps_the_value():
    a, b = hf.symbol("a"), hf.symbol("b")
    for e in (
        sp.sin(a) / sp.cos(a) ** 3 * b,
        (sp.tan(a) ** 2 + 1) * sp.cos(b),
        (-(sp.tan(a) ** 2) - 1) * sp.sin(a) ** 2 / sp.cos(a),
        sp.sin(a) * sp.sin(b) / sp.cos(a) / sp.cos(b),
    ):
        assert Sampler({}).vanishes(plain(e) - e)
    assert plain(sp.sin(a) / sp.cos(a) ** 2) == sp.tan(a) / sp.cos(a)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [([], 0), ([[0.0, 0.0]], 0), ([[1, 2], [2, 4.0]], 1), ([[1, 2], [2, 5.0]], 2)],
)
def test_rank_of_numbers(rows, expected):
    assert rank([Sampler({}).row(map(sp.Float, row), {}) for row in rows]) == expected


def test_vanishing_is_not_claimed_where_nothing_is_a_number():
    a = hf.symbol("a")
    assert not Sampler({}).vanishes(sp.log(-(a**2) - 1))
    assert Sampler({}).vanishes(sp.sin(a) ** 2 + sp.cos(a) ** 2 - 1)
    for size in (sp.Float(1e-6), sp.Rational(1, 10**20)):
        assert not Sampler({}).vanishes(size * a)
