"""Sets of states by the level sets of a value: what the problems of viability have in common.

With tau the time to go, W the value, l the margin of a region (`Region.margin`, positive inside):

    kernel      dW/dtau = min(0, H),   W(0) = l_K      stay in K for tau
    reach       dW/dtau = max(0, H),   W(0) = l_T      be in T within tau
    capture     dW/dtau = H,  l_G <= W, W <= l_K       be in G within tau, and in K until then

    where the problem depends on time   dW/dtau = H, and
    kernel      W <= l_K(t)            reach      l_T(t) <= W            capture as above, at t

H is the best of one player against the worst of the other (`maths/hamiltonian.py`). Positive is in
the set, in every problem.
"""

from __future__ import annotations

from holdfast.analysis.reachability.disk_estimate import check_disk
from holdfast.analysis.reachability.divided_march import DividedMarch, PartsLostError, workplace
from holdfast.analysis.reachability.march_part import hamiltonian_of
from holdfast.analysis.reachability.memory_estimate import check_fits
from holdfast.analysis.reachability.one_march import OneMarch, Progress, Until
from holdfast.analysis.reachability.problem import Posed
from holdfast.analysis.reachability.refinement import on_finer_grid
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.execution.arrays import AnyArray as Array
from holdfast.maths.games.hamiltonian import Hamiltonian
from holdfast.maths.games.symmetry import check_symmetry

LOSSES = 3
"""Times that workers may be lost between two checkpoints."""


def marched(
    posed: Posed,
    progress: Progress | None = None,
    begin: Array | None = None,
    until: Until | None = None,
    h: Hamiltonian | None = None,
) -> ValueFunction:
    """The value at the end of the march, with what it is worth.

    begin: values at the nodes that it begins with, where they are less than those of the problem.
    h: the Hamiltonian of the problem, if it is known.
    """
    check_fits(posed)
    h = h or hamiltonian_of(posed)
    if posed.marching.symmetry is not None:
        check_symmetry(h, posed.problem.regions, posed.marching.symmetry)
    if posed.marching.on_disk is not None and not posed.filtered:
        check_disk(posed, h)  # of two marches before the first
    place, finer = workplace(posed.marching), on_finer_grid(posed)
    losses = 0
    while True:
        attempt = OneMarch(posed, h, progress, until, begun=begin is not None)
        try:
            with place.parts(finer, h) as parts:
                return attempt.result(DividedMarch(finer, parts, begin))
        except PartsLostError as lost:
            losses = 0 if attempt.got_further else losses + 1
            if losses == LOSSES:
                raise lost.error from None
