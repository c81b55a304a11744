"""What is closed at the end of a `with`."""

from __future__ import annotations

from typing import Self


class Closing:
    """A context that calls its `close`."""

    def close(self) -> None:
        """Close what is open; a second time does nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
