"""Several safety filters around one law, in an order of priority."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.maths.definitions.law import MOST_LEVELS, Foresight, Law, Safeguard
from holdfast.maths.definitions.quantity import merge_parameters


@checked
def in_order(filters: Sequence[Law]) -> Law:
    """One law with the safety filters of several, the most important first.

    filters: the same law with different safety filters (`safeguard`, `safety_law`), of one system.
    The input is the admissible one nearest to the command. Where not all conditions can be met,
    those of the last filter give way first: each level in turn is relaxed by the least amount that
    the levels before it allow.

    Raises `DefinitionError` for a law without a safety filter, more than one kernel, two filters
    with an inequality or a parameter of the same name, and more than six filters.
    """
    if not 1 <= len(filters) <= MOST_LEVELS:
        raise DefinitionError(f"{len(filters)} filters", expected=f"1 to {MOST_LEVELS}")
    guards: list[Safeguard] = []
    for law in filters:
        if law.safeguard is None:
            raise DefinitionError(f"law '{law.name}' has no safety filter")
        guards.append(law.safeguard)
    first = filters[0]
    if any(law.outputs != first.outputs or law.handed != first.handed for law in filters):
        raise DefinitionError("the filters are of different laws", expected="of one and the same")
    hard = guards[0].hard
    for guard in guards:
        bounds = [guard.offsets[:hard], *(n[:hard] for n in guard.normals.values())]
        own = [guards[0].offsets[:hard], *(n[:hard] for n in guards[0].normals.values())]
        if guard.hard != hard or bounds != own or guard.scales != guards[0].scales:
            raise DefinitionError("the filters have different bounds or scales of the inputs")
    tables = [law.lookup for law in filters if law.lookup is not None]
    if len(tables) > 1:
        raise DefinitionError("there is more than one kernel", expected="one, and regions")
    names = [n for guard in guards for n in dict.fromkeys(guard.names)]
    if twice := [n for n in names if names.count(n) > 1]:
        raise DefinitionError(f"two filters have an inequality '{twice[0]}'")
    reads = {q.name: q for law in filters for q in law.reads}
    return replace(
        first,
        name=f"{first.name}, then {len(filters) - 1} more" if len(filters) > 1 else first.name,
        reads=tuple(reads.values()),
        parameters=merge_parameters(*(law.parameters for law in filters)),
        signals={n: e for law in filters for n, e in law.signals.items()},
        conditions=tuple({c: None for law in filters for c in law.conditions}),
        lookup=tables[0] if tables else None,
        safeguard=Safeguard(
            {
                name: (*own[:hard], *(e for g in guards for e in g.normals[name][hard:]))
                for name, own in guards[0].normals.items()
            },
            (*guards[0].offsets[:hard], *(e for g in guards for e in g.offsets[hard:])),
            hard,
            guards[0].scales,
            tuple(u for g in guards for u in g.units),
            tuple(n for g in guards for n in g.names),
            _levels([len(g.offsets) - hard for g in guards]),
            next((_placed(g.foresight, k) for k, g in enumerate(guards) if g.foresight), None),
        ),
    )


def _levels(counts: Sequence[int]) -> tuple[int, ...]:
    """The half-spaces of each level; a kernel that looks ahead has none."""
    return tuple(n for n in counts if n) or (0,)


def _placed(foresight: Foresight, place: int) -> Foresight:
    return replace(foresight, first=place == 0)
