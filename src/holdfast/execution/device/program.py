"""What a device has to be able to do."""

from __future__ import annotations

from importlib import resources
from typing import Any, Protocol

from holdfast.execution.arrays import AnyArray as Array


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
        """The values of an array of the device, on the host; in `out`, if that is given."""


def whole_text(text: str) -> str:
    """With what all kernels need before it."""
    return (resources.files(__package__) / "blocks.h").read_text("utf-8") + "\n" + text


DEVICES = ("cpu", "gpu", "c++")
"""Where a march runs: on the cores of this machine, on a graphics processor, and, to check what
that does, the same kernels compiled by a C++ compiler."""


def device_named(name: str) -> Device | None:
    """None for the cores of this machine. Raises `SimulationError` where there is none."""
    if name == "cpu":
        return None
    if name == "gpu":
        from holdfast.execution.device.cuda import cuda_device

        return cuda_device()
    from holdfast.execution.device.host import HostDevice

    return HostDevice()
