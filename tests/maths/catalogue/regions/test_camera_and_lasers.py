"""The safe set of chapter 7 against rays cast by hand."""

import math

import numpy as np
import pytest
import sympy as sp

import holdfast as hf

REGION = hf.regions.camera_and_lasers()
VALUES = {q.symbol: q.value for q in REGION.parameters}
STATE = [q.symbol for q in REGION.reads]


def levels(points, **changed):
    values = VALUES | {hf.symbol(n): v for n, v in changed.items()}
    rows = [c.expression.xreplace(values) for c in REGION.inequalities]
    modules = [{"magnitude": np.abs}, "numpy"]
    return np.array(sp.lambdify(STATE, rows, modules)(*points.T)).T


def image(point, pose):
    """Where a point of the plane is on the image (focal length 1); None behind the camera."""
    x, y, psi = pose
    dx, dy = point[0] - x, point[1] - y
    ahead = dx * math.cos(psi) + dy * math.sin(psi)
    aside = -dx * math.sin(psi) + dy * math.cos(psi)
    return aside / ahead if ahead > 0 else None


def dot(pose, offset):
    """Where the laser at body (0, offset) meets the wall, and how far that is."""
    x, y, psi = pose
    start = (x - offset * math.sin(psi), y + offset * math.cos(psi))
    length = -start[0] / math.cos(psi)
    return (0.0, start[1] + length * math.sin(psi)), length


def seen(pose, *, d, far, e, w, off, yt=0.1, alpha=math.pi / 6):
    if pose[0] > -off:
        return False
    ends = [image((0.0, side * yt), pose) for side in (-1, 1)]
    spots = [dot(pose, side * d) for side in (1, -1)]
    places = [image(p, pose) for p, _ in spots]
    if any(v is None or abs(v) > math.tan(alpha) for v in (*ends, *places)):
        return False
    if any(not 0 < length <= far for _, length in spots):
        return False
    return abs(places[0] - places[1]) >= e and abs(ends[1] - ends[0]) >= w


@pytest.mark.parametrize(
    "numbers",
    [
        {"d": 0.05, "far": 2.0, "e": 0.04, "w": 0.08, "off": 0.3},
        {"d": 0.2, "far": 2.0, "e": 0.24, "w": 0.08, "off": 0.3},
    ],
)
def test_region_is_what_rays_say(numbers):
    generator = np.random.default_rng(0)
    points = generator.uniform((-2.6, -1.6, -math.pi / 2), (-0.01, 1.6, math.pi / 2), (6000, 3))
    names = {
        "laser_offset": numbers["d"], "range_max": numbers["far"],
        "dot_separation": numbers["e"], "image_width": numbers["w"], "stand_off": numbers["off"],
    }  # fmt: skip
    ours = (levels(points, **names) <= 0).all(axis=1)
    rays = np.array([seen(tuple(p), **numbers) for p in points])
    assert 200 < rays.sum() < 2000
    assert np.array_equal(ours, rays)


def test_dots_bind_only_when_the_lasers_are_far_apart():
    generator = np.random.default_rng(1)
    points = generator.uniform((-2.6, -1.6, -math.pi / 2), (-0.01, 1.6, math.pi / 2), (20000, 3))
    others = [0, 1, 4, 6, 7]
    standard, wide = levels(points), levels(points, laser_offset=0.2, dot_separation=0.24)
    assert not ((standard[:, others] <= 0).all(axis=1) & (standard > 0).any(axis=1)).any()
    assert ((wide[:, others] <= 0).all(axis=1) & (wide > 0).any(axis=1)).sum() > 20


def test_forms_with_tangents_give_up_poses_that_see_the_target():
    """(5.23) in tan(psi +- alpha) changes sign where that angle exceeds 90 degrees."""
    generator = np.random.default_rng(0)
    points = generator.uniform((-2.6, -1.6, -math.pi / 2), (0, 1.6, math.pi / 2), (40_000, 3))
    c, (x, y, psi) = levels(points), points.T
    low = y - x * np.tan(psi - math.pi / 6) + 0.1 <= 0
    high = 0.1 - y + x * np.tan(psi + math.pi / 6) <= 0
    ours = (c <= 0).all(axis=1)
    theirs = (c[:, 2:] <= 0).all(axis=1) & low & high
    assert not (theirs & ~ours).any()
    assert (ours & ~theirs).sum() == 184
    assert (np.abs(psi[ours & ~theirs]) + math.pi / 6 > math.pi / 2).all()


def test_volume_of_the_safe_set():
    """Shares of the box on two grids: 0.10908 and 0.11162."""
    for nodes, share in ((51, 0.10908), (101, 0.11162)):
        sides = [
            np.linspace(a, b, nodes)
            for a, b in ((-2.6, 0), (-1.6, 1.6), (-math.pi / 2, math.pi / 2))
        ]
        points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
        assert (levels(points) <= 0).all(axis=1).mean() == pytest.approx(share, abs=2e-4)
