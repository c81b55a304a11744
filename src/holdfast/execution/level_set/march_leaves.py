"""The machine code of a march, as its sweep asks for it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from holdfast.execution.leaf import compiled_leaves, compiled_text
from holdfast.execution.level_set.rate_leaves import rate_leaves
from holdfast.execution.level_set.schemes import Scheme
from holdfast.execution.level_set.stage_leaf import stage_text
from holdfast.execution.level_set.stage_steps import Stage
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.games.hamiltonian import Hamiltonian

LIMITS = {"free": (-math.inf, math.inf), "shrink": (-math.inf, 0.0), "grow": (0.0, math.inf)}
"""The limits of dW/dt: none, never above zero, never below."""

Numbers = npt.NDArray[np.int64]


class MarchLeaves:
    """The leaves of a Hamiltonian with a scheme.

    limit: a name in `LIMITS`; one_stage: whether a step has one; filtered: whether the rate is held
    close to that of a monotone step (`stage_steps.py`).
    """

    def __init__(
        self,
        hamiltonian: Hamiltonian,
        parameters: Sequence[Parameter],
        scheme: Scheme,
        *,
        dissipation: str,
        limit: str,
        one_stage: bool,
        precision: str,
        filtered: bool,
    ) -> None:
        self._rates = rate_leaves(
            hamiltonian,
            parameters,
            dissipation=dissipation,
            filtered=filtered,
            one_slope=scheme.one_slope,
            precision=precision,
        )
        self._scheme, self._limit, self._one_stage = scheme, limit, one_stage
        self._precision, self._filtered = precision, filtered
        self._axes = len(hamiltonian.costates)

    @property
    def of_row(self) -> int:
        """How many numbers depend on a row of the last axis, or on outer axes."""
        return self._rates.of_row + self._rates.outer

    def stage(self, *, lower: bool, upper: bool) -> Stage:
        """The arithmetic of a stage; lower, upper: whether there are such bounds at nodes."""
        return Stage(
            self._rates,
            axes=self._axes,
            one_slope=self._scheme.one_slope,
            filtered=self._filtered,
            limits=LIMITS[self._limit],
            side=1.0 if self._limit == "shrink" else -1.0,
            from_start=self._one_stage,
            lower=lower,
            upper=upper,
        )

    def found(self, *, lower: bool, upper: bool) -> tuple[Numbers, Numbers, Numbers]:
        """The addresses of leaves, with a stage and one that measures; the sizes of a sweep."""
        stage, scheme = self.stage(lower=lower, upper=upper), self._scheme
        of_scheme = {}
        if not scheme.one_slope:
            of_scheme["scheme"] = scheme.leaf(self._precision, plain=stage.filtered)
        self._leaves = compiled_leaves({**self._rates.leaves, **of_scheme})  # they hold the code
        self._stage, of = compiled_text(stage_text(stage)), self._leaves.addresses
        plain, measured = (
            np.array([of["along"], of["rows"], self._stage.address(name), of.get("scheme", 0)])
            for name in ("holdfast_stage", "holdfast_measured")
        )
        rates = self._rates
        of_nodes = [rates.along, rates.of_row, rates.outer]
        sizes = [*of_nodes, scheme.ghosts, stage.lanes, int(stage.filtered)]
        return plain, measured, np.array(sizes)
