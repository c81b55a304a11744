"""Nodes where something holds are told apart without a list of them."""

import numpy as np
import pytest

from holdfast.analysis.reachability.value_function import Places


@pytest.mark.parametrize("shape", [(7,), (5, 4), (3, 6, 2)])
def test_places_are_those_of_a_list(shape):
    there = np.random.default_rng(0).random(shape) < 0.4
    found = Places(lambda k: there[k], shape)
    assert len(found) == there.sum()
    ranks = np.array([len(found) - 1, 0, 1, 0])
    for mine, listed in zip(found.at(ranks), np.nonzero(there), strict=True):
        assert mine.tolist() == listed[ranks].tolist()


def test_there_may_be_none():
    found = Places(lambda k: np.zeros(3) > 1, (4, 3))
    assert len(found) == 0
    assert [len(k) for k in found.at(np.arange(0))] == [0, 0]
