"""A graphics processor of NVIDIA, by way of CuPy, which compiles kernels when they are needed."""

from __future__ import annotations

import importlib
import os
from functools import cache
from typing import Any

from holdfast.errors import SimulationError
from holdfast.execution.arrays import AnyArray as Array
from holdfast.execution.device.program import whole_text

OPTIONS = ("--std=c++17", "--fmad=false", "--prec-div=true", "--prec-sqrt=true", "--ftz=false")
"""Every operation is rounded as IEEE 754 says, and none is fused but where the text says so."""

BLOCKS = 16
"""Blocks of threads for each multiprocessor."""

THREADS = 128
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
        self.blocks = BLOCKS * int(of["multiProcessorCount"])

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
        found: Array = self.arrays.asnumpy(array, out=out)
        return found


class CudaProgram:
    def __init__(self, cupy: Any, text: str) -> None:
        self._module = cupy.RawModule(code=text, options=OPTIONS, backend="nvrtc")
        try:
            self._module.compile()
        except Exception as error:  # of CuPy, whose types an import without CUDA may lack
            raise SimulationError(
                f"CUDA's compiler refused a kernel: {str(error)[:500]}",
                expected="CUDA 11.2 or newer",
                remedy="update the driver and CuPy",
            ) from None

    def run(self, name: str, blocks: int, *arguments: Any) -> None:
        self._module.get_function(name)((blocks,), (THREADS,), arguments)


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
