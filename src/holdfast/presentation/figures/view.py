"""The content of a value function's figure: states drawn, states fixed, titles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import OutputError, suggestion
from holdfast.presentation.figures import style

SLICES = 5
"""The default number of slices."""

Held = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True)
class View:
    """One or two states are drawn; `held` are the fixed ones, `given` by the caller or by default.

    along: the state of the slices, at `values`; "" for a single picture.
    """

    plane: tuple[str, ...]
    held: dict[str, float]
    given: dict[str, float]
    along: str = ""
    values: tuple[float, ...] = ()


def look_at(
    value: ValueFunction,
    plane: tuple[str, str] | None,
    at: Held | None,
    others: Iterable[ValueFunction] = (),
) -> View:
    """The view to draw; `OutputError` for a plane or fixed states that leave no picture."""
    at = dict(at or {})
    for name in at:
        if name not in value.names:
            raise OutputError(f"'{name}' is not a state", remedy=suggestion(name, value.names))
    given = {n: float(v) for n, v in at.items() if not isinstance(v, Sequence | np.ndarray)}
    several = {n: [float(x) for x in v] for n, v in at.items() if n not in given}  # type: ignore[union-attr]
    free = [n for n in value.names if n not in at]
    if not free or len(several) > 1 or (len(free) == 1 and several):
        raise OutputError(
            f"the states to draw are: {', '.join(free) or 'none'}",
            expected="one; or two, with several values of at most one other",
        )
    if plane is not None and (len(set(plane)) != 2 or not set(plane) <= set(free)):
        raise OutputError(
            f"the plane is ({', '.join(plane)})", expected="two of the states " + ", ".join(free)
        )
    drawn = tuple(plane or free[:2])
    rest = [n for n in free if n not in drawn]
    along = next(iter([*several, *rest]), "")
    usual = {a.name: _usual(a.low, a.high) for a in value.grid.axes if a.name in rest}
    held = {n: v for n, v in (given | usual).items() if n != along}
    values = several.get(along) or (
        _across(along, [v.slice(**held) for v in (value, *others)]) if along else []
    )
    return View(drawn, held, given, along, tuple(values))


def check_same_states(value: ValueFunction, others: Mapping[str, ValueFunction]) -> None:
    """Refuse a comparison with a value function of other states."""
    for name, other in others.items():
        if other.names != value.names:
            raise OutputError(
                f"'{name}' is a value function of {', '.join(other.names)}",
                expected=f"the states {', '.join(value.names)}",
            )


def _usual(low: float, high: float) -> float:
    return 0.0 if low <= 0.0 <= high else (low + high) / 2


def _across(name: str, values: Sequence[ValueFunction]) -> list[float]:
    """Nodes of one state, evenly spaced over the extent of all sets at all their times."""
    (axis,) = (a for a in values[0].grid.axes if a.name == name)
    inside = [axis.nodes[[0, -1]]]
    for value in values:
        shadow = value.projection(name)
        data = shadow.dataset["value"]
        found = (data.max("time") if "time" in data.dims else data).values > 0
        inside.append(shadow.grid.axes[0].nodes[found])
    places = np.concatenate(inside[1:] if sum(map(len, inside[1:])) else inside)
    first, last = (int(np.abs(axis.nodes - x).argmin()) for x in (places.min(), places.max()))
    wanted = np.linspace(first, last, SLICES + 2)[1:-1]
    return [float(axis.nodes[k]) for k in np.unique(np.round(wanted).astype(int))]


def told(value: ValueFunction) -> str:
    """Title: the set, its convergence, and whether it is empty or covers the grid."""
    report, last = value.report, value.values()
    text = "value function"
    if report.kind:
        text = f"{report.kind.replace('-', ' ')} of {report.region}, {report.system}"
        reached = f"{report.reached_s:.3g} s"
        if report.converged:
            text += f"\nconverged after {reached}"
        elif "kernel" in report.kind:
            text += f"\nfor {reached}, not converged"
        else:
            text += f"\nwithin {reached}"
        if report.approximation:
            text += f", {report.approximation}"
    if not (last > 0).any():
        text += "; empty: no node of the grid is in the set"
    elif (last > 0).all():
        text += "; every node of the grid is in the set"
    return text.replace("_", " ")


def where(value: ValueFunction, held: Mapping[str, float]) -> str:
    """The fixed states, with units."""
    units = {a.name: a.state.unit for a in value.grid.axes}
    return ", ".join(
        f"{style.label(n)} = {v if abs(v) > 1e-12 else 0.0:.3g}"
        + ("" if units[n] == "1" else f" {units[n]}")
        for n, v in held.items()
    )
