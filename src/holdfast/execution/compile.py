"""Source text to compiled functions, cached on disk so that a second process starts warm."""

from __future__ import annotations

import errno
import hashlib
import importlib.util
import os
import re
import shutil
import sys
import tempfile
from functools import cache
from importlib import resources
from pathlib import Path
from types import ModuleType

import platformdirs

from holdfast.errors import OutputError

MARK = "# -- joined from here on"

_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])")

ROOM = 20 * 2**20
"""Bytes: compiled code of a few closed loops."""

CACHE_VARIABLE = "HOLDFAST_CACHE_DIR"
"""Environment variable that moves the cache."""


def cache_directory() -> Path:
    """Where generated source and compiled code are kept; created when missing.

    A user cache that cannot be written is replaced by a temporary folder for this process;
    one that was asked for and cannot be written is an `OutputError`.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    path = Path(chosen) if chosen else Path(platformdirs.user_cache_dir("holdfast"))
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        if shutil.disk_usage(path).free < ROOM:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    except OSError as error:
        if chosen:
            raise OutputError(
                f"the cache folder {path} cannot be written ({error.strerror})",
                remedy=f"set {CACHE_VARIABLE} to a folder that can",
            ) from None
        return _temporary()
    return path


@cache
def _temporary() -> Path:
    return Path(tempfile.mkdtemp(prefix="holdfast-"))


def compile_closed_loop(source: str) -> ModuleType:
    """The module of one closed loop: the driver with the generated `source` in its place."""
    parts = (_text(f"{name}.py").partition(MARK)[2] for name in ("driver", "crossings", "batch"))
    above = "\n".join(map(_import, ("nearest", "interpolate", "trajectory")))
    return _module("loop", "\n\n".join([above, *parts, source]))


def compile_functions(source: str) -> ModuleType:
    """The module of functions that stand alone, with the primitives that they use."""
    return _module("functions", f"{_import('nearest')}\n\n{source}")


def compile_sweep(source: str, precision: str = "float64") -> ModuleType:
    """The module of a march over a grid: the slopes, in a precision, with the `source`."""
    return _module("sweep", f"{_import('slopes', precision)}\n\n\n{source}")


def single(text: str) -> str:
    """The text with its numbers and conversions in single precision.

    A constant in double precision would make all that it meets double, at half the speed.
    """
    return re.sub(r"\bfloat\(", "np.float32(", _NUMBER.sub(r"np.float32(\g<0>)", text))


def compile_interpolation() -> ModuleType:
    """The module of `interpolate.py`."""
    return _shared("interpolate")


def _shared(name: str, precision: str = "float64") -> ModuleType:
    """The module of a file that is the same for every program, so that it is compiled once."""
    above, mark, text = _text(f"{name}.py").partition(MARK)
    if precision == "float32":
        above, text = single(above), single(text)
    if not mark:
        return _module(name, above)
    below = "differences" if name == "slopes" else "primitives"
    return _module(name, f"{_import(below, precision)}\n{text}")


def _import(name: str, precision: str = "float64") -> str:
    """The line that takes all from such a module."""
    return f"from {_shared(name, precision).__name__} import *"


def _text(name: str) -> str:
    return (resources.files("holdfast.execution") / name).read_text("utf-8")


def _module(kind: str, text: str) -> ModuleType:
    """The module with this text.

    The file is named by the digest of its text, so a changed definition is a new file and
    an unchanged one is loaded, with Numba's machine code beside it.
    """
    name = f"{kind}_" + hashlib.sha256(text.encode()).hexdigest()[:24]
    if name in sys.modules:
        return sys.modules[name]
    path = cache_directory() / f"{name}.py"
    if not path.exists():
        handle, partial = tempfile.mkstemp(dir=path.parent, suffix=".partial")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(partial, path)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise OutputError(f"the generated file {path} cannot be loaded")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
