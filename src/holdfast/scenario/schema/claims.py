"""Schema of a file of claims (Pydantic)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from holdfast.scenario.schema.values import Section, Text

Verdict = Literal["holds", "holds with a condition", "does not hold"]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]


class TrialSpec(Section):
    """A run or a function call, and the number that decides about a claim.

    scenario, with `set` and `runs` as on the command line, or function, a name in `holdfast`, with
    arguments. number: its place in the summary or in the function's result: names joined by dots,
    or two of them with " / " between. The claim holds if the number is within `needs`, ends
    included. recorded: the recorded number, and `within` its tolerance. refused: words of the
    expected error message, if holdfast refuses to run the trial: the claim then does not hold.
    """

    says: Text = ""
    scenario: Text | None = None
    set: list[Text] = Field(default_factory=list)
    runs: int | None = None
    function: Text | None = None
    arguments: dict[Text, Any] = Field(default_factory=dict)
    number: str = ""
    unit: Text = "1"
    needs: Range
    recorded: float = 0.0
    refused: Text = ""
    within: Annotated[float, Field(ge=0)] = 0.0

    @model_validator(mode="after")
    def _one_of_two(self) -> TrialSpec:
        if (self.scenario is None) == (self.function is None):
            raise ValueError("either a scenario or a function")
        if self.function is not None and (self.set or self.runs is not None):
            raise ValueError("a function has arguments, no set and no runs")
        return self


class ClaimSpec(Section):
    """A sentence of the thesis, its verdict, and the trials that decide it.

    stated: as in the thesis; conditioned: under the condition that makes it hold.
    """

    name: Text
    where: Text
    figure: Text = ""
    says: Text
    verdict: Verdict
    condition: Text = ""
    quick: bool = False
    stated: TrialSpec
    conditioned: TrialSpec | None = None

    @model_validator(mode="after")
    def _condition_is_said(self) -> ClaimSpec:
        if (self.conditioned is None) != (not self.condition):
            raise ValueError("condition and conditioned belong together")
        return self


class ChapterSpec(Section):
    """One file: a chapter."""

    title: Text
    claims: Annotated[list[ClaimSpec], Field(min_length=1)]
