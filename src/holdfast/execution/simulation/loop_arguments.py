"""The arguments of the compiled loop, as named tuples: Numba knows tuples, and no other records."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from holdfast.execution.arrays import Array

Whole = npt.NDArray[np.int64]


class Numbers(NamedTuple):
    """The numbers with which the expressions of a closed loop are evaluated.

    plant: the parameters of the simulated vehicle; gains: those that its controller believes, in
    the same order. varied_plant: columns of `plant` for which every run has its own values, in
    its row of `own_plant`; likewise for the gains. table: the lookup table of the law.
    """

    plant: Array
    gains: Array
    varied_plant: Whole
    varied_gains: Whole
    own_plant: Array
    own_gains: Array
    table: Any


class Sampling(NamedTuple):
    """Measurement, sampling and integration of a run.

    noise: (uniform or normal, state); noisy: whether any of it is not 0. samples: control samples
    of `sample_time`, of which every `stride`-th is recorded. absolute, relative: error of an
    adaptive step. tolerance: c_j above it counts as leaving. A run chatters from the time on at
    which its mode changed more than `switch_limit` times within a second. The law sees what was
    measured `delay` samples ago.
    """

    noise: Array
    noisy: bool
    seed: np.uint64
    sample_time: float
    samples: int
    stride: int
    substeps: int
    absolute: float
    relative: float
    tolerance: float
    initial_mode: int
    switch_limit: int
    delay: int


class Records(NamedTuple):
    """The arrays that the loop writes, each indexed by the run: `closed_loop.Trajectories`."""

    state: Array
    input: Array
    actuator: Array
    mode: npt.NDArray[np.int16]
    signal: Array
    constraint: Array
    nominal: Array
    nominal_actuator: Array
    sample_slack: Array
    safeguard: npt.NDArray[np.int8]
    outcome: npt.NDArray[np.int8]
    exit_time: Array
    exit_constraint: npt.NDArray[np.int16]
    goal_time: Array
    worst: Array
    peak_input: Array
    peak_actuator: Array
    switches: Whole
    shortest_dwell: Array
    overruled: Whole
    infeasible: Whole
    largest_slack: Array
    rejected: Whole
    off_grid: Array
