"""Schema of a scenario file for a viability kernel, a reachable set or a reach-avoid set."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import ConfigDict, Field

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
CERTIFIED = ("viability-kernel", "discriminating-kernel", "capture-basin")


class KernelHeader(Section):
    """[scenario]"""

    title: Text
    kind: Kind
    description: Text = ""
    source: Text = ""


class GridSpec(Section):
    """[grid]: box of the states, nodes along all axes or each, boundary conditions (`ends`)."""

    box: dict[Name, Interval]
    nodes: int | dict[Name, int]
    ends: dict[Name, str] = Field(default_factory=dict)


class MarchSpec(Section):
    """[march]: the horizon and the solver options, the keys of `Marching` and of a problem.

    times: those at which the value is stored, or their number, equally spaced from 0 to the
    horizon. forever: request the infinite-horizon kernel; a march that has not converged at the
    horizon is then not an answer. inner: the set shrunk by the estimated error of a coarser grid.
    """

    model_config = ConfigDict(extra="allow", strict=True, frozen=True)

    horizon: Value
    times: int | list[Value] | None = None
    arrival_steps: Annotated[int, Field(ge=0)] | None = None
    disturbances: Literal["min", "max"] | None = None
    forever: bool = False
    inner: bool = False


class DecomposeSpec(Section):
    """[decompose]: the problem is taken apart (`hf.decompose`), and every part has its own grid.

    cut: states that disturb the others, with their intervals or "kept" for the one that the region
    asks for or that they never leave. lag_share: of the range of actuators that lag.
    """

    cut: dict[Name, Interval | Literal["kept"]] = Field(default_factory=dict)
    lag_share: float | None = None


class PromiseSpec(Section):
    """[promise]: closed-loop (Monte Carlo) validation from random states; see `check_promise`.

    runs: 0 leaves it out; a kernel without the table is tried for about a second.
    """

    runs: Annotated[int, Field(ge=0)] = 1000
    margin: Value | None = None
    horizon: Value | None = None
    sample_time: Value = 0.02
    rate: float | None = None
    seed: int = 0


class CertificateSpec(Section):
    """[certificate]: what `holdfast certify` asks where its options do not; see `hf.certify`.

    Times with units of time, `uncertain` in the units of the parameters, `errors` of the states.
    """

    renamed: ClassVar[Renamed] = {"refine": ("halvings", {})}

    sample_time: Value | None = None
    cells: int | dict[Name, int] | None = None
    inputs: int | dict[Name, int] | None = None
    horizon: Value | None = None
    uncertain: dict[Name, Interval] | None = None
    errors: dict[Name, Value] | None = None
    delay: Value | None = None
    halvings: Annotated[int, Field(ge=0)] | None = None


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
