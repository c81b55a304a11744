"""The leaves of a march: what its Hamiltonian and its dissipation ask of nodes, rows and axes.

Every part of the rate is computed as far out as possible (`codegen/loop_nest.py`):

| leaf | argument w | results |
|---|---|---|
| along | the nodes of the last axis | what depends on the last axis alone |
| rows | of each row the other axes | what depends on outer axes; what depends on the row's |
| rate | along, the row's, mean slopes, half gaps | dW/dtau before it is limited, ... |

Their argument u are numbers that are the same at all nodes: of the first two the time, the
parameters and the largest speed along each axis; of the last what the rows have of outer axes.
The rate is not called but is a part of the leaf of a stage (`stage_leaf.py`). The others of its
results are for a filtered scheme (`stage_steps.py`): the rate of a monotone step from the plain
differences (`maths/games/monotone_flux.py`), and the largest speeds at the node.
No product and sum of the rate are fused: where the slope on one side is zero, two equal products
are subtracted, and the sign of their difference decides which input is optimal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import sympy as sp

from holdfast.execution.arithmetic.steps import Steps, Value
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.loop_nest import BEFORE, Schedule
from holdfast.execution.codegen.lowering import is_algebraic, lowered
from holdfast.maths.definitions.quantity import TIME, Parameter
from holdfast.maths.games.hamiltonian import Hamiltonian
from holdfast.maths.games.monotone_flux import is_sharp, monotone_flux

DISSIPATIONS = ("global", "local", "local-local")

Statements = Sequence[tuple[sp.Symbol, sp.Expr]]


class RateLeaves(NamedTuple):
    """The leaves, and how many values they have: along the last axis, of a row, of outer axes."""

    leaves: dict[str, Leaf]
    rate: Leaf
    along: int
    of_row: int
    outer: int


def rate_leaves(
    hamiltonian: Hamiltonian,
    parameters: Sequence[Parameter],
    *,
    dissipation: str,
    filtered: bool,
    one_slope: bool = False,
    precision: str = "float64",
) -> RateLeaves:
    """The leaves of the Lax-Friedrichs scheme with this Hamiltonian.

    filtered: whether the rate of a monotone step and the speeds are wanted, too. one_slope: whether
    the slopes are plain differences. "local-local" uses that rate then, where it is sharp: the
    speeds of all slopes between those at a node wear a ridge on every grid, if a player acts on
    several axes.
    """
    n = len(hamiltonian.costates)
    gaps = [sp.Symbol(f"_g{i}", real=True) for i in range(n)]  # no user name begins so
    largest = [sp.Symbol(f"_a{i}", real=True) for i in range(n)]
    if dissipation == "global":
        speeds: Sequence[sp.Expr] = largest
    else:
        speeds = hamiltonian.speeds if dissipation == "local" else hamiltonian.tight_speeds
    total = hamiltonian.value + sum(
        (a * g for a, g in zip(speeds, gaps, strict=True)), start=sp.S.Zero
    )
    width = {s: sp.Abs(g) for s, g in zip(hamiltonian.spreads, gaps, strict=True)}
    scheme_rate = total.xreplace(width)
    if one_slope and dissipation == "local-local" and is_sharp(hamiltonian):
        scheme_rate = monotone_flux(hamiltonian, gaps, over_points=False)
    totals = [scheme_rate]
    if filtered:
        totals += [monotone_flux(hamiltonian, gaps), *hamiltonian.speeds]
    slopes = [*hamiltonian.costates, *gaps]
    axes = [q.symbol for q in hamiltonian.system.states]
    plan = Schedule(axes, frozenset(slopes))
    results = plan.add(totals)
    at_node = plan.levels.get(n, [])
    outside = [x for level in range(BEFORE, n - 1) for x in plan.levels.get(level, [])]
    asked = set().union(*(e.free_symbols for e in [*(e for _, e in at_node), *results]))
    asked -= {s for s, _ in at_node} | set(slopes)
    order = sorted(asked, key=str)
    tables = {axes[-1], *(s for s, _ in plan.tables)}
    row = {s for s, _ in plan.levels.get(n - 2, [])} | {axes[n - 2]} if n > 1 else set()
    along = [s for s in order if s in tables]
    of_row = [s for s in order if s in row]
    outer = [s for s in order if s not in tables | row]
    same = [TIME, *(q.symbol for q in parameters), *largest]
    before = plan.levels.get(BEFORE, [])
    algebraic = is_algebraic([*results, *(e for _, e in at_node)])
    leaves = {
        "along": _leaf(axes[-1:], same, [*before, *plan.tables], along),
        "rows": _leaf(axes[:-1], same, outside, [*outer, *of_row]),
    }
    of_node = _leaf(
        [*along, *of_row, *slopes], outer, at_node, results,
        single=precision == "float32", algebraic=algebraic,
    )  # fmt: skip
    return RateLeaves(leaves, of_node, len(along), len(of_row), len(outer))


def _leaf(
    rows: Sequence[sp.Symbol],
    same: Sequence[sp.Symbol],
    statements: Statements,
    results: Sequence[sp.Expr],
    *,
    single: bool = False,
    algebraic: bool = False,
) -> Leaf:
    """The leaf of statements that follow one another; w are the rows, u what is the same."""
    steps = Steps(expanded=True)
    names = {"w": [f"w{i}" for i in range(len(rows))], "u": [f"u{i}" for i in range(len(same))]}
    known: dict[sp.Symbol, Value] = {}
    for name, symbol in [*zip(names["w"], rows, strict=True), *zip(names["u"], same, strict=True)]:
        known[symbol] = steps.input(name)
    for symbol, expression in statements:
        (known[symbol],) = lowered(steps, [expression], known)
    found = lowered(steps, results, known)
    return Leaf(steps, names, found, frozenset({"u"}), single=single, algebraic=algebraic)
