"""The problem, the march and its error estimates as one record: the attributes of a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from holdfast.execution.level_set.march import METHODS

FORWARD, INNER = "forward-reachable-set", "inner approximation"


@dataclass(frozen=True)
class Report:
    """The problem of a value function, the march that solved it, and its error estimates.

    kind, region, system, disturbances: the problem; definition: a digest of the system; value_unit:
    of V. parameters, disturbance: the numbers, or expressions of t, of the problem. horizon_s: as
    requested; reached_s: as marched; start_time_s: the time t at the beginning of the problem.
    depends_on_time: whether its rates or regions do. converged: the set is that of every longer
    horizon too. empty: no node is in the set. ended_early: the caller's condition ended the march.
    begun_from_another: the march was a warm start. tolerance_cells: the requested, residual_cells:
    the remaining movement of the boundary. ends_reached: the axes at whose ends the set is cut off.
    cell: the largest change of V over a cell. memory_bytes: the estimate for the march.
    computed_share: the share of the node updates that were computed and not skipped. refine: how
    many times shorter the cells near the boundary are, marched_share: the mean share of the nodes
    of this finer grid that were in blocks around it; None without `refine`.

    filtered_share: how many nodes the second of two marches took from a set that is to be kept, or
    added to one that is to be reached, as a share of them; None where there was one march
    (`one_march.py`). disputed_share: of a set that is to be reached against a disturbance, the
    share of its nodes that are disputed (`one_march.disputed`); None where no scheme of high order
    went beside.

    The following are None, or empty, unless requested. error_order, error_largest, error_rms,
    error_cells, volume_coarse: see `solve.with_error`. error_reach: cells by which the
    boundary may be off and `inner` erodes the set, boundary_error: the same along every axis, in
    its unit, jumps: whether V jumps there (`value_function.with_error_in_cells`); inner_cells: by
    which a set was eroded. nodes_from_outside, share_from_outside, nodes_kept_outside: see
    `solve.with_outside`. promise_outcome, promise_conclusion: of the closed-loop
    validation that was tried last (`ValueFunction.tried`); promise_share: of the set, from the
    inside out, that lost no start. title, scenario, scenario_text: of the scenario.
    """

    kind: str = ""
    region: str = ""
    value_unit: str = "1"
    holdfast_version: str = ""
    system: str = ""
    disturbances: str = ""
    horizon_s: float = 0.0
    reached_s: float = 0.0
    start_time_s: float = 0.0
    depends_on_time: bool = False
    converged: bool = False
    empty: bool = False
    ended_early: bool = False
    begun_from_another: bool = False
    tolerance_cells: float | None = None
    residual_cells: float | None = None
    ends_reached: str = ""
    cell: float = 0.0
    scheme: str = ""
    order: int = 0
    dissipation: str = ""
    cfl: float = 0.0
    precision: str = ""
    samples: int = 0
    separable: bool = False
    steps: int = 0
    memory_bytes: int = 0
    computed_share: float = 0.0
    wall_time_s: float = 0.0
    refine: int | None = None
    marched_share: float | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    disturbance: Mapping[str, float | str] = field(default_factory=dict)
    definition: str = ""
    filtered_share: float | None = None
    disputed_share: float | None = None
    error_order: float | None = None
    error_largest: float | None = None
    error_rms: float | None = None
    error_cells: float | None = None
    volume_coarse: float | None = None
    error_reach: int | None = None
    jumps: bool = False
    boundary_error: Mapping[str, float] = field(default_factory=dict)
    inner_cells: int | None = None
    nodes_from_outside: int | None = None
    share_from_outside: float | None = None
    nodes_kept_outside: int | None = None
    promise_outcome: str | None = None
    promise_conclusion: str | None = None
    promise_share: float | None = None
    title: str | None = None
    scenario: str | None = None
    scenario_text: str | None = None

    @property
    def euler_step(self) -> float:
        """The length of an Euler step of the march [s], in which no state crosses a cell."""
        method = METHODS.get(self.order)
        return self.reached_s / max(self.steps * (method.lengths if method else 1), 1)

    @property
    def approximation(self) -> str:
        """What the set is of the exact one, where a word for it is due; an empty text elsewhere.

        The scheme smears what is thin, so that a forward reachable set leaves out states that can
        be reached: fewer the finer the grid is.
        """
        return INNER if self.kind == FORWARD else ""

    def told(self) -> dict[str, Any]:
        """What a summary says in words and tables."""
        word = {"approximation": self.approximation} if self.approximation else {}
        return {"boundary_error": dict(self.boundary_error) or None, **word}

    def attributes(self) -> dict[str, Any]:
        """The attributes of a dataset: numbers and text, tables as JSON, without None."""
        return {n: _written(v) for n, v in asdict(self).items() if v is not None}

    @staticmethod
    def names() -> frozenset[str]:
        """The names of the entries, which are those of the attributes."""
        return frozenset(_DEFAULTS)

    @classmethod
    def read(cls, attributes: Mapping[Any, Any]) -> Report:
        """The record of these attributes; others are ignored, and missing ones have defaults."""
        entries = {n: attributes[n] for n in _DEFAULTS if n in attributes}
        return cls(**{n: _read(v, _DEFAULTS[n]) for n, v in entries.items()})


_DEFAULTS: dict[str, Any] = asdict(Report())


def _written(value: Any) -> Any:
    if isinstance(value, Mapping):
        return json.dumps(value)
    return int(value) if isinstance(value, bool | np.bool_) else value


def _read(value: Any, default: Any) -> Any:
    if isinstance(default, Mapping):
        return json.loads(value)
    if isinstance(default, bool):
        return bool(value)
    if isinstance(value, str):
        return value
    return value.item() if hasattr(value, "item") else value
