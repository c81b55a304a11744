"""Whatever else a kernel's filter is asked for, it keeps what the kernel keeps."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import DefinitionError

X, V, U, D = (hf.symbol(n) for n in ("x", "v", "u", "d"))
BOX = {"x": (-1.3, 1.3), "v": (-1.9, 1.9)}
HOLD = 0.05


def quantities(*names: str) -> tuple[hf.Quantity, ...]:
    return tuple(hf.Quantity(n, "1") for n in names)


CART = hf.System(
    "cart", quantities("x", "v"), quantities("u"), {"x": V + D, "v": U},
    disturbances=quantities("d"), input_bounds=hf.Box((-1,), (1,)),
    disturbance_bounds=hf.Box((-0.1,), (0.1,)),
)  # fmt: skip
WALLS = hf.Region(
    "walls", quantities("x", "v"),
    tuple(hf.Inequality(f"c{i}", e) for i, e in enumerate((X - 1, -1 - X, V - 1.7, -1.7 - V))),
)  # fmt: skip
SLOW = hf.Region("slow", quantities("v"), (hf.Inequality("fast", V - 1.5),))


@pytest.fixture(scope="module")
def kernel():
    grid = hf.grid(CART, BOX, dict.fromkeys(BOX, 61))
    return hf.discriminating_kernel(CART, WALLS, grid, 8.0)


def least(kernel, keep, wanted, start, seen=slice(None), seconds=8.0):
    """The least V along a way, for a command that stays and a disturbance that pushes with it."""
    push = 0.1 * np.sign(wanted)
    q, found = np.array(start), np.inf
    for _ in range(round(seconds / HOLD)):
        (u,) = keep.step(q[seen], [wanted]).input
        assert abs(u) <= 1 + 1e-9
        q = q + HOLD * np.array([q[1] + push + HOLD / 2 * u, u])
        found = min(found, float(kernel.at([q])[0]))
    return found


@pytest.mark.few("options1-1.0", "options3--1.0", "options3-1.0", "options4-1.0", "options6-1.0")
@pytest.mark.slow(
    "options0--1.0",
    "options1--1.0",
    "options2--1.0",
    "options4--1.0",
    "options5--1.0",
    "options6--1.0",
)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("wanted", [-1.0, 1.0])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rates": {"u": 80.0}},
        {"rates": {"u": 80.0, "v": 3.0}},
        {"scales": {"u": 7.0}},
        {"states": ("x", "v")},
        {"states": ("x",), "error_bounds": {"x": 0.01, "v": 0.05}},
        {"states": ("x",), "error_bounds": {"x": 0.01, "v": 0.05}, "rates": {"u": 80.0}},
    ],
)
def test_kernel_is_kept_with_every_option(kernel, options, wanted):
    keep = hf.SafetyFilter(CART, kernel, sample_time=HOLD, **options)
    seen = slice(1) if options.get("states") == ("x",) else slice(None)
    assert least(kernel, keep, wanted, (0.0, 0.0), seen) > 0


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("several", [False, True])
def test_kernel_before_a_region_is_kept_with_rates(kernel, several):
    keeps = [kernel, SLOW] if several else [kernel]
    keep = hf.SafetyFilter(CART, keeps, sample_time=HOLD, rates={"u": 80.0, "v": 3.0})
    plain = hf.SafetyFilter(CART, keeps, sample_time=HOLD)
    for q in ([0.5, 0.9], [0.9, 0.2], [-0.8, -0.5]):
        keep.reset()
        keep.step(q, [0.0])  # from an input near the one that is asked for
        asked = plain.step(q, [1.0])
        assert keep.step(q, [1.0]).input == pytest.approx(asked.input, abs=1e-6)
    assert least(kernel, keep, 1.0, (0.0, 0.0)) > 0


@pytest.mark.filterwarnings("ignore")
def test_wide_error_of_what_is_not_measured_makes_the_filter_act_sooner(kernel):
    """By where the corners of what the state may be lead, one and all."""
    narrow, wide = (
        hf.SafetyFilter(
            CART, kernel, sample_time=HOLD, states=("x",), error_bounds={"x": 0.01, "v": e}
        )
        for e in (0.01, 0.4)
    )
    for x in (0.6, 0.8):
        wide.reset(), narrow.reset()
        assert wide.step([x], [1.0]).input[0] < narrow.step([x], [1.0]).input[0] - 0.2


@pytest.mark.filterwarnings("ignore")
def test_value_of_a_state_that_is_partly_estimated_is_that_of_the_estimate(kernel):
    keep = hf.SafetyFilter(
        CART, kernel, sample_time=HOLD, states=("x",), error_bounds={"x": 0.01, "v": 0.05}
    )
    assert keep.step([0.2], [0.0]).value == pytest.approx(
        float(kernel.at([[0.2, 0.0]])[0]), abs=0.1
    )


@pytest.mark.filterwarnings("ignore")
def test_kernel_that_lasts_for_ever_has_no_time_that_is_past(kernel):
    assert kernel.report.converged
    keep = hf.SafetyFilter(CART, kernel, sample_time=HOLD)
    assert keep.step([0.2, 0.0], [0.0], -5.0).status is keep.step([0.2, 0.0], [0.0], 5.0).status
    assert keep.step([0.2, 0.0], [0.0], -5.0).status is hf.Status.PASSED


@pytest.mark.filterwarnings("ignore")
def test_filter_by_slopes_is_refused_where_a_state_has_an_error(kernel):
    with pytest.raises(DefinitionError, match=r"goes by the slope .* no error of 'v'"):
        hf.SafetyFilter(
            CART, kernel, sample_time=HOLD, ahead=False, states=("x",),
            error_bounds={"x": 0.01, "v": 0.05},
        )  # fmt: skip
