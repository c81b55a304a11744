"""What of a start is dragged in a page: the vehicles whose places and headings are states."""

from __future__ import annotations

from typing import Any

from holdfast.maths.definitions.system import System


def poses(system: System, plane: tuple[str, str]) -> list[dict[str, Any]]:
    """The vehicles whose places are states: that of the plane, then others with names like it.

    Of each the states of its place, and its heading, an angle whose name has the same end.
    """
    names, states = list(system.state_names), system.states
    angles = [k for k, q in enumerate(states) if q.angle]
    if any(states[names.index(n)].unit != "m" for n in plane):
        angles = []
    ends = [plane[0][1:]] if plane[0][:1] == "x" and plane[1] == f"y{plane[0][1:]}" else []
    ends += [n[1:] for n in names if n[:1] == "x" and f"y{n[1:]}" in names and n not in plane]
    if not ends:
        first = angles[0] if angles else None
        return [{"place": [names.index(n) for n in plane], "heading": first, "label": "start"}]

    def heading(end: str) -> int | None:
        own = [k for k in angles if names[k].endswith(end)]
        return own[0] if own else None

    return [
        {
            "place": [names.index(f"x{end}"), names.index(f"y{end}")], "heading": heading(end),
            "label": end if len(ends) > 1 else "start",
        }
        for end in ends
    ]  # fmt: skip
