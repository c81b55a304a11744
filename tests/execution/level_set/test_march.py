"""A step of a march beside the formulas of docs/kernels.md written for whole arrays."""

import numpy as np
import pytest

from holdfast.execution.level_set.march import March, Method
from holdfast.execution.level_set.sweeping import SweepCode
from tests.divided_marches import kernel, same
from tests.drift_on_axes import KINDS, C, hamiltonian


def intervals(values, axis, kind, ghosts):
    """The first differences along an axis, last here, of the value continued at both ends."""
    rows = np.moveaxis(values, axis, -1)
    if kind == "extrapolated":
        far = np.arange(1, ghosts + 1)
        low, high = rows[..., :1], rows[..., -1:]
        fall, rise = np.abs(low - rows[..., 1:2]), np.abs(high - rows[..., -2:-1])
        below = low + far[::-1] * np.where(low >= 0, fall, -fall)
        above = high + far * np.where(high >= 0, rise, -rise)
        rows = np.concatenate([below, rows, above], axis=-1)
    else:
        mode = {"periodic": "wrap", "limited": "edge"}[kind]
        rows = np.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(ghosts, ghosts)], mode=mode)
    return np.diff(rows)


def least(a, b):
    return np.where(np.abs(a) <= np.abs(b), a, b)


def upwind(c):
    return c


def eno2(a, b, c):
    return b + 0.5 * least(b - a, c - b)


def eno3(a, b, c, d, e):
    left = np.abs(c - b) <= np.abs(d - c)
    third = least(c - 2 * b + a, d - 2 * c + b), least(d - 2 * c + b, e - 2 * d + c)
    return np.where(
        left, c + 0.5 * (c - b) + third[0] / 3, c + 0.5 * (d - c) - third[1] / 6
    )  # fmt: skip


def weno5(a, b, c, d, e):
    rough = (
        13 / 12 * (a - 2 * b + c) ** 2 + (a - 4 * b + 3 * c) ** 2 / 4,
        13 / 12 * (b - 2 * c + d) ** 2 + (b - d) ** 2 / 4,
        13 / 12 * (c - 2 * d + e) ** 2 + (3 * c - 4 * d + e) ** 2 / 4,
    )
    small = 1e-6 * (sum(rough) + c**2 / 4)
    weights = [k / (r + small) ** 2 for k, r in zip((0.1, 0.6, 0.3), rough, strict=True)]
    of = (2 * a - 7 * b + 11 * c, -b + 5 * c + 2 * d, 2 * c + 5 * d - e)
    return sum(w * s for w, s in zip(weights, of, strict=True)) / (6 * sum(weights))


SCHEMES = {"upwind": (upwind, 1), "eno2": (eno2, 2), "eno3": (eno3, 3), "weno5": (weno5, 3)}


def side(scheme, differences):
    """The slope between zero and twice the plain difference."""
    plain = differences[len(differences) // 2]
    slope = SCHEMES[scheme][0](*differences)
    limited = np.clip(slope, -2 * np.abs(plain), 2 * np.abs(plain))
    return np.where(slope * plain > 0, limited, 0.0)


def stepped(values, axes, kinds, scheme, dt):
    ghosts = SCHEMES[scheme][1]
    rate = np.zeros_like(values)
    for i, (axis, kind) in enumerate(zip(axes, kinds, strict=True)):
        d = intervals(values, i, kind, ghosts) / (axis[1] - axis[0])
        n, around = len(axis), 2 * ghosts - 1
        left = side(scheme, [d[..., k : k + n] for k in range(around)])
        right = side(scheme, [d[..., around - k : around - k + n] for k in range(around)])
        mean, gap = (np.moveaxis(x, -1, i) for x in ((left + right) / 2, (right - left) / 2))
        shape = [-1 if k == (i - 1) % len(axes) else 1 for k in range(len(axes))]
        drift = C[i] * axes[i - 1].reshape(shape)
        rate += drift * mean + np.abs(mean) + (np.abs(drift) + 1) * gap
    return values + dt * rate


FLAT = [(41,), (300,), (12, 70), (9, 200)]
DEEP = [(40, 30, 31), (11, 8, 90), (3, 140, 8)]
STEPS = [(s, scheme) for s in FLAT for scheme in SCHEMES]
STEPS += [(s, scheme) for s in DEEP for scheme in ("upwind", "weno5")] + [((7, 8, 9, 13), "weno5")]
"""Shapes and schemes: a scheme is along one axis, so that not all need all dimensions."""


@pytest.mark.slow(
    "(41,)-upwind", "(40, 30, 31)-upwind", "(40, 30, 31)-weno5", "(7, 8, 9, 13)-weno5"
)
@pytest.mark.parametrize(("shape", "scheme"), STEPS, ids=str)
def test_a_step_is_that_of_the_formulas(shape, scheme):
    if min(shape) <= 2 * SCHEMES[scheme][1]:
        pytest.skip("fewer nodes than the stencil")
    n = len(shape)
    rng = np.random.default_rng(1)
    axes = [np.linspace(-1, 1 + 0.3 * i, m) for i, m in enumerate(shape)]
    kinds = [KINDS[i % 3] for i in range(n)]
    start = np.sin(sum((i + 2) * np.meshgrid(*axes, indexing="ij")[i] for i in range(n)))
    start += 0.05 * rng.normal(size=shape)
    start -= 0.2 * np.abs(start)  # and with kinks
    march = March(
        hamiltonian(n), (), axes, [a[1] - a[0] for a in axes], kinds,
        method=Method(scheme, order=1, dissipation="local"), limit="free", threads=2,
    )  # fmt: skip
    dt = 0.9 * march.longest_step
    values = start.ravel().copy()
    march.run(values, [dt, 2 * dt])
    want = stepped(stepped(start, axes, kinds, scheme, dt), axes, kinds, scheme, dt)
    np.testing.assert_allclose(values.reshape(shape), want, rtol=0, atol=1e-11)


@pytest.mark.parametrize("scheme", ["upwind", "weno5"])
def test_a_sweep_depends_on_nothing_that_is_in_its_memory(scheme, monkeypatch):
    """That is kept from call to call, for every thread."""
    clean = kernel(scheme=scheme, threads=2)
    true = SweepCode.memory

    def spoilt(self, room):
        arrays = true(self, room)
        for array in arrays:
            array.view(np.uint8)[:] = 0xFF  # NaN, or -1
        return arrays

    monkeypatch.setattr(SweepCode, "memory", spoilt)
    same(clean, kernel(scheme=scheme, threads=2))
