"""The text of the turns of modes: their guards are tried in order, and changes are counted."""

from __future__ import annotations

from collections.abc import Mapping

from holdfast.execution.codegen.loop_text import Instructions
from holdfast.execution.simulation.layout import FORGOTTEN, Shape


def turn(body: Instructions, at: Mapping[str, int], shape: Shape) -> None:
    """The modes after their guards are tried in order."""
    rows = {"t": at["length"], "q": at["since"]}
    rows["x"] = at["time_in_mode"]
    if shape.modes > 1:
        body.call("where", **rows, out=at["in_modes"])
    if not any(shape.targets):
        return
    for k, targets in enumerate(shape.targets):
        if targets:
            with body.if_any(at["in_modes"] + k * body.width):
                body.call(
                    f"guards{k}", t=at["time"], q=at["seen"], x=at["time_in_mode"],
                    p=at["gains"], out=at["levels"],
                )  # fmt: skip
                body.call(
                    f"turn{k}", t=at["mode"], q=at["levels"], x=at["next_mode"],
                    out=at["next_mode"],
                )  # fmt: skip
    body.call("changed", **rows, out=at["changed"])
    body.late(FORGOTTEN, at["changed"], at["forgotten"], 1)
    body.call("switch", **rows, out=at["since"])
    with body.if_any(at["changed"]):
        body.call("chatter", **rows, out=at["outcome"])
