"""Texts of Python as syntax trees, in any number of threads."""

from __future__ import annotations

import ast
import threading
from typing import Any

_PARSING = threading.Lock()


def syntax_tree(text: str, mode: str = "exec") -> Any:
    """`ast.parse`, by one thread at a time.

    Python 3.11 counts the depth of a tree once for all threads, and fails where two of them parse
    (`SystemError: AST constructor recursion depth mismatch`; Python's issue 106905).
    """
    with _PARSING:
        return ast.parse(text, mode=mode)
