"""What the tests of devices need: compilers, and a module that stands for CuPy."""

import shutil
import subprocess
import types

import numpy as np
import pytest

from holdfast.execution.device import program
from holdfast.execution.device.program import COMPILERS, CUDA_THREADS, HostProgram

needs_cpp = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)), reason="there is no C++ compiler"
)
needs_nvcc = pytest.mark.skipif(shutil.which("nvcc") is None, reason="there is no CUDA compiler")


def has_gpu():
    try:
        program.cuda_device()
    except Exception:  # of CuPy, of the driver, or because there is none
        return False
    return True


def accepted_by_cuda(text, folder):
    """Compile kernels for a GPU of 2020, without running them."""
    (folder / "kernels.cu").write_text(text)
    options = ["-std=c++17", "-fmad=false", "-arch=sm_80", "-ptx", "-o", "kernels.ptx"]
    done = subprocess.run(
        ["nvcc", *options, "kernels.cu"], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


class StandIn(types.ModuleType):
    """The parts of CuPy that are used, with NumPy's arrays and the C++ compiler's kernels.

    What it is handed is looked at: arrays that are contiguous, scalars of eight bytes.
    """

    def __init__(self, devices=1, memory=1 << 30):
        super().__init__("cupy")
        self.options, self.launched = None, 0
        runtime = types.SimpleNamespace(
            getDeviceCount=lambda: devices,
            getDeviceProperties=lambda _: {
                "name": b"stand-in", "multiProcessorCount": 2,
            },
            memGetInfo=lambda: (memory, 2 * memory),
        )  # fmt: skip
        self.cuda = types.SimpleNamespace(
            runtime=runtime, Device=lambda: types.SimpleNamespace(id=0)
        )
        for name in ("asarray", "ones", "zeros", "uint8"):
            setattr(self, name, getattr(np, name))

    @staticmethod
    def asnumpy(array, out=None):
        found = np.empty_like(array) if out is None else out
        found[...] = array
        return found

    def RawModule(self, code, options, backend):  # noqa: N802
        self.options = options
        assert backend == "nvrtc"
        program = HostProgram(("c++",), code)

        def function(name):
            def launch(blocks, threads, arguments):
                self.launched += 1
                assert threads == (CUDA_THREADS,)
                for a in arguments:
                    assert isinstance(a, np.ndarray) or a.nbytes == 8
                program.run(name, blocks[0], *arguments)

            return launch

        return types.SimpleNamespace(compile=lambda: None, get_function=function)
