"""[varied.draws]: the random draws of every run, as parameters with ranges."""

from __future__ import annotations

from holdfast.errors import ScenarioError
from holdfast.maths.definitions.quantity import Parameter
from holdfast.maths.definitions.system import System
from holdfast.maths.definitions.units import check_unit, to_si
from holdfast.scenario.build.composer import Composer
from holdfast.scenario.schema.closed_loop import VariedSpec
from holdfast.scenario.validation import at


def drawn_names(composer: Composer, system: System, spec: VariedSpec) -> dict[str, Parameter]:
    """The drawn names as parameters, for laws and goals whose expressions use them."""
    moving = {q.name for q in (*system.states, *system.inputs, *system.disturbances)}
    found = {}
    for name, draw in spec.ranges.items():
        with at(composer.file, f"varied.draws.{name}"):
            if name in moving:
                raise ScenarioError(
                    f"'{name}' is a state, an input or a disturbance", expected="a parameter"
                )
            check_unit(draw.unit or "1")
            found[name] = Parameter(name, draw.unit or "1", "drawn for every run", value=0.0)
    return found


def drawn_ranges(composer: Composer, spec: VariedSpec) -> dict[str, tuple[float, float]]:
    """The ranges in SI units; names that are not yet declared are declared."""
    ranges = {}
    for name, draw in spec.ranges.items():
        with at(composer.file, f"varied.draws.{name}"):
            unit = composer.known.get(name, composer.drawn[name]).unit
            if draw.unit is not None and draw.unit != unit:
                raise ScenarioError(f"'{name}' has the unit {unit}", expected=f"unit = '{unit}'")
            low, high = draw.range
            ranges[name] = (to_si(low, unit), to_si(high, unit))
            composer.declare((composer.drawn[name],))
    return ranges
