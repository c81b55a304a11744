"""Programs for a graphics processor: what a device has to be able to do, and the two that do it.

One is a GPU of NVIDIA, by way of CuPy, which compiles kernels when they are needed. The other is
the C++ compiler of this machine: the check of what a GPU would do.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.resources import check_memory


class Program(Protocol):
    """Compiled kernels."""

    def run(self, name: str, blocks: int, *arguments: Any) -> None:
        """Launch a kernel; arguments are arrays of the device, int64 and float64 scalars."""


class Device(Protocol):
    """arrays: the module of its arrays, NumPy or one that is used alike. blocks: how many blocks of
    threads are launched at most."""

    name: str
    arrays: Any
    blocks: int

    def program(self, text: str) -> Program:
        """The kernels of a text, which follows `blocks.h`."""

    def address(self, array: Any) -> int:
        """Of the first number of an array of the device."""

    def check_memory(self, needed: int, what: str) -> None:
        """Refuse arrays beyond the memory of the device."""

    def fetched(self, array: Any, out: Array | None = None) -> Array:
        """The values of an array of the device, on the host; in `out`, if that is given. Both have
        any shape, and the same."""


def whole_text(text: str) -> str:
    """With what all kernels need before it."""
    return (resources.files(__package__) / "blocks.h").read_text("utf-8") + "\n" + text


DEVICES = ("cpu", "gpu", "c++")
"""Where a march runs: on the cores of this machine, on a graphics processor, and, to check what
that does, the same kernels compiled by a C++ compiler."""


def device_named(name: str) -> Device:
    """A device other than the cores of this machine; `SimulationError` where there is none."""
    return cuda_device() if name == "gpu" else HostDevice()


CUDA_OPTIONS = ("--std=c++17", "--fmad=false", "--prec-div=true", "--prec-sqrt=true", "--ftz=false")
"""Every operation is rounded as IEEE 754 says, and none is fused but where the text says so."""

CUDA_BLOCKS = 16
"""Blocks of threads for each multiprocessor."""

CUDA_THREADS = 128
"""As in `blocks.h`."""


class CudaDevice:
    """The GPU that CuPy takes first; the variable CUDA_VISIBLE_DEVICES chooses among several."""

    name = "gpu"

    def __init__(self) -> None:
        try:
            self.arrays: Any = importlib.import_module("cupy")
        except ImportError as error:
            raise SimulationError(
                f"a GPU is reached by way of CuPy, which cannot be imported ({error})",
                expected="CuPy for the CUDA of the driver",
                remedy='pip install "holdfast[gpu]" for CUDA 12, or cupy-cuda13x, cupy-cuda11x',
            ) from None
        cuda = self.arrays.cuda
        try:
            count = cuda.runtime.getDeviceCount()
        except Exception as error:  # of the driver, or because there is none
            raise _none(str(error)) from None
        if count == 0:
            raise _none("the driver knows of no device")
        device = cuda.Device()
        of = cuda.runtime.getDeviceProperties(device.id)
        self.model = of["name"].decode()
        self.blocks = CUDA_BLOCKS * int(of["multiProcessorCount"])

    def program(self, text: str) -> CudaProgram:
        return CudaProgram(self.arrays, whole_text(text))

    def address(self, array: Any) -> int:
        return int(array.data.ptr)

    def check_memory(self, needed: int, what: str) -> None:
        free, _ = self.arrays.cuda.runtime.memGetInfo()
        if needed > free:
            raise SimulationError(
                f"{what} take {needed / 2**30:.3g} GiB, {self.model} has {free / 2**30:.3g} left",
                expected="at most what is left of its memory",
                remedy='take fewer nodes or runs, precision="float32", or a scheme of lower order',
            )

    def fetched(self, array: Any, out: Array | None = None) -> Array:
        """As `Device.fetched`, in any shape."""
        values: Array = self.arrays.asnumpy(array, out=out)
        return values


class CudaProgram:
    def __init__(self, cupy: Any, text: str) -> None:
        self._module = cupy.RawModule(code=text, options=CUDA_OPTIONS, backend="nvrtc")
        try:
            self._module.compile()
        except Exception as error:  # of CuPy, whose types an import without CUDA may lack
            raise SimulationError(
                f"CUDA's compiler refused a kernel: {str(error)[:500]}",
                expected="CUDA 11.2 or newer",
                remedy="update the driver and CuPy",
            ) from None

    def run(self, name: str, blocks: int, *arguments: Any) -> None:
        self._module.get_function(name)((blocks,), (CUDA_THREADS,), arguments)


def _none(why: str) -> SimulationError:
    hidden = os.environ.get("CUDA_VISIBLE_DEVICES")
    shown = f"; CUDA_VISIBLE_DEVICES is '{hidden}'" if hidden is not None else ""
    return SimulationError(
        f"no GPU was found: {why}{shown}",
        expected="a GPU of NVIDIA with its driver",
        remedy='leave out device, or device="c++" for the same kernels on the processor',
    )


@cache
def cuda_device() -> CudaDevice:
    """The GPU of this process."""
    return CudaDevice()


COMPILERS = ("c++", "g++", "clang++")
COMPILER_OPTIONS = ("-std=c++17", "-O2", "-ffp-contract=off", "-march=native", "-shared", "-fPIC")


class HostDevice:
    """Blocks follow one another; arrays are those of NumPy."""

    name = "c++"
    arrays: Any = np
    blocks = 3

    def __init__(self) -> None:
        command = os.environ.get("CXX", "").split()
        compiler = next((p for c in COMPILERS if (p := shutil.which(c))), None)
        if not command and compiler is None:
            raise SimulationError(
                "no C++ compiler was found",
                expected=f"one of {', '.join(COMPILERS)} on the path, or in the variable CXX",
                remedy="install one, or leave out device",
            )
        self.compiler = command or [str(compiler)]

    def program(self, text: str) -> HostProgram:
        return _built(tuple(self.compiler), whole_text(text))

    def address(self, array: Any) -> int:
        return int(array.ctypes.data)

    def check_memory(self, needed: int, what: str) -> None:
        check_memory(needed, what)

    def fetched(self, array: Any, out: Array | None = None) -> Array:
        """A copy, as from another memory, in any shape."""
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
            command = [*compiler, *COMPILER_OPTIONS, str(source), "-o", str(library)]
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
        passed = [_argument(a) for a in arguments]
        for block in reversed(range(blocks)):
            self._library.hf_on(ctypes.c_longlong(block), ctypes.c_longlong(blocks))
            function(*passed)


def _argument(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        assert value.flags.c_contiguous
        return ctypes.c_void_p(value.ctypes.data)
    if isinstance(value, np.integer):
        return ctypes.c_longlong(int(value))
    return ctypes.c_double(float(value))
