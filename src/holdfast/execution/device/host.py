"""Kernels compiled by the C++ compiler of this machine: the check of what a GPU would do."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.device.program import whole_text
from holdfast.execution.resources import check_memory

COMPILERS = ("c++", "g++", "clang++")
OPTIONS = ("-std=c++17", "-O2", "-ffp-contract=off", "-march=native", "-shared", "-fPIC")


class HostDevice:
    """Blocks follow one another; arrays are those of NumPy."""

    name = "c++"
    arrays: Any = np
    blocks = 3

    def __init__(self) -> None:
        given = os.environ.get("CXX", "").split()
        found = next((p for c in COMPILERS if (p := shutil.which(c))), None)
        if not given and found is None:
            raise SimulationError(
                "no C++ compiler was found",
                expected=f"one of {', '.join(COMPILERS)} on the path, or in the variable CXX",
                remedy="install one, or leave out device",
            )
        self.compiler = given or [str(found)]

    def program(self, text: str) -> HostProgram:
        return _built(tuple(self.compiler), whole_text(text))

    def address(self, array: Any) -> int:
        return int(array.ctypes.data)

    def check_memory(self, needed: int, what: str) -> None:
        check_memory(needed, what)

    def fetched(self, array: Any, out: Array | None = None) -> Array:
        """A copy, as from another memory."""
        out = np.empty_like(array) if out is None else out
        out[...] = array
        return out


@cache
def _built(compiler: tuple[str, ...], text: str) -> HostProgram:
    return HostProgram(compiler, text)


class HostProgram:
    def __init__(self, compiler: tuple[str, ...], text: str) -> None:
        with tempfile.TemporaryDirectory(prefix="holdfast-") as folder:
            name = hashlib.sha256(text.encode()).hexdigest()[:16]
            source, library = Path(folder, f"{name}.cpp"), Path(folder, f"{name}.so")
            source.write_text(text, "utf-8")
            command = [*compiler, *OPTIONS, str(source), "-o", str(library)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode != 0:
                raise SimulationError(
                    f"{compiler[0]} refused a kernel: {done.stderr.strip()[:500]}",
                    expected="a compiler of C++17",
                    remedy="name another in the variable CXX",
                )
            self._library = ctypes.CDLL(str(library))

    def run(self, name: str, blocks: int, *arguments: Any) -> None:
        """Call a kernel; the last block is the first, so that no order is taken for granted."""
        function = getattr(self._library, name)
        given = [_argument(a) for a in arguments]
        for block in reversed(range(blocks)):
            self._library.hf_on(ctypes.c_longlong(block), ctypes.c_longlong(blocks))
            function(*given)


def _argument(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        assert value.flags.c_contiguous
        return ctypes.c_void_p(value.ctypes.data)
    if isinstance(value, np.integer):
        return ctypes.c_longlong(int(value))
    return ctypes.c_double(float(value))
