"""The command of another controller, as a law; what a law takes disturbances for."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from holdfast.arguments import checked
from holdfast.errors import DefinitionError, suggestion
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.system import System


@checked
def commanded(system: System, outputs: Sequence[str] | None = None) -> Law:
    """The law that hands on what another controller commands: output_i = command_i.

    outputs: names of inputs of the system, by default all of them; or of states that its inputs are
    to track (`track_velocity`). Whoever runs the law hands it `command_NAME` at every sample.

    Raises `DefinitionError` for an unknown name.
    """
    by_name = {q.name: q for q in (*system.states, *system.inputs)}
    names = system.input_names if outputs is None else tuple(outputs)
    for name in names:
        if name not in by_name:
            raise DefinitionError(
                f"'{name}' is neither an input nor a state of system '{system.name}'",
                remedy=suggestion(name, by_name),
            )
    handed = {n: Quantity(f"command_{n}", by_name[n].unit, f"commanded {n}") for n in names}
    return Law(
        "command of another controller", (), {n: h.symbol for n, h in handed.items()},
        handed=tuple(handed.values()),
    )  # fmt: skip


def believed_disturbances(system: System, law: Law) -> dict[sp.Symbol, sp.Expr]:
    """The value that the law uses for each disturbance: measured or believed, else zero."""
    for name in law.believed:
        if name not in system.disturbance_names:
            raise DefinitionError(
                f"law '{law.name}' has a value for '{name}', which is not a disturbance",
                remedy=suggestion(name, system.disturbance_names),
            )
    read = {q.name: q.symbol for q in law.reads}
    return {
        d.symbol: law.believed.get(d.name, read.get(d.name, sp.S.Zero)) for d in system.disturbances
    }
