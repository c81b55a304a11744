"""What a docstring says of each argument: "name [unit]: ...", one after the other."""

import importlib
import re
from collections.abc import Callable, Collection
from typing import Any

EVERYWHERE = {
    "system": "a `System`, such as one of `systems` or of `load_vehicle`.",
    "law": "a `Law` or a `Switching` of this system.",
    "region": "the `Region` to keep.",
    "goal": "the `Region` to reach.",
    "field": "a `Field`.",
    "grid": "of all states, from `grid`.",
    "horizon": "[s] how long.",
    "sample_time": "[s] between two inputs; each is held as long.",
    "value": "a `ValueFunction`.",
    "result": "a `Result`.",
    "scenario": "its name, or the path of its file.",
    "overrides": 'changes of the scenario, such as "run.horizon=4".',
    "name": "what it is called in expressions, messages, tables and files.",
    "title": "of figures and tables.",
    "description": "a sentence for readers.",
    "source": "the literature that it is from.",
    "unit": 'in SI, such as "m/s".',
    "seed": "of the random numbers; the same seed gives the same answer.",
    "progress": "called from time to time, last with the share that is done, 0 to 1.",
}
"""What a name means wherever a docstring does not say more."""


def explained(text: str, names: Collection[str]) -> tuple[list[str], dict[str, str]]:
    """The paragraphs without what they say of these arguments, and what that is, by name.

    An argument is named at the beginning of a sentence, alone or with others: "low, high [m]: ...",
    where both are in m. What is said of it ends where the next one is named, where errors are, or
    with the paragraph.
    """
    name = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    begins = re.compile(
        rf"(?:^|(?<=[.;:] ))((?:`?\b(?:{name})\b`?(?: \[[^\]]*\])?(?:, )?)+)(?<! ): (?=\S)"
    )
    rest, about = [], {}
    for paragraph in re.split(r"\n\s*\n", text):
        line = paragraph if paragraph.startswith((" ", ">>>")) else " ".join(paragraph.split())
        starts = list(begins.finditer(line)) if names else []
        if not starts:
            rest.append(paragraph)
            continue
        errors = re.search(r"(?<=\. )(?:Raises|Warns with) `", line[starts[-1].end() :])
        end = starts[-1].end() + errors.start() if errors else len(line)
        rest += [line[: starts[0].start()].rstrip(), line[end:]]
        ends = [*(m.start() for m in starts[1:]), end]
        for start, until in zip(starts, ends, strict=True):
            said = line[start.end() : until].strip().rstrip(";,")
            unit = ""
            for argument, its in reversed(re.findall(r"(\w+)`?(?: (\[.*?\]))?(?:,|$)", start[1])):
                unit = its or unit
                about[argument] = f"{unit} {said}".strip()
    return [p for p in rest if p.strip()], about


def thing_at(path: str) -> Any:
    """The function or class of a module, where the package may have a function of its name."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def of_the_catalogue(function: Callable[..., Any]) -> dict[str, str]:
    """What the parameters of an entry of the catalogue say of themselves."""
    from holdfast.maths.catalogue.signature import CATALOGUES, example

    if not any(function in functions for functions in CATALOGUES.values()):
        return {}
    return {
        p.name: p.description if p.unit == "1" else f"[{p.unit}] {p.description}"
        for p in example(function).parameters
    }
