"""The gains of a scenario's law that may be chosen, and the ranges they are searched in."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from holdfast.errors import ScenarioError
from holdfast.maths.catalogue import laws
from holdfast.maths.catalogue.signature import arguments, leading_argument
from holdfast.maths.nonholonomic.chained_feedback import POLE
from holdfast.scenario.candidates import PREFIX
from holdfast.scenario.kinds.closed_loop import Scenario
from holdfast.studies.scenario_parameter import Knob, find_knob, last_part
from holdfast.studies.sweep.table import Axis, Over, read_over

FACTOR = 4.0
"""The default range of a gain is from its own value divided by this to its value times this."""

RANGE = "KEY=LOW:HIGH, a gain and its range"

DIGITS = 4
"""Significant digits of a chosen gain."""

LISTS = ("poles", "gains")
"""Arguments of a law that hold several gains, or one for all."""


@dataclass(frozen=True)
class Gain:
    """A gain with its key, its value in the scenario, and its range in the unit of the range."""

    axis: Axis
    own: float

    @property
    def key(self) -> str:
        return self.axis.knob.key

    @property
    def unit(self) -> str:
        return self.axis.over.unit or self.axis.knob.unit

    def at(self, share: float) -> float:
        """The value at that share of the range, 0 to 1, to `DIGITS` digits."""
        low, high = self.axis.over.values
        value = low * (high / low) ** share if low * high > 0 else low + share * (high - low)
        return float(f"{value:.{DIGITS}g}")

    def share(self, value: float) -> float:
        """The inverse of `at`, before rounding; outside [0, 1] for a value out of the range."""
        low, high = self.axis.over.values
        if low * high > 0:
            return math.log(value / low) / math.log(high / low) if value * low > 0 else math.nan
        return (value - low) / (high - low)

    def settings(self, value: float) -> tuple[str, ...]:
        """The overrides KEY=VALUE."""
        return self.axis.settings(value)


def gains_of(own: Scenario, data: Mapping[str, Any], asked: Iterable[str]) -> list[Gain]:
    """The gains that are asked for, "k1=0.05:0.5" or "k1" alone, or all of the law's.

    Raises `ScenarioError` for a law without gains, a key that is none of [law], and a gain that is
    no number.
    """
    texts = list(asked) or _all(own, data)
    if not texts:
        raise ScenarioError(
            f"{own.file}: the law '{data['law'].get('name', own.law.name)}' names no gains",
            remedy="name numbers of [law] with --gain KEY=LOW:HIGH",
        )
    found = [_gain(own, data, text) for text in texts]
    keys = [gain.key for gain in found]
    for key in keys:
        if keys.count(key) > 1:
            raise ScenarioError(f"--gain {key}: occurs twice")
    return found


def _all(own: Scenario, data: Mapping[str, Any]) -> list[str]:
    table = data["law"]
    function = next((f for f in laws.ALL if f.__name__ == table.get("name")), None)
    flagged = {p.name for p in own.law.parameters if p.gain}
    if function is None:
        return [n for n in table.get("parameters", {}) if n in flagged]
    leading = int(leading_argument(function) == "system")
    structural, numeric = arguments(function, leading)
    names = [f"{PREFIX}{n}" for n in numeric if n in flagged]
    for name in LISTS:
        given = table.get(name)
        if isinstance(given, list):
            places = [i for i, v in enumerate(given) if isinstance(v, int | float)]
            names += [f"{PREFIX}{name}.{i}" for i in places]
    if "poles" in structural and not isinstance(table.get("poles"), list) and "gains" not in table:
        names.append(f"{PREFIX}poles")
    return names


def _gain(own: Scenario, data: Mapping[str, Any], text: str) -> Gain:
    name = text.partition("=")[0].strip()
    knob = _knob(own, data, name)
    if not knob.key.startswith(PREFIX):
        raise ScenarioError(f"--gain {name}: the key is {knob.key}", expected="a number of [law]")
    if knob.own is None:  # the file leaves the law's own value
        mine = [p.value for p in own.law.parameters if p.name == last_part(knob.key)]
        knob = replace(knob, own=mine[0] if mine else None)
    if knob.own is None or not math.isfinite(knob.own):
        raise ScenarioError(f"--gain {name}: {knob.key} is not a number")
    if "=" in text:
        over = read_over(text, latin=True, option="--gain", expected=RANGE)
    else:
        over = _around(own, knob, knob.own)
    return Gain(Axis(knob.key, knob, over), knob.own)


def _knob(own: Scenario, data: Mapping[str, Any], name: str) -> Knob:
    if name in ("poles", f"{PREFIX}poles") and "poles" not in data["law"]:
        key = f"{PREFIX}poles"
        return Knob(key, "poles", "1/s", POLE, lambda value: (f"{key}={value}",))
    return find_knob(own, data, name)


def _around(own: Scenario, knob: Knob, value: float) -> Over:
    """From a quarter to four times the value, counted from the parameter's lower limit."""
    name = last_part(knob.key)
    least: Sequence[float] = [p.above for p in own.law.parameters if p.name == name]
    floor = least[0] if least and math.isfinite(least[0]) else 0.0
    if value == floor:
        raise ScenarioError(
            f"--gain {name}: its value is {value:g}, around which there is no range",
            expected=f"--gain {name}=LOW:HIGH",
        )
    ends = [floor + (value - floor) / FACTOR, floor + (value - floor) * FACTOR]
    return Over(knob.key, tuple(sorted(ends)), "", True)
