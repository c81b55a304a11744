"""Faults made smaller, and files that run without this folder."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
FOLDER = Path(__file__).parent


def shrunk(
    what: T, smaller: Callable[[T], Iterable[T]], has: Callable[[T], bool], seconds: float = 40.0
) -> T:
    """The smallest found that still has the fault (greedy; A. Zeller's idea of delta debugging)."""
    end = time.process_time() + seconds
    going = True
    while going and time.process_time() < end:
        going = False
        for candidate in smaller(what):
            if time.process_time() > end:
                break
            try:
                same = has(candidate)
            except Exception:
                same = False
            if same:
                what, going = candidate, True
                break
    return what


def alone(title: str, modules: Iterable[str], body: str) -> str:
    """A file of these modules of this folder, one after another, and what is to be run."""
    parts: list[str] = []
    for name in modules:
        text = (FOLDER / f"{name}.py").read_text("utf-8")
        text = re.sub(r"from attacks[.\w]* import (\([^)]*\)|[^\n]*)\n", "", text)
        text = re.sub(r"from __future__ import annotations\n", "", text)
        text = re.sub(r"\n(KIND|FORGED) = Kind\((?:[^()]|\([^()]*\))*\)\n", "\n", text)
        text = re.sub(r"\b(writing|oracle)\.(?=[a-z])", "", text)
        parts.append(f"# -- attacks/{name}.py\n\n{text}")
    quoted = title.replace("\\", "\\\\").replace('"""', "'''")
    return (
        f'"""{quoted}\n"""\n\nfrom __future__ import annotations\n\n'
        + "\n\n".join(parts)
        + '\n\nif __name__ == "__main__":\n'
        + "".join(f"    {line}\n" for line in body.splitlines())
    )


def plain(value: Any) -> Any:
    """Numbers of NumPy as Python's."""
    return value.item() if hasattr(value, "item") else value
