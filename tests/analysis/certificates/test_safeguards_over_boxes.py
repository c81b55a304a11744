"""What a quadratic program gives over a box has its minimiser at every place of the box."""

import itertools
from fractions import Fraction

import flint
import numpy as np
import pytest

from holdfast.execution.arithmetic.steps import Steps, choose
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.intervals import law_ranges
from holdfast.execution.intervals.enclosure import pairs
from holdfast.execution.intervals.tape import number
from holdfast.execution.leaf import compiled_leaves
from holdfast_check import safeguard
from holdfast_check.intervals import interval, point


def minimiser(wanted, normals, offsets):
    """Of |u - wanted|^2 in half-spaces, by its conditions in floats; None if there is none."""
    m, best = len(wanted), None
    for k in range(m + 1):
        for rows in itertools.combinations(range(len(offsets)), k):
            a, b = normals[list(rows)], offsets[list(rows)]
            if k and abs(np.linalg.det(a @ a.T)) < 1e-9:
                continue
            pull = np.linalg.solve(a @ a.T, a @ wanted - b) if k else np.zeros(0)
            u = wanted - a.T @ pull
            if (pull > -1e-12).all() and (normals @ u <= offsets + 1e-9).all():
                far = float(((u - wanted) ** 2).sum())
                if best is None or far < best[0]:
                    best = far, u
    return None if best is None else best[1]


def program(generator, m, soft):
    """Bounds of each input and some slanted conditions: normals and offsets that vary a little."""
    normals = [[float(s * (i == k)) for k in range(m)] for i in range(m) for s in (1, -1)]
    offsets = [1.0] * (2 * m)
    for _ in range(soft):
        normals.append(generator.uniform(-1, 1, m).round(2).tolist())
        offsets.append(round(generator.uniform(-0.6, 0.8), 2))
    hard = 2 * m
    wide = generator.choice([0.0, 0.02, 0.1])
    low, high = np.array(normals), np.array(normals)
    low[hard:] -= wide
    high[hard:] += wide
    b = np.array(offsets)
    return (low, high), (b, b + wide * (np.arange(len(b)) >= hard)), hard, wide


def checked(wanted, normals, offsets, hard, m):
    zero = [
        [bool(a == b == 0) for a, b in zip(*rows, strict=True)]
        for rows in zip(*normals, strict=True)
    ]
    return list(safeguard.choices(safeguard.Values(
        [interval(float(a), float(b)) for a, b in zip(*wanted, strict=True)],
        [[interval(float(a), float(b)) for a, b in zip(*rows, strict=True)]
         for rows in zip(*normals, strict=True)],
        zero,
        [interval(float(a), float(b)) for a, b in zip(*offsets, strict=True)],
        hard, [point(1)] * m, [(point(-1), point(1))] * m,
    )))  # fmt: skip


def searched(wanted, normals, offsets, hard, m):
    """(may, sure, low, high) of every choice."""
    steps, columns, values = Steps(expanded=True), [], []

    def taken(low, high):
        if low == high:
            return number(steps, Fraction(float(low)))
        columns.extend((f"q{len(columns)}", f"q{len(columns) + 1}"))
        values.extend((low, high))
        return pairs(steps, columns[-2:])[0]

    one = number(steps, Fraction(1))
    p = law_ranges.Values(
        steps, [taken(*e) for e in zip(*wanted, strict=True)],
        [[taken(*e) for e in zip(*rows, strict=True)] for rows in zip(*normals, strict=True)],
        [taken(*e) for e in zip(*offsets, strict=True)], hard, [one] * m, [(-one, one)] * m, True,
    )  # fmt: skip
    results, found = [], list(law_ranges.choices(p))
    for g in found:
        results += [choose(g.may, 1.0, 0.0), choose(g.sure, 1.0, 0.0)]
        results += [end for q in g.inputs for end in (q.low, q.high)]
    columns, values = columns or ["q0"], values or [0.0]
    leaves = compiled_leaves({"program": Leaf(steps, {"q": columns}, results)})
    row = leaves.values("program", 1, len(results), np.array([values]))[0]
    return row.reshape(len(found), 2 + 2 * m)


@pytest.mark.few("1-1")
@pytest.mark.parametrize(("m", "soft"), [(1, 1), (1, 2), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2)])
def test_minimiser_of_every_place_is_among_what_may_be_given(m, soft):
    flint.ctx.prec = 80
    generator, sure, relaxed = np.random.default_rng([m, soft]), 0, 0
    for _ in range(25):
        normals, offsets, hard, wide = program(generator, m, soft)
        middle = generator.uniform(-2, 2, m)
        wanted = middle - wide, middle + wide
        ours = checked(wanted, normals, offsets, hard, m)
        theirs = searched(wanted, normals, offsets, hard, m)
        assert len(ours) == len(theirs)
        for (may, certain, u), row in zip(ours, theirs, strict=True):
            assert row[0] or not may
            assert certain or not row[1]
            for q, (low, high) in zip(u if may else [], row[2:].reshape(m, 2), strict=False):
                assert not any((float(q[0]) < low, float(q[1]) > high))
        sure += any(certain for _, certain, _ in ours)
        relaxed += ours[-1][0]
        for _ in range(40):
            share = generator.random((len(offsets[0]), m))
            at = normals[0] + share * (normals[1] - normals[0])
            b = offsets[0] + generator.random(len(offsets[0])) * (offsets[1] - offsets[0])
            w = wanted[0] + generator.random(m) * (wanted[1] - wanted[0])
            u = minimiser(w, at, b)
            if u is None:
                assert ours[-1][0]
                continue
            inside = [
                all(not (float(q[0]) > v + 1e-7 or float(q[1]) < v - 1e-7)
                    for q, v in zip(inputs, u, strict=True))
                for may, _, inputs in ours if may
            ]  # fmt: skip
            assert any(inside), (w, at, b, u)
    assert sure > 3
    if soft > 1:
        assert relaxed
