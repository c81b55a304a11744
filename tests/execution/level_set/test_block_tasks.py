"""What is done with the nodes of blocks, beside the same for whole arrays."""

import math
from contextlib import contextmanager

import numpy as np
import pytest

from holdfast.execution.level_set.refined_march import (
    CROSSED,
    CROSSED_HIGH,
    CROSSED_LOW,
    Blocks,
    BlockTasks,
)
from holdfast.execution.level_set.sweeping import Workers

GRIDS = [
    ((41,), (False,), (16,)),
    ((37, 44), (False, True), (8, 16)),
    ((18, 21, 33), (True, False, False), (4, 4, 16)),
    ((9, 10, 7, 12), (False, True, False, True), (4, 4, 4, 8)),
]
"""Nodes, which axes are periodic, nodes of a block: the last of a row is not whole."""


@contextmanager
def tasks(shape, periodic, sizes, precision="float64"):
    blocks = Blocks(shape, periodic, sizes)
    with Workers(2, 1) as workers:
        yield blocks, BlockTasks(blocks, workers, precision)


def some_blocks(blocks, seed=1):
    return np.random.default_rng(seed).random(blocks.counts) < 0.5


def at_nodes(blocks, flags):
    """The flag of the block that a node is in."""
    for i, (n, size) in enumerate(zip(blocks.shape, blocks.sizes, strict=True)):
        flags = np.take(flags, np.arange(n) // size, axis=i)
    return flags


def linear(coarse, periodic):
    """Between the nodes along every axis."""
    found = coarse
    for i, around in enumerate(periodic):
        rows = np.moveaxis(found, i, 0)
        after = np.roll(rows, -1, 0)
        both = np.stack([rows, 0.5 * (rows + after)], axis=1).reshape(-1, *rows.shape[1:])
        found = np.moveaxis(both if around else both[:-1], 0, i)
    return np.ascontiguousarray(found)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(("shape", "periodic", "sizes"), GRIDS)
def test_blocks_are_filled_and_handed_down(shape, periodic, sizes, precision):
    """Linear between the nodes of the lesser value, within both bounds; and back again."""
    rng = np.random.default_rng(0)
    with tasks(shape, periodic, sizes, precision) as (blocks, do):
        one, other = rng.normal(size=(2, *blocks.coarse)).astype(precision)
        values, upper, lower = rng.normal(size=(3, *shape)).astype(precision)
        chosen = some_blocks(blocks)
        here = at_nodes(blocks, chosen)
        low, high = np.minimum(upper, lower), np.maximum(upper, lower)
        for bounds in ((None, None), (high, low)):
            found, again = values.copy(), values.copy()
            do.fill(chosen, [found, again], (one, other), bounds)
            wanted = linear(np.minimum(one, other), periodic)
            if bounds[0] is not None:
                wanted = np.minimum(np.maximum(wanted, low), high)
            assert (found == np.where(here, wanted, values)).all()
            assert (again == found).all()
        every_other = (slice(None, None, 2),) * len(shape)
        coarse, copied = one.copy(), np.zeros_like(values)
        do.hand_down(chosen, values, coarse)
        assert (coarse == np.where(here[every_other], values[every_other], one)).all()
        do.take_over(chosen, values, copied)
        assert (copied == np.where(here, values, 0)).all()


@pytest.mark.parametrize(("shape", "periodic", "sizes"), GRIDS)
def test_changes_of_sign_and_losses_are_found(shape, periodic, sizes):
    """One node has another sign: the blocks that have it, or have it for a neighbour, are told."""
    rng = np.random.default_rng(2)
    with tasks(shape, periodic, sizes) as (blocks, do):
        chosen, coarse = some_blocks(blocks), np.ones(blocks.coarse)
        for _ in range(20):
            values, place = np.ones(shape), tuple(rng.integers(0, shape))
            values[place] = -1.0
            found = do.crossed(chosen, values, coarse, 2)
            wanted = np.zeros(blocks.counts, dtype=np.uint8)
            for block in np.argwhere(chosen):
                last = [min(s, n - b * s) for b, s, n in zip(block, sizes, shape, strict=True)]
                away = [
                    (p - b * s) % n if around else p - b * s
                    for p, b, s, n, around in zip(place, block, sizes, shape, periodic, strict=True)
                ]
                if all(0 <= a <= c for a, c in zip(away, last, strict=True)):
                    wanted[tuple(block)] = (
                        CROSSED + CROSSED_LOW * (away[-1] <= 2)
                        + CROSSED_HIGH * (away[-1] >= last[-1] - 2)
                    )  # fmt: skip
            assert (found == wanted).all()
        before, now = rng.normal(size=(2, *blocks.coarse))
        apart = ~at_nodes(blocks, chosen)[(slice(None, None, 2),) * len(shape)]
        for side in (1.0, -1.0):
            of = apart & (side * before > 0)
            share = np.abs(now - before)[of] / np.maximum(np.abs(before[of]), 0.1)
            assert math.isclose(do.loss(chosen, before, now, side, 0.1), share.max())


def test_blocks_that_are_not_chosen_are_looked_over_on_the_coarser_grid():
    with tasks((33, 32), (False, True), (8, 8)) as (blocks, do):
        none, values = np.zeros(blocks.counts, dtype=bool), np.ones(blocks.shape)
        coarse = np.ones(blocks.coarse)
        coarse[4, 0] = -1.0  # the node (8, 0): of the block (1, 0), and beside three others
        found = do.crossed(none, values, coarse, 2)
        assert sorted(map(tuple, np.argwhere(found))) == [(0, 0), (0, 3), (1, 0), (1, 3)]


def test_around_an_axis_the_block_behind_a_thin_one_is_near_too():
    blocks = Blocks((34, 34), (True, False), (8, 8))  # two nodes in the last block
    one = np.zeros(blocks.counts, dtype=bool)
    one[3, 1] = True
    assert np.flatnonzero(blocks.wider(one).any(axis=1)).tolist() == [0, 2, 3, 4]
    one[3, 1], one[0, 1] = False, True
    assert np.flatnonzero(blocks.wider(one).any(axis=1)).tolist() == [0, 1, 3, 4]
