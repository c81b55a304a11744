"""A verdict does not depend on units: seconds, metres and radians rescaled by powers of ten."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import holdfast as hf

X, TH, U, D = (hf.symbol(n) for n in ("x", "theta", "u", "d"))
SCHEMES = ("upwind", "eno2", "eno3", "weno5")
KINDS = (
    "viability_kernel", "discriminating_kernel", "invariance_kernel", "backward_reachable_tube",
    "forward_reachable_set", "capture_basin",
)  # fmt: skip
POWERS = st.integers(-6, 6).map(lambda k: 10.0**k)
HORIZON = 3.0  # s, before they are rescaled
ROUNDING = 1e-5  # of the half-width of the region


def quantity(name, unit="1"):
    return hf.Quantity(name, unit)


GAIN, RATE, LIMIT, INNER = (
    hf.Parameter(n, "1", value=1.0) for n in ("gain", "rate", "limit", "inner")
)
STEERED = hf.System(
    "steered", (quantity("x"), quantity("theta")), (quantity("u"),),
    {"x": GAIN.symbol * TH, "theta": RATE.symbol * (U + D)},
    disturbances=(quantity("d"),), parameters=(GAIN, RATE),
    input_bounds=hf.Box((-1,), (1,)), disturbance_bounds=hf.Box((-0.3,), (0.3,)),
)  # fmt: skip


def within(limit):
    x = (quantity("x"),)
    rows = (hf.Inequality("low", -limit.symbol - X), hf.Inequality("high", X - limit.symbol))
    return hf.Region(limit.name, x, rows, parameters=(limit,))


def solved(kind, scheme, second=1.0, metre=1.0, radian=1.0, horizon=HORIZON):
    """The problem with so many of the new units in one of the old."""
    box = {"x": (-1.3 * metre, 1.3 * metre), "theta": (-1.8 * radian, 1.8 * radian)}
    ends = "limited" if kind == "forward_reachable_set" else "extrapolated"  # it goes past them
    grid = hf.grid(STEERED, box, 41, ends=dict.fromkeys(box, ends))
    parameters = {"gain": metre / (radian * second), "rate": radian / second, "limit": metre}
    regions = [within(LIMIT)]
    if kind in ("backward_reachable_tube", "forward_reachable_set"):
        regions = [within(INNER)]
        parameters = parameters | {"inner": 0.2 * metre}
        del parameters["limit"]
    if kind == "capture_basin":
        regions = [within(INNER), within(LIMIT)]
        parameters = parameters | {"inner": 0.2 * metre}
    given_ = {"disturbance": {"d": 0.1}} if kind == "viability_kernel" else {}
    return getattr(hf, kind)(
        STEERED, *regions, grid, horizon * second, scheme=scheme, parameters=parameters, **given_
    )


def same(one, other, metre):
    """Steps, verdicts and set. Rounding decides on which side of zero a node is that lies on the
    boundary."""
    a, b = one.dataset.attrs, other.dataset.attrs
    for name in ("steps", "converged", "empty"):
        assert a[name] == b[name], name
    assert b["residual_cells"] == pytest.approx(a["residual_cells"], rel=1e-3, abs=1e-9)
    values, scaled = one.values(), other.values() / metre
    assert np.abs(scaled - values).max() < ROUNDING
    clear = np.abs(values) > ROUNDING
    assert ((values > 0) == (scaled > 0))[clear].all()


CASES = [(kind, "weno5") for kind in KINDS] + [("discriminating_kernel", s) for s in SCHEMES[:-1]]
EVERY = [(kind, scheme) for kind in KINDS for scheme in SCHEMES]


@pytest.mark.few("invariance_kernel-weno5")
@pytest.mark.parametrize(
    ("kind", "scheme"),
    CASES + [pytest.param(*c, marks=pytest.mark.heavy) for c in EVERY if c not in CASES],
)
def test_no_unit_changes_steps_verdict_or_set(kind, scheme):
    first = solved(kind, scheme)

    @settings(max_examples=8)
    @given(POWERS, POWERS, POWERS)
    def rescaled(second, metre, radian):
        same(first, solved(kind, scheme, second, metre, radian), metre)

    rescaled()
    for second, metre, radian in ((1e-6, 1e6, 1e6), (1e6, 1e-6, 1e-6), (1e6, 1e6, 1e-6)):
        same(first, solved(kind, scheme, second, metre, radian), metre)


def test_constraints_of_two_units_are_free_of_both_by_their_scales():
    """Metres beside radians, each constraint with a scale in its own unit."""

    def with_scales(second, metre, radian):
        heading = hf.Inequality("heading", TH**2 / radian**2 - 1, scale=1.0)
        rows = (
            hf.Inequality("low", -LIMIT.symbol - X, scale=metre),
            hf.Inequality("high", X - LIMIT.symbol, scale=metre),
        )
        both = hf.Region("both", STEERED.states, (*rows, heading), parameters=(LIMIT,))
        box = {"x": (-1.3 * metre, 1.3 * metre), "theta": (-1.8 * radian, 1.8 * radian)}
        values = {"gain": metre / (radian * second), "rate": radian / second, "limit": metre}
        grid = hf.grid(STEERED, box, 41)
        return hf.discriminating_kernel(STEERED, both, grid, 3.0 * second, parameters=values)

    first = with_scales(1.0, 1.0, 1.0)
    for second, metre, radian in ((1e-6, 1e6, 1e-6), (1e6, 1e-6, 1e6)):
        same(first, with_scales(second, metre, radian), 1.0)
