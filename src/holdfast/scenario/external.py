"""[law] external: another controller, a program that `holdfast run --controller` starts."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from holdfast.errors import ScenarioError
from holdfast.execution.arrays import Array
from holdfast.execution.simulation.closed_loop import Alive
from holdfast.host.program import TOGETHER, Programs
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.switching import Switching
from holdfast.maths.definitions.system import System
from holdfast.scenario.schema.values import Name, Section, Text


class ExternalSpec(Section):
    """[law] of another controller, which `holdfast run --controller` starts.

    external: true for the inputs of the system, or the names of what it commands.
    """

    external: Literal[True] | Annotated[list[Name], Field(min_length=1)]
    description: Text = ""


def commander_of(
    file: str, system: System, law: Law | Switching, controller: str
) -> Programmed | None:
    """The controller that hands the law its command; None for a law that needs none.

    controller: the command line that starts it. Raises `ScenarioError` where there is none.
    """
    if not law.handed:
        return None
    names = [q.name.removeprefix("command_") for q in law.handed]
    if not controller:
        raise ScenarioError(
            f"{file}: law: another controller commands {', '.join(names)}",
            remedy="give holdfast run --controller 'COMMAND', in Python with_controller('COMMAND')",
        )
    return Programmed(Programs(controller, system.state_names, names))


class Programmed:
    """Processes as the controller of many runs (`handed.Commander`)."""

    most = TOGETHER

    def __init__(self, programs: Programs) -> None:
        self.programs = programs
        self.begin, self.end = programs.begin, programs.end

    def command(self, t: float, states: Array, alive: Alive) -> Array:
        told = states[:, : len(self.programs.states)]  # not what the lag of actuators adds
        return np.array(self.programs.answers(t, told.tolist(), alive.tolist()))
