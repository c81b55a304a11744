"""Targets that a vehicle sees, in exact steps of their motion, pushed by the worst disturbance."""

import itertools
import math

import numpy as np

CORNERS = np.array([complex(a, b) for a, b in itertools.product((-0.1, 0.1), (-0.15, 0.15))])
"""Of the disturbances of the camera of `certified_systems.py`."""


def starts_in(certificate, cells, count, seed, corners=0.2):
    """States drawn in cells, and at corners of them."""
    rng = np.random.default_rng(seed)
    low, high = certificate.cells.corners(rng.choice(cells, count))
    inside = low + rng.uniform(size=low.shape) * (high - low)
    corner = np.where(rng.uniform(size=low.shape) < 0.5, low, high)
    return np.where(rng.uniform(size=(count, 1)) < corners, corner, inside)


def most(z):
    """The largest constraint of the view at places ahead + i left."""
    edge = math.tan(math.pi / 6) * z.real
    return np.max([0.35 - z.real, z.real - 2, z.imag - edge, -z.imag - edge], axis=0)


def moved(z, u, r, push, step):
    """The exact motion z' = -i r z - u - push of the target for a time, r and push held."""
    turned = np.exp(-1j * r * step)
    still = np.abs(r) < 1e-12
    lever = np.where(still, step, (1 - turned) / np.where(still, 1.0, 1j * r))
    return turned * z - (u + push) * lever


def worst_of(certificate, answer, count, samples, pieces, seed, late=0, error=0.0):
    """The largest constraint in runs against corners of the disturbance, chosen piece by piece.

    answer: the inputs at states, shape (count, 2) both. late: of how many pieces the inputs are,
    until when those of before act, or any at first. error: by which `left` is measured wrong, on
    the side that is worst for the run, or any; the first measurement is in a certified cell.
    """
    rng = np.random.default_rng(seed)
    start = starts_in(certificate, certificate.kept.members, count, seed)
    seen = start[:, 0] + 1j * start[:, 1]
    kind = np.arange(count) % 3  # the corner that is worst then, any corner, one for a sample
    z = seen + 1j * error * _sides(seen, kind, rng)
    worst, step = most(z).max(), certificate.hold / pieces
    before = certificate.candidates[rng.integers(0, len(certificate.candidates), count)]
    for _ in range(samples):
        inputs = answer(np.stack([seen.real, seen.imag], axis=1))
        fixed = rng.integers(0, 4, count)
        for piece in range(pieces):
            acts = before if piece < late else inputs
            ends = moved(z[:, None], acts[:, :1], acts[:, 1:], CORNERS, step)
            bad = most(ends).argmax(axis=1)
            chosen = np.choose(kind, [bad, rng.integers(0, 4, count), fixed])
            z = ends[np.arange(count), chosen]
            worst = max(worst, most(z).max())
        before, seen = inputs, z - 1j * error * _sides(z, kind, rng)
    return worst


def _sides(z, kind, rng):
    """Farther out than it is seen, or on any side."""
    return np.where(kind == 0, np.sign(z.imag), rng.choice([-1.0, 1.0], len(z)))
