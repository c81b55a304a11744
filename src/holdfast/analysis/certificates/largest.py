"""The largest number for which a certificate is found, and what other numbers would certify."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.reachability.solve import Answer, close, first_lost, last_held


@dataclass(frozen=True)
class CertifiedTrial:
    """What is certified with one value: so many of the cells in the region."""

    value: float
    answer: Answer
    certified: int
    inside: int
    wall_time: float

    @property
    def share(self) -> float:
        """Of the cells that lie in the region."""
        return self.certified / self.inside if self.inside else 0.0

    def summary(self) -> dict[str, Any]:
        """Plain data."""
        return {**self.__dict__, "answer": self.answer.name.lower(), "share": self.share}


@dataclass(frozen=True)
class LargestCertified:
    """The trials of a search in ascending order, and the certificate of the largest that holds.

    share: of the cells in the region that has to be certified; 0 asks for one cell. widens: whether
    a larger value only widens what disturbances or parameters may be: then the certificate holds
    for every smaller value as well. A value that is not certified may be harmless in truth: other
    cells, inputs and coordinates may certify it.
    """

    title: str
    scenario: str
    key: str
    name: str
    unit: str
    share: float
    widens: bool
    tolerance: float
    trials: tuple[CertifiedTrial, ...]
    found: Certificate | None

    @property
    def low(self) -> float | None:
        """The largest tried value such that it and all smaller tried ones are certified."""
        return last_held(self.trials)

    @property
    def high(self) -> float | None:
        """The least tried value above `low` that is not."""
        return first_lost(self.trials, self.low)

    @property
    def answered(self) -> bool:
        """Whether both are within the tolerance."""
        low, high = self.low, self.high
        return low is not None and high is not None and close(low, high, self.tolerance)

    def summary(self) -> dict[str, Any]:
        """The content of largest.json."""
        fields = (
            "title", "scenario", "key", "name", "unit", "share", "widens", "tolerance", "low",
            "high", "answered",
        )  # fmt: skip
        return {
            **{n: getattr(self, n) for n in fields},
            "trials": [t.summary() for t in self.trials],
            "certificate": None if self.found is None else self.found.summary(),
        }


@dataclass(frozen=True)
class Change:
    """One number changed alone.

    option: of the command. share: that is certified with it, `before`: without it, on as many
    `cells`; none where these are those of the option, or those that were asked for.
    """

    option: str
    share: float
    before: float
    cells: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Advice:
    """tried: the options of all trials that ran. changes: the best of sample times, of cells and
    of inputs, where they gain, the best one first."""

    tried: tuple[str, ...]
    changes: tuple[Change, ...]
