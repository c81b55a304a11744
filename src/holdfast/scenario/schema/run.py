"""[run] of a scenario of closed loops or of a formation (Pydantic)."""

from __future__ import annotations

from typing import ClassVar

from holdfast.scenario.schema.values import Renamed, Section, Value


class RunSpec(Section):
    """[run]: the settings of the simulation."""

    renamed: ClassVar[Renamed] = {"control": ("continuous", {"continuous": True, "sampled": False})}

    horizon: Value
    sample_time: Value = 0.02
    substeps: int = 2
    record_every: Value = 0.1
    continuous: bool = False
    stepper: str = "rk4"
    absolute: float = 1e-9
    relative: float = 1e-9
    tolerance: float = 0.0
    switch_limit: int = 10
    delay: Value = 0.0
    until_goal: bool = False
    device: str = "cpu"
    seed: int = 0
