"""The interface of a kind of scenario: it composes its tables, runs, writes and judges."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.errors import ScenarioError
from holdfast.host.files import make_folder, saved, write_summary
from holdfast.maths.definitions.value import Printed, unchanging

if TYPE_CHECKING:
    from holdfast.analysis.online.safety_filter import SafetyFilter
    from holdfast.analysis.simulation.law_comparison import Entry
    from holdfast.execution.resources import Progress

Bar = Callable[[str], AbstractContextManager[Callable[[str, float], None]]]
"""A bar on the screen, by what is worked on first."""


FILTERED = "closed loops with [law] external = true, and a [safeguard] or [safety]"


class Composed(Printed, ABC):
    """A scenario whose tables are checked and composed; `answer` is what its `run` returns."""

    name: str
    file: str
    text: str
    title: str
    kind: str
    remark: str | None = None
    """What is known before the run and answers the question; None: nobody asked."""

    def __post_init__(self) -> None:
        """Its tables do not change."""
        for f in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, f.name, unchanging(getattr(self, f.name)))

    def _lines(self) -> tuple[str, list[str], list[str]]:
        parts = [
            f"{f.name}: {repr(part).splitlines()[0]}"
            for f in fields(self)  # type: ignore[arg-type]
            if isinstance(part := getattr(self, f.name), Printed)
        ]
        return f"Scenario '{self.name}' ({self.kind}): {self.title}", parts, []

    @abstractmethod
    def run(self, progress: Progress | None = None) -> Any:
        """The answer."""

    def write(
        self, answer: Any, folder: Path, *, figures: bool = True, bar: Bar | None = None
    ) -> list[Path]:
        """The files of the answer, in a folder that is made."""
        make_folder(folder)
        files = [saved(answer, folder / "result.nc")]
        if figures:
            files += self.drawn(answer, folder, bar)
        return [*files, write_summary(folder / "summary.json", answer.summary())]

    def drawn(self, answer: Any, folder: Path, bar: Bar | None) -> list[Path]:
        """The figures of the answer, in a folder that is there."""
        return []

    @abstractmethod
    def report(self, answer: Any, files: Sequence[Path]) -> str:
        """The answer on the screen."""

    def beforehand(self) -> Composed:
        """The same, with what can be said at once, before anything is simulated, as `remark`."""
        return self

    def complaints(self, answer: Any) -> list[str]:
        """Reasons why the answer is negative or incomplete: exit status 1."""
        return []

    def trouble(self, answer: Any) -> str:
        """The reasons why the answer is incomplete; empty if it is complete."""
        return ""

    def interactive(self, answer: Any) -> dict[str, Any] | None:
        """A figure for a browser, if there is one."""
        return None

    def with_controller(self, line: str) -> Composed:
        """The same with the controller that this command line starts.

        Raises `ScenarioError` for a scenario that no other controller commands.
        """
        raise ScenarioError(
            f"{self.file}: no other controller commands this scenario",
            expected="closed loops with [law] external = true",
        )

    def on_device(self, device: str) -> Composed:
        """The same on a device of `DEVICES`.

        Raises `ScenarioError` for a scenario that no other device than the processor computes.
        """
        raise ScenarioError(
            f"{self.file}: this kind of scenario has no program for the device {device!r}",
            expected="closed loops, kernels, reachable sets or basins",
            remedy="leave out --device",
        )

    def marched_on(self, *, cluster: Any = None, on_disk: Path | None = None) -> Composed:
        """The same with its march on a cluster, or from a disk.

        Raises `ScenarioError` for a scenario that marches nothing.
        """
        raise ScenarioError(
            f"{self.file}: nothing is marched over a grid", expected="a kernel, a tube or a basin"
        )

    def safety_filter(self, progress: Progress | None = None) -> SafetyFilter:
        """The filter that this scenario puts around the command of another controller.

        It decides as in its runs, sample by sample. Raises `ScenarioError` for a scenario that has
        no such filter.
        """
        raise ScenarioError(
            f"{self.file}: it has no filter around another controller", expected=FILTERED
        )

    # -- campaigns

    @property
    def independent_runs(self) -> int:
        """The number of runs that a sweep may divide among processes; 0: it cannot be divided."""
        return 0

    @property
    def uses_all_cores(self) -> bool:
        """Whether one scenario keeps all cores busy."""
        return False

    @property
    def seed(self) -> int:
        """The seed of its random numbers."""
        return 0

    @abstractmethod
    def tally(self, part: range | None, threads: int) -> dict[str, Entry]:
        """The row of a sweep's table for a run, or for these of its runs."""

    # -- a current that is given

    @property
    @abstractmethod
    def given(self) -> Mapping[str, Any]:
        """Disturbances that are given, as numbers or expressions."""


@dataclass(frozen=True)
class Kind:
    """name: the word of [scenario] kind. compose: of (file, text, tables, runs, seed)."""

    name: str
    compose: Callable[[str, str, dict[str, Any], int | None, int | None], Composed]
