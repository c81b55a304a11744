"""The field's words, and what each is here: the table that the page of the glossary shows.

A word that is no name of ours is answered by its row: in `holdfast show`, in `holdfast list`, and
where a system or a scenario of that name is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources

from holdfast.errors import suggestion

LINK = re.compile(r"\[([^]]*)\]\(([^)]*)\)")


@dataclass(frozen=True)
class Row:
    """Words that mean the same or go together, and what they are here, with the page about it."""

    words: tuple[str, ...]
    here: str
    names: frozenset[str]
    """The names of ours in it, without their modules."""


@cache
def rows() -> tuple[Row, ...]:
    """The rows of the table."""
    lines = (resources.files("holdfast.scenario") / "glossary.md").read_text("utf-8").splitlines()
    cells = ([cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:])
    return tuple(
        Row(
            tuple(words.split(", ")),
            LINK.sub(r"\1: docs/\2", here).replace("`", ""),
            frozenset(name.rpartition(".")[2] for name in re.findall(r"`([\w.-]+)`", here)),
        )
        for words, here in cells
    )


def looked_up(word: str) -> tuple[Row, ...]:
    """The rows of a word, or else of words that it is a part of: "dubins" of "Dubins car"."""
    asked = _plain(word)
    if not asked:
        return ()
    within = re.compile(rf"\b{re.escape(asked)}s?\b")
    exactly = tuple(row for row in rows() if asked in map(_plain, row.words))
    return exactly or tuple(
        row for row in rows() if any(within.search(_plain(term)) for term in row.words)
    )


def _plain(word: str) -> str:
    """In small letters, without hyphens: reach_avoid is reach-avoid."""
    return " ".join(re.split(r"[\s_-]+", word.lower())).strip()


def meant(name: str, names: Iterable[str]) -> str:
    """The remedy for a name that is none of `names`: what the word is here, or the nearest name."""
    about = looked_up(name)
    return f"{about[0].words[0]}: {about[0].here}" if len(about) == 1 else suggestion(name, names)
