"""Schema of a scenario file for a viability kernel, a reachable set or a reach-avoid set."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import AfterValidator, Field

from holdfast.analysis.decomposition.decompose import decompose
from holdfast.analysis.reachability import solve
from holdfast.analysis.reachability.grid import grid
from holdfast.analysis.reachability.value_function import CertifyOptions, ValueFunction
from holdfast.analysis.safety.validation import check_promise
from holdfast.scenario.schema.values import (
    Expression,
    Interval,
    Name,
    Plane,
    Renamed,
    Section,
    Text,
    Value,
)

Kind = Literal[
    "viability-kernel",
    "discriminating-kernel",
    "invariance-kernel",
    "backward-reachable-tube",
    "backward-reachable-at",
    "forward-reachable-set",
    "capture-basin",
]
PROBLEMS: tuple[str, ...] = get_args(Kind)
ASKED: dict[str, Callable[..., ValueFunction]] = {
    kind: getattr(solve, kind.replace("-", "_")) for kind in PROBLEMS
}
"""What is asked of each kind."""
CERTIFIED = ("viability-kernel", "discriminating-kernel", "capture-basin")


class KernelHeader(Section):
    """[scenario]"""

    title: Text
    kind: Kind
    description: Text = ""
    source: Text = ""


class GridSpec(Section, of=[grid]):
    """[grid]: box of the states, nodes along all axes or each, boundary conditions (`ends`)."""

    box: dict[Name, Interval]


ELSEWHERE = (
    "disturbance",  # a table of its own
    "parameters",  # each in the table that it is of
)
"""Arguments of a problem that files do not say in [march]."""


class MarchSpec(Section, of=[*ASKED.values()], without=ELSEWHERE):
    """[march]: the horizon and the options of the problem.

    times: those at which the value is stored, or their number, equally spaced from 0 to the
    horizon. forever: request the infinite-horizon kernel; a march that has not converged at the
    horizon is then not an answer. inner: the set shrunk by the estimated error of a coarser grid.
    """

    times: int | list[Value] | None = None
    forever: bool = False
    inner: bool = False


Whole = Annotated[Literal["kept"], AfterValidator(lambda _: None)]
"""The interval that the region asks for, or that a state never leaves: None in Python."""


class DecomposeSpec(
    Section, of=[decompose], without=["kind", "disturbances", "disturbance", "box"]
):
    """[decompose]: the problem is taken apart (`hf.decompose`), and every part has its own grid.

    cut: states that disturb the others, with their intervals or "kept" for the one that the region
    asks for or that they never leave. lag_share: of the range of actuators that lag.
    """

    cut: dict[Name, Interval | Whole] = Field(default_factory=dict)


class PromiseSpec(Section, of=[check_promise]):
    """[promise]: closed-loop (Monte Carlo) validation from random states; see `check_promise`.

    runs: 0 leaves it out; a kernel without the table is tried for about a second.
    """

    margin: Value | None = None


class CertificateSpec(
    Section, of=[CertifyOptions], without=["box", "disturbance", "steps", "store", "margin"]
):
    """[certificate]: what `holdfast certify` asks where its options do not; see `hf.certify`.

    The box is that of the grid, and a disturbance is in a table of its own.
    """

    renamed: ClassVar[Renamed] = {"refine": ("halvings", {})}


class SetFiguresSpec(Section):
    """[figures]: the plane, the values of the other states, the optimal inputs to draw in it."""

    plane: Plane | None = None
    at: dict[Name, Value] = Field(default_factory=dict)
    inputs: list[Name] = Field(default_factory=list)


class KernelSpec(Section):
    """A whole file; catalogue entries stay tables of { name, parameters }."""

    scenario: KernelHeader
    system: dict[str, Any]
    region: dict[str, Any] | None = None
    goal: dict[str, Any] | None = None
    origin: dict[str, Any] | None = None
    law: dict[str, Any] | None = None
    tracking: dict[Name, float] | None = None
    grid: GridSpec
    decompose: DecomposeSpec | None = None
    march: MarchSpec
    disturbance: dict[Name, Expression] = Field(default_factory=dict)
    promise: PromiseSpec | None = None
    certificate: CertificateSpec | None = None
    figures: SetFiguresSpec = SetFiguresSpec()
