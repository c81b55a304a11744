"""Which inequalities can be kept apart: those whose factors share no input.

M. Chen, S. Herbert, M. Vashishtha, S. Bansal, C. Tomlin, "Decomposition of reachable sets and tubes
for a class of nonlinear systems", IEEE TAC 63(11), 2018: of self-contained subsystems without
common controls the set that avoids a union of targets, kept in an intersection, is the
intersection of theirs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from holdfast.maths.decomposition.factor import Factor, factor, players
from holdfast.maths.definitions.bounds import Box, product
from holdfast.maths.definitions.quantity import Quantity
from holdfast.maths.definitions.region import Inequality
from holdfast.maths.definitions.system import System

Interval = tuple[float, float]


@dataclass(frozen=True)
class Group:
    """Inequalities that are kept together: their factor, and the states that disturb it.

    cut: of those states that the factor uses, the intervals.
    """

    factor: Factor
    cut: Mapping[str, Interval]


@dataclass(frozen=True)
class Grouping:
    """The groups, and sentences that say why inequalities stay together."""

    groups: tuple[Group, ...]
    reasons: tuple[str, ...]


def with_cut(system: System, cut: Mapping[str, Interval]) -> System:
    """The system in which these states are disturbances within their intervals."""
    if not cut:
        return system
    by_name = {q.name: q for q in system.states}
    box = Box(tuple(a for a, _ in cut.values()), tuple(b for _, b in cut.values()))
    felt = product(box, system.disturbance_bounds) if system.disturbances else box
    return replace(
        system,
        states=tuple(q for q in system.states if q.name not in cut),
        rates={n: r for n, r in system.rates.items() if n not in cut},
        disturbances=(*(by_name[n] for n in cut), *system.disturbances),
        disturbance_bounds=felt,
        pfaffian=(),
        measurements=(),
        flat_output=None,
    )


def grouped(
    system: System,
    inequalities: Sequence[Inequality],
    *,
    cut: Mapping[str, Interval],
    chosen: Sequence[str],
    together: Sequence[str] = (),
    relative: bool = True,
) -> Grouping:
    """The finest groups of inequalities whose factors share none of the `chosen` quantities.

    chosen: what somebody chooses who wants the inequalities to hold. together: inequalities that
    are to stay together whatever they use. relative: as for `factor`. Inequalities that no
    state enters stay with the first.
    """
    reasons: list[str] = []
    sets: list[list[Inequality]] = [[c for c in inequalities if c.name in together]]
    sets += [[c] for c in inequalities if c.name not in together]
    found: list[tuple[list[Inequality], Group]] = []
    still: list[Inequality] = []
    for members in (s for s in sets if s):
        group = _group(system, members, cut, relative)
        if group is None:
            still += members
            continue
        while group is not None:
            held = _held(group, chosen)
            other = next((k for k, (_, g) in enumerate(found) if held & _held(g, chosen)), None)
            if other is None:
                break
            others, g = found.pop(other)
            reasons += _shared(g, group, sorted(held & _held(g, chosen)))
            members = [*others, *members]
            group = _group(system, members, cut, relative)
        if group is not None:
            found.append((members, group))
    if still and found:
        members, _ = found[0]
        again = _group(system, [*members, *still], cut, relative)
        assert again is not None
        found[0] = ([*members, *still], again)
    found = _absorbed(system, found, cut, relative)
    return Grouping(tuple(g for _, g in found), tuple(dict.fromkeys(reasons)))


def _absorbed(
    system: System,
    found: list[tuple[list[Inequality], Group]],
    cut: Mapping[str, Interval],
    relative: bool,
) -> list[tuple[list[Inequality], Group]]:
    """The groups, those with no state of their own put together with another that has them all."""
    left = sorted(found, key=lambda pair: -len(pair[1].factor.coordinates))
    kept: list[tuple[list[Inequality], Group]] = []
    for members, group in left:
        mine = dict(group.factor.coordinates)
        for k, (others, g) in enumerate(kept):
            if mine.items() <= dict(g.factor.coordinates).items() and mine.keys().isdisjoint(g.cut):
                again = _group(system, [*others, *members], cut, relative)
                assert again is not None
                if again.factor.coordinates == g.factor.coordinates and again.cut == g.cut:
                    kept[k] = ([*others, *members], again)
                    break
        else:
            kept.append((members, group))
    order = {c.name: k for k, (m, _) in enumerate(found) for c in m}
    return sorted(kept, key=lambda pair: min(order[c.name] for c in pair[0]))


def _group(
    system: System, members: Sequence[Inequality], cut: Mapping[str, Interval], relative: bool
) -> Group | None:
    read = set().union(*(c.expression.free_symbols for c in members))
    names = {q.name: q.symbol for q in system.states}
    mine = {n: i for n, i in cut.items() if names[n] not in read}
    found = factor(with_cut(system, mine), members, relative=relative)
    if found is None:
        return None
    used = {n: i for n, i in mine.items() if n in found.system.disturbance_names}
    return Group(found, used)


def _held(group: Group, chosen: Sequence[str]) -> set[str]:
    """The names of the chosen quantities that the factor uses."""
    system = group.factor.system
    every: list[tuple[Quantity, ...]] = players(system.input_bounds, system.inputs, system)
    every += players(system.disturbance_bounds, system.disturbances, system)
    return {q.name for g in every for q in g if q.name in chosen and q.name not in group.cut}


def _shared(one: Group, other: Group, shared: Sequence[str]) -> list[str]:
    """Why two factors become one; nothing where one of them has the states of the other."""
    first, second = (dict(g.factor.coordinates) for g in (one, other))
    if first.items() <= second.items() or second.items() <= first.items():
        return []
    sides = (", ".join(side) for side in (first, second))
    return [
        f"({next(sides)}) and ({next(sides)}) are one part: both need {', '.join(shared)}, of "
        "which one choice has to do for both; the intersection of their separate sets would only "
        "contain the set"
    ]
