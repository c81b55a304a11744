"""The store of a campaign's finished parts on disk: a kill at any time loses no finished part.

It is an SQLite file, whose transactions are atomic.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from holdfast.errors import OutputError

Key = tuple[int, int]
"""The cell, and the part of it."""


class Store:
    """The answers of the parts of one campaign, by `campaign`, its digest.

    Answers of other campaigns in the same file are left untouched. Failures are not kept beyond
    this call: the next one tries again.
    """

    def __init__(self, connection: sqlite3.Connection, campaign: str) -> None:
        self.connection, self.campaign = connection, campaign
        self.failed: dict[int, dict[int, dict[str, Any]]] = {}  # cell, part
        with connection:
            connection.execute(
                "CREATE TABLE IF NOT EXISTS part (campaign TEXT, cell INTEGER, number INTEGER, "
                "answer TEXT, PRIMARY KEY (campaign, cell, number))"
            )

    def finished(self) -> set[Key]:
        """The finished parts."""
        rows = self.connection.execute(
            "SELECT cell, number FROM part WHERE campaign = ?", (self.campaign,)
        )
        return set(rows)

    def put(self, key: Key, answer: dict[str, Any]) -> None:
        """Store the answer of a part; it is on disk when this returns."""
        if answer.get("failed"):
            self.failed.setdefault(key[0], {})[key[1]] = answer
            return
        with self.connection:
            self.connection.execute(
                "INSERT OR IGNORE INTO part VALUES (?, ?, ?, ?)",
                (self.campaign, *key, json.dumps(answer)),
            )

    def answers(self, cell: int) -> list[dict[str, Any]]:
        """The answers of all parts of a cell, in order."""
        rows = self.connection.execute(
            "SELECT number, answer FROM part WHERE campaign = ? AND cell = ?",
            (self.campaign, cell),
        )
        found = {number: json.loads(text) for number, text in rows}
        found |= self.failed.get(cell, {})
        return [found[number] for number in sorted(found)]


@contextmanager
def store(path: Path | None, campaign: str) -> Iterator[Store]:
    """The store in that file, or in memory.

    Raises `OutputError` if the file cannot be written, is not a store, or the disk is full.
    """
    shown = path if path is not None else ":memory:"
    try:
        connection = sqlite3.connect(shown)
        try:
            yield Store(connection, campaign)
        finally:
            connection.close()
    except sqlite3.DatabaseError as error:
        raise OutputError(
            f"{shown} cannot be used ({error})",
            remedy="make room or choose another folder with --out: its content is kept",
        ) from None
