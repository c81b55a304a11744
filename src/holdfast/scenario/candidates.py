"""The law of a scenario at other numbers of its table [law], without a scenario for each of them.

Each law is built as the scenario builds it, with all refusals. The closed loop is compiled once
for all, since the expressions are the same and only the parameters differ.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from holdfast.errors import ScenarioError
from holdfast.maths.definitions.law import GainCondition
from holdfast.maths.definitions.switching import Switching, as_switching
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.build.law_chain import composed_law
from holdfast.scenario.build.run import drawn_names
from holdfast.scenario.build.system import composed_system
from holdfast.scenario.files import overridden
from holdfast.scenario.schema.closed_loop import ScenarioSpec
from holdfast.scenario.validation import validated

PREFIX = "law."


class LawFamily:
    """The laws of the scenario of these tables at other numbers of [law]."""

    def __init__(self, file: str, data: dict[str, Any]) -> None:
        self.file, self.data = file, data
        spec = validated(ScenarioSpec, data, file)
        composer = Composer(file)
        self._system = composed_system(composer, spec.system)
        composer.drawn = drawn_names(composer, self._system, spec.varied)
        self._region = composer.region(spec.region, "region") if spec.region is not None else None
        self._composer = composer
        self._first = self._built(data)

    def at(self, settings: Iterable[str]) -> tuple[dict[str, float], tuple[GainCondition, ...]]:
        """The parameters by name, and the conditions, of the law with overrides law.KEY=VALUE.

        Raises what the law raises, and `ScenarioError` for a number that changes the law's
        expressions rather than a parameter.
        """
        law = self._built(overridden("", self.data, settings)[1])
        if _expressions(law) != _expressions(self._first):
            raise ScenarioError(
                f"{self.file}: {', '.join(settings)}: the expressions of the law change with it",
                expected="the key of a number that is a parameter of the law",
            )
        return {p.name: p.value for p in law.parameters}, law.conditions

    def _built(self, data: Mapping[str, Any]) -> Switching:
        spec = validated(ScenarioSpec, data, self.file).model_copy(update=_NO_MORE)
        own = copy.copy(self._composer)
        own.known, own.drawn = dict(own.known), dict(own.drawn)
        law, _ = composed_law(own, spec, self._system, self._region)
        return as_switching(law)


_NO_MORE: dict[str, None] = {"tracking": None, "safeguard": None, "observer": None}
"""Tables that change neither the conditions of a law nor its own parameters."""


def _expressions(law: Switching) -> tuple[object, ...]:
    modes = tuple((n, *mode.outputs.values()) for n, mode in law.modes.items())
    return (modes, law.transitions, tuple(law.signals.items()))
