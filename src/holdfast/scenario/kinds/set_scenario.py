"""What scenarios that ask for a set of states share, on one grid or put together from parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.region import Region
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.scenario.kinds.base import Composed
from holdfast.scenario.schema.kernel import SetFiguresSpec


@dataclass(frozen=True)
class SetScenario(Composed):
    """A composed scenario whose answer is a set of states.

    options: of the march. promised: of the trials in closed loop, by 0 runs left out; None: a
    kernel is tried by default. certificate: arguments of `hf.certify` that the file has.
    held: of a figure, the values of the states that are not drawn.
    """

    name: str
    file: str
    text: str
    title: str
    kind: str
    description: str
    source: str
    system: System
    region: Region | None
    goal: Region | None
    origin: Region | None
    law: Law | Switching | None
    horizon: float
    forever: bool
    inner: bool
    options: Mapping[str, Any]
    promised: Mapping[str, Any] | None
    certificate: Mapping[str, Any]
    figures: SetFiguresSpec
    held: Mapping[str, float]

    @property
    def by_default(self) -> bool:
        """Whether its promise is tried although the file does not ask for it."""
        return self.promised is None and self.kind in ("viability-kernel", "discriminating-kernel")

    @property
    def trials(self) -> Mapping[str, Any] | None:
        """The trials that the file asks for."""
        return self.promised if self.promised and self.promised["runs"] else None

    @property
    def about(self) -> Region:
        """The value function that the march begins with."""
        found = self.goal or self.origin or self.region
        assert found is not None
        return found

    def trouble(self, answer: Any) -> str:
        trouble: str = answer.trouble
        return trouble

    def on_device(self, device: str) -> Self:
        return replace(self, options={**self.options, "device": device})

    def marched_on(self, *, cluster: Any = None, on_disk: Path | None = None) -> Self:
        given = {"cluster": cluster, "on_disk": on_disk}
        found = {k: v for k, v in given.items() if v is not None}
        return replace(self, options={**self.options, **found})

    @property
    def uses_all_cores(self) -> bool:
        return True

    @property
    def seed(self) -> int:
        return int((self.promised or {}).get("seed", 0))

    @property
    def given(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.options.get("disturbance", {})
        return found
