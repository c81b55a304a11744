"""The program of a controller: measurements, memory and commands, printed by every target."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.law import Law, Safeguard
from holdfast.maths.definitions.lookup import Lookup
from holdfast.maths.definitions.measurement import by_measurements
from holdfast.maths.definitions.quantity import Parameter, Quantity, merge_parameters, symbol
from holdfast.maths.definitions.switching import Switching, as_switching, check_outputs
from holdfast.maths.definitions.system import System


@dataclass(frozen=True)
class ControllerProgram:
    """A law with its modes for a system: its arguments, its expressions, and their order.

    seen: the states, then the disturbances that the law measures, then what others hand it at
    every sample. remembered: its discrete-time state. parameters: those of the system and of the
    law, each once.
    """

    system: System
    switching: Switching
    measured: tuple[Quantity, ...]
    parameters: tuple[Parameter, ...]

    @property
    def seen(self) -> tuple[Quantity, ...]:
        return (*self.measurements, *self.handed)

    @property
    def measurements(self) -> tuple[Quantity, ...]:
        """The states and the measured disturbances."""
        return (*self.system.states, *self.measured)

    @property
    def handed(self) -> tuple[Quantity, ...]:
        return self.switching.handed

    @property
    def remembered(self) -> tuple[Quantity, ...]:
        return self.switching.memory.quantities if self.switching.memory else ()

    @property
    def inputs(self) -> list[sp.Symbol]:
        return [q.symbol for q in self.system.inputs]

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of the actuators: of the inputs where the system declares none."""
        return self.system.actuators or self.system.input_names

    @cached_property
    def modes(self) -> tuple[str, ...]:
        return tuple(self.switching.modes)

    @property
    def initial_mode(self) -> int:
        return self.modes.index(self.switching.initial)

    @cached_property
    def lookup(self) -> Lookup | None:
        return self.switching.lookup

    @property
    def safeguards(self) -> dict[str, Safeguard]:
        """The safety filter of every mode that has one."""
        return {n: law.safeguard for n, law in self.switching.modes.items() if law.safeguard}

    def commands(self, mode: str) -> list[sp.Expr]:
        """The outputs of a mode, in the order of the inputs."""
        outputs = self.switching.modes[mode].outputs
        return [outputs[name] for name in self.system.input_names]

    @property
    def transitions(self) -> dict[str, list[tuple[sp.Expr, int]]]:
        """Every mode that can be left: its guards with the numbers of their targets, in order."""
        found: dict[str, list[tuple[sp.Expr, int]]] = {name: [] for name in self.modes}
        for x in self.switching.transitions:
            found[x.source].append((x.when, self.modes.index(x.target)))
        return {name: leaving for name, leaving in found.items() if leaving}

    @property
    def initial_memory(self) -> list[sp.Expr]:
        memory = self.switching.memory
        return [memory.initial[q.name] for q in memory.quantities] if memory else []

    @property
    def next_memory(self) -> list[sp.Expr]:
        memory = self.switching.memory
        return [memory.following[q.name] for q in memory.quantities] if memory else []

    def actuation(self) -> list[sp.Expr]:
        """The limited values of the actuators at a command, as expressions of the inputs."""
        return self.system.limited(self.allocated())

    def allocated(self) -> list[sp.Expr]:
        """The actuator values that produce the inputs, before they are limited."""
        return self.system.allocated(self.inputs)

    def limited(self) -> list[sp.Expr]:
        """The admissible actuator values in place of the requested ones."""
        return self.system.limited(self.requested)

    def produced(self) -> list[sp.Expr]:
        """The inputs that the actuators produce."""
        return self.system.produced(self.requested)

    @property
    def requested(self) -> list[sp.Symbol]:
        """The actuators as symbols."""
        return [symbol(name) for name in self.actuators] if self.system.actuators else self.inputs

    @property
    def expressions(self) -> list[sp.Expr]:
        """Everything that is evaluated at a sample."""
        commands = [e for mode in self.modes for e in self.commands(mode)]
        filters = [e for safeguard in self.safeguards.values() for e in safeguard.expressions]
        guards = [t.when for t in self.switching.transitions]
        memory = [*self.initial_memory, *self.next_memory]
        actuation = [*self.actuation(), *(self.produced() if memory else ())]
        return [*commands, *filters, *guards, *memory, *actuation, *self.places]

    @property
    def places(self) -> tuple[sp.Expr, ...]:
        """The coordinates at which the law looks up its table."""
        return self.lookup.places if self.lookup else ()

    def check_function_of_state(self) -> None:
        """Refuse a law that depends on more than the state and time."""
        kind = (
            "has modes" if len(self.modes) > 1
            else "remembers" if self.remembered
            else "solves a quadratic program at every sample" if self.safeguards
            else "looks up a kernel" if self.lookup
            else "is handed quantities by others" if self.handed
            else ""
        )  # fmt: skip
        if kind:
            raise DefinitionError(
                f"law '{self.switching.name}' {kind}",
                expected="a law that is a function of the state and of t",
            )


def controller_program(system: System, law: Law | Switching) -> ControllerProgram:
    """The program of that law for that system; its measurements are replaced by expressions.

    Raises `DefinitionError` where the law does not give the inputs of the system, reads a quantity
    that the system does not have, or remembers one that it has.
    """
    switching = as_switching(by_measurements(system, law))
    check_outputs(system, switching)
    memory = switching.memory
    remembered = [q.name for q in memory.quantities] if memory else []
    for name in remembered:
        if name in (*system.state_names, *system.input_names, *system.disturbance_names):
            raise DefinitionError(
                f"'{name}' is both a quantity of system '{system.name}' and in the memory of the "
                "law",
                expected="different names",
            )
    for q in switching.handed:
        if q.name in (*system.state_names, *system.disturbance_names, *remembered):
            raise DefinitionError(
                f"'{q.name}' is handed to law '{switching.name}' and a quantity of system "
                f"'{system.name}'",
                expected="different names",
            )
    reads = [q.name for q in (*switching.reads, *(memory.reads if memory else ()))]
    for name in reads:
        if name not in (*system.state_names, *system.disturbance_names, *remembered):
            raise DefinitionError(
                f"law '{switching.name}' reads '{name}', which is neither a state nor a "
                f"disturbance of system '{system.name}'",
                remedy=suggestion(name, [*system.state_names, *system.disturbance_names]),
            )
    return ControllerProgram(
        system=system,
        switching=switching,
        measured=tuple(d for d in system.disturbances if d.name in reads),
        parameters=merge_parameters(system.parameters, switching.parameters),
    )
