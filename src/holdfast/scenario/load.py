"""Scenario files: one TOML file, one experiment; its kind decides what is made of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from holdfast.arguments import checked
from holdfast.scenario.files import read_tables
from holdfast.scenario.kinds import kind_of
from holdfast.scenario.kinds.base import Composed
from holdfast.scenario.overrides import check_overrides


@checked
def load_scenario(
    name: str, overrides: Iterable[str] = (), runs: int | None = None, seed: int | None = None
) -> Any:
    """The scenario of that name or file, with `key=value` overrides.

    A `Scenario` of closed loops, a `KernelScenario`, or what another kind composes; `run` gives its
    answer. `runs` sets how many starts are used: the given states first, then random ones; of a
    kernel, how many states its promise is tried from.

    Raises `ScenarioError` naming the file, the key, what was got and what is allowed, and for the
    override of a number that nothing depends on.
    """
    changes = list(overrides)

    def compose(changes: Sequence[str]) -> list[Composed]:
        return [scenario_of(*read_tables(name, changes), runs, seed)]

    (loaded,) = made = compose(changes)
    check_overrides(changes, made, compose)
    return loaded


def scenario_of(
    shown: str, text: str, data: dict[str, Any], runs: int | None = None, seed: int | None = None
) -> Any:
    """The scenario of tables that are not checked yet; `shown` is its name or file."""
    return kind_of(shown, data).compose(shown, text, data, runs, seed)
