"""Scenario files: one TOML file, one experiment; its kind decides what is made of it.

Overrides without effect are refused: numbers of parameters that nothing depends on.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import sympy as sp
from pydantic import BaseModel

from holdfast.arguments import checked
from holdfast.errors import GainWarning, HoldfastError, ScenarioError, suggestion
from holdfast.maths.definitions.quantity import Parameter, symbol
from holdfast.scenario.files import Overrides, changes_of, read_tables
from holdfast.scenario.kinds import kind_of
from holdfast.scenario.kinds.base import Composed
from holdfast.scenario.schema.values import as_written

TEXT_FIELDS = ("text", "file", "digest")
"""Fields of a composed scenario about its own text: they differ with every override."""

Compose = Callable[[Sequence[str]], Sequence[object]]


def check_overrides(overrides: Iterable[str], composed: Sequence[object], compose: Compose) -> None:
    """Refuse the number of a parameter that no expression, no bound and no other number depends on.

    composed: the scenario with the overrides; compose: builds it with others. A parameter that
    stands in an expression is used; for any other the scenario is composed with a number beside
    its own, and has to differ.
    """
    changes = list(overrides)
    if not changes:
        return
    names = {p.name for p in _found(composed, Parameter)}
    used = set().union(*(e.free_symbols for e in _found(composed, sp.Basic)))
    for place, change in enumerate(changes):
        key, _, value = (part.strip() for part in change.partition("="))
        path = [part for part in key.split(".") if part != "value"]
        if path[-1] not in names or symbol(path[-1]) in used or not value:
            continue
        beside = [*changes[:place], f"{key}={_beside(value)}", *changes[place + 1 :]]
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", GainWarning)
                same = substance(compose(beside)) == substance(composed)
        except HoldfastError:  # the other number is refused, so the scenario depends on it
            continue
        if same:
            raise ScenarioError(
                f"{key}: nothing depends on '{path[-1]}'",
                expected="a number that the answer depends on",
                remedy=suggestion(path[-1], sorted(names & {s.name for s in used})),
            )


def _beside(value: str) -> str:
    """Another number, near the given one."""
    number, *unit = value.strip("\"'").split(maxsplit=1)
    try:
        other = float(number) * (1 + 2.0**-6) or 2.0**-6
    except ValueError:
        return ""  # removes the key
    return f'"{other!r} {unit[0]}"' if unit else repr(other)


def _found(value: object, kind: type) -> Iterator[Any]:
    """Everything of that kind within a value."""
    if isinstance(value, kind):
        yield value
    elif not isinstance(value, sp.Basic):
        for part in _parts(value) or ():
            yield from _found(part, kind)


def substance(value: object) -> object:
    """The value without the numbers of parameters: equal where nothing else differs."""
    if isinstance(value, Parameter):
        return value.name
    if isinstance(value, (sp.Basic, sp.MatrixBase, str)):
        return value
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    parts = _parts(value)
    return value if parts is None else (type(value).__name__, *map(substance, parts))


def _parts(value: object) -> Sequence[object] | None:
    if isinstance(value, BaseModel):
        value = dict(value)
    if is_dataclass(value):
        shown = {f.name: getattr(value, f.name) for f in fields(value) if f.name not in TEXT_FIELDS}
        if isinstance(shown.get("plant"), Mapping):  # numbers of parameters by name
            shown["plant"] = sorted(shown["plant"])
        return list(shown.values())
    if isinstance(value, Mapping):
        return [x for key in sorted(value, key=str) for x in (key, value[key])]
    if isinstance(value, (list, tuple, set, frozenset)):
        return sorted(value, key=str) if isinstance(value, (set, frozenset)) else value
    return None


@checked
def load_scenario(
    name: str, overrides: Overrides = (), runs: int | None = None, seed: int | None = None
) -> Any:
    """The scenario of that name or file.

    A `Scenario` of closed loops, a `KernelScenario`, or what another kind composes; `run` gives its
    answer. name: of a shipped scenario, or the path of a file. overrides: texts "key=value", with a
    unit where the file may have one, or a table {"key": value}. runs: how many starts are used: the
    given states first, then random ones; of a kernel, how many states its promise is tried from.

    Raises `ScenarioError` naming the file, the key, what was got and what is allowed, and for the
    override of a number that nothing depends on.

    >>> hf.load_scenario("ch2-unicycle", ["run.horizon=2"], runs=2).run()
    <Result of 2 runs: 2 stayed>
    """
    changes = changes_of(overrides)

    def compose(changes: Sequence[str]) -> list[Composed]:
        return [scenario_of(*read_tables(name, changes), runs, seed)]

    (loaded,) = made = compose(changes)
    check_overrides(changes, made, compose)
    return loaded


def scenario_of(
    shown: str, text: str, data: dict[str, Any], runs: int | None = None, seed: int | None = None
) -> Any:
    """The scenario of tables that are not checked yet; `shown` is its name or file."""
    try:
        return kind_of(shown, data).compose(shown, text, data, runs, seed)
    except ScenarioError as error:
        raise as_written(error, data) from None
