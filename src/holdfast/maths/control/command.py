"""The command of another controller, as a law."""

from __future__ import annotations

from collections.abc import Sequence

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
    known = {q.name: q for q in (*system.states, *system.inputs)}
    names = system.input_names if outputs is None else tuple(outputs)
    for name in names:
        if name not in known:
            raise DefinitionError(
                f"'{name}' is neither an input nor a state of system '{system.name}'",
                remedy=suggestion(name, known),
            )
    handed = {n: Quantity(f"command_{n}", known[n].unit, f"commanded {n}") for n in names}
    return Law(
        "command of another controller", (), {n: h.symbol for n, h in handed.items()},
        handed=tuple(handed.values()),
    )  # fmt: skip
