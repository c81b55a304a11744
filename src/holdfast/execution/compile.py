"""Compilation of source text, cached on disk so that a second process starts faster."""

from __future__ import annotations

import hashlib
import re
import sys
import threading
from importlib import resources
from importlib.abc import InspectLoader
from pathlib import Path
from types import CodeType, ModuleType

from holdfast.execution.cache import cache_directory, keep_source

__all__ = ["cache_directory"]

MARK = "# -- joined from here on"

STENCILS = "level_set/stencils"

_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])")

_building = threading.RLock()
"""Other threads see a module only after its execution."""


def compile_sweep(precision: str, *, one_slope: bool) -> ModuleType:
    """The module of a march over a grid in a precision, for schemes with one or two slopes."""
    files = (f"level_set/slopes_{'once' if one_slope else 'twice'}", "level_set/sweep")
    text = "\n".join(_text(name).partition(MARK)[2] for name in files)
    text = single(text) if precision == "float32" else text
    return _module("sweep", f"{_import(STENCILS, precision)}\n{text}")


def single(text: str) -> str:
    """The text with its numbers and conversions in single precision.

    A constant in double precision would promote all operands to double, at half the speed.
    """
    return re.sub(r"\bfloat\(", "np.float32(", _NUMBER.sub(r"np.float32(\g<0>)", text))


def _shared(name: str, precision: str = "float64") -> ModuleType:
    """The module of a file shared by all programs, so that it is compiled once."""
    above, mark, text = _text(name).partition(MARK)
    if precision == "float32":
        above, text = single(above), single(text)
    kind = name.rpartition("/")[2]
    if not mark:
        return _module(kind, above)
    return _module(kind, f"{_import('primitives', precision)}\n{text}")


def _import(name: str, precision: str = "float64") -> str:
    """The line that imports all names of such a module."""
    return f"from {_shared(name, precision).__name__} import *"


def _text(name: str) -> str:
    return (resources.files("holdfast.execution") / f"{name}.py").read_text("utf-8")


def _module(kind: str, text: str) -> ModuleType:
    """The module with this text.

    Its name is the digest of its text: a changed definition is a new module, and an unchanged one
    finds its machine code in the cache.
    """
    name = f"{kind}_" + hashlib.sha256(text.encode()).hexdigest()[:24]
    with _building:
        if name not in sys.modules:
            sys.modules[name] = _executed(name, text)
        return sys.modules[name]


class _Text(InspectLoader):
    """Loader of a module from its text; the file is only for tracebacks."""

    def __init__(self, text: str, path: Path) -> None:
        self.text, self.path = text, path

    def get_source(self, fullname: str) -> str:
        return self.text

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.text, self.path)


def _executed(name: str, text: str) -> ModuleType:
    path = cache_directory() / f"{name}.py"
    keep_source(path, text)
    loader = _Text(text, path)
    module = ModuleType(name)
    module.__file__ = str(path)
    loader.exec_module(module)
    return module
