"""When the linearised cone is the contingent cone, beside projections onto the region."""

import numpy as np
import pytest
from scipy.optimize import minimize

import holdfast as hf
from holdfast.analysis.boundary import Boundary, equalities, generators, qualified

STEP = 1e-3


def apart(v, gradients, curvatures, equal):
    """How far the point at STEP v is from the region, in steps; 1 where nothing nearer is in it.

    The region is g_i . x + x' H_i x / 2 <= 0, and = 0 for those of `equal`, at the origin.
    """

    def values(z, rows):
        x = v + z
        return np.array([gradients[i] @ x + STEP / 2 * x @ curvatures[i] @ x for i in rows])

    below, ties = np.flatnonzero(~equal), np.flatnonzero(equal)
    kinds = [{"type": "ineq", "fun": lambda z: -values(z, below)}] if len(below) else []
    if len(ties):
        kinds.append({"type": "eq", "fun": lambda z: values(z, ties)})
    best = 1.0
    for begin in (np.zeros(len(v)), *np.random.default_rng(0).normal(size=(1, len(v))) * 0.02):
        found = minimize(
            lambda z: z @ z, begin, jac=lambda z: 2 * z, method="SLSQP", constraints=kinds,
            options={"maxiter": 60, "ftol": 1e-12},
        )  # fmt: skip
        worst = max(
            values(found.x, below).max(initial=0), abs(values(found.x, ties)).max(initial=0)
        )
        if worst < 1e-2 * STEP:
            best = min(best, float(np.linalg.norm(found.x)))
    return best


def directions(gradients, generator):
    """Of the linearised cone: its generators, and some between them."""
    rays, lines = generators(gradients)
    spanning = np.vstack([rays, lines, -lines])
    if not len(spanning):
        return
    yield from spanning
    for weights in generator.exponential(size=(4, len(spanning))):
        v = weights @ spanning
        if np.linalg.norm(v) > 0.1:
            yield v / np.linalg.norm(v)


def constraints(generator, n, kind):
    """Gradients, curvatures, which are linear, and the equality that each is a side of."""
    count = int(generator.integers(2, 5))
    gradients = generator.integers(-1, 2, (count, n)).astype(float)
    gradients[~gradients.any(axis=1), 0] = 1.0
    curvatures = generator.integers(-1, 2, (count, n, n)).astype(float)
    curvatures = (curvatures + curvatures.transpose(0, 2, 1)) / 2
    if kind == "linear":
        curvatures[:] = 0
    if kind == "mixed":
        curvatures[: count // 2] = 0
    redundant = generator.integers(0, count)  # the same again, in another unit
    more = [(3 * gradients[redundant], 3 * curvatures[redundant])]
    if kind == "linear":  # opposed: no interior
        more.append((-2 * gradients[0], curvatures[0]))
        more.append((gradients[0] + gradients[1], curvatures[0]))
    elif (
        kind != "equalities" and generator.random() < 0.5
    ):  # opposed, with another curvature: perhaps a cusp
        more.append((-gradients[0], curvatures[-1]))
    if kind == "equalities":
        more.append((-gradients[0], -curvatures[0]))
    for g, h in more:
        if g.any():
            gradients, curvatures = np.vstack([gradients, g]), np.vstack([curvatures, [h]])
    linear = ~curvatures.any(axis=(1, 2))
    points = generator.normal(size=(20, n))
    values = points @ gradients.T + np.einsum("ki,jil,kl->kj", points, curvatures, points) / 2
    return gradients, curvatures, linear, equalities(gradients, values)


@pytest.mark.few("linear")
@pytest.mark.parametrize("kind", ["linear", "mixed", "curved", "equalities"])
def test_every_direction_of_a_qualified_cone_is_tangent_to_the_region(kind):
    """Redundant constraints, opposed ones, dependent gradients, in two and three states."""
    generator, told, smaller = np.random.default_rng(2), [], 0
    for _ in range(20):
        n = int(generator.integers(2, 4))
        gradients, curvatures, linear, equality = constraints(generator, n, kind)
        told.append(qualified(gradients, linear, equality))
        _, first = np.unique(equality, return_index=True)
        once = np.isin(np.arange(len(equality)), first) & (equality >= 0)
        kept = once | (equality < 0)  # of both sides one, as an equality
        parts = gradients[kept], curvatures[kept], once[kept]
        far = [apart(v, *parts) for v in directions(gradients, generator)]
        if told[-1]:
            assert max(far, default=0.0) < 0.1
        smaller += max(far, default=0.0) > 0.5
    if kind == "linear":
        assert all(told)
    else:  # it is said often, and not always
        assert told.count(True) >= 5
        assert told.count(False) >= smaller > 0


X, Y, Z = (hf.symbol(n) for n in "xyz")


def boundary(*expressions):
    states = tuple(hf.Quantity(n) for n in "xyz")
    inputs = tuple(hf.Quantity(n) for n in "abc")
    rates = dict(zip("xyz", (q.symbol for q in inputs), strict=True))
    system = hf.System("point", states, inputs, rates, input_bounds=hf.Box((-1,) * 3, (1,) * 3))
    named = tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate(expressions))
    return Boundary(system, hf.Region("room", states, named))


@pytest.mark.parametrize(
    ("expressions", "exact"),
    [
        ((X, -X), True),  # a plane
        ((X, Y, -X - Y), True),  # an edge, by three
        ((X, 2 * X, X + X**2), True),  # the same slope thrice
        ((X, Y, X + Y, X - Y**2), True),
        ((Y + X**2, -Y), False),  # one point of the plane z = 0
        ((Y - X**3, -Y), False),  # a cusp
        ((Y - X**2, -2 * Y + 2 * X**2), True),  # a surface, in two units
        ((Y - X**2, X**2 - Y, X - Z**2, Z**2 - X), True),  # a curve
        ((Y - X**2, X**2 - Y, Y - Z**2, Z**2 - Y), False),  # two crossing lines
        ((Y - X**2, X**2 - Y, -Y), False),  # all of it satisfied, and not recognised
        ((Y - X**2, X**2 - Y, Z, -Z), True),  # a curve in a plane
        ((hf.parse_expression("abs(y) - x", {"x": X, "y": Y}), Z), True),
    ],
)
def test_cone_and_regulation_map_say_the_same_of_what_is_exact(expressions, exact):
    found = boundary(*expressions)
    cone = found.contingent_cone([0.0, 0.0, 0.0])
    assert (cone.qualified, found.regulation_map([0.0] * 3).qualified) == (exact, exact)
    inside = found.contingent_cone([-0.5, -0.5, 0.0]) if expressions == (X, 2 * X) else cone
    assert inside.qualified == exact


def test_qualification_does_not_depend_on_units():
    for unit in (1e-6, 1.0, 1e6):
        for exact, expressions in (
            (True, (X * unit - Y**2, X + Y, Z - X * unit)),
            (True, (unit * (Y - X**2), X**2 - Y)),
            (False, (unit * (Y + X**2), -Y)),
        ):
            assert boundary(*expressions).contingent_cone([0.0] * 3).qualified == exact
