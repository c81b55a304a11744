"""Leaves: functions over columns, compiled alone by LLVM and called through their addresses.

A leaf contains one program; the loops that call leaves contain none and are compiled once. LLVM
compiles a leaf in some hundredths of a second, through llvmlite.

Expressions of the state become a leaf for values at many points in one call.
"""

from __future__ import annotations

import ctypes
import hashlib
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from holdfast.errors import SimulationError
from holdfast.execution.arrays import Array
from holdfast.execution.codegen.llvm_text import LANES, Leaf, leaves_text
from holdfast.execution.codegen.lowering import leaf_of
from holdfast.host.files import Stored
from holdfast.maths.definitions.quantity import Parameter

BLOCK = 1024
"""Points that are computed together: their columns stay in the processor's cache."""

_compiling = threading.RLock()


class Leaves:
    """Compiled leaves.

    addresses[name]: of `void (double *arguments..., *out, i64 stride, i64 count)`. digest: of their
    text.
    """

    def __init__(self, text: str, digest: str, names: Mapping[str, int]) -> None:
        self.digest = digest
        self._engine = _engine(_object_code(text, digest))  # which holds the machine code
        self.addresses = {n: self._engine.get_function_address(_symbol(n)) for n in names}
        self._functions = {
            name: ctypes.CFUNCTYPE(
                None, *[ctypes.c_void_p] * (count + 1), ctypes.c_int64, ctypes.c_int64
            )(self.addresses[name])
            for name, count in names.items()
        }

    def call(self, name: str, *columns: Array) -> None:
        """Fill the last of the arrays, from the others; all have rows of the same length."""
        stride = columns[-1].shape[1]
        self._functions[name](*(c.ctypes.data for c in columns), stride, stride)

    def function(self, name: str) -> Callable[..., None]:
        """A leaf, which is called with addresses in place of arrays."""
        return self._functions[name]

    def values(self, name: str, count: int, width: int, *arguments: Array) -> Array:
        """The results at `count` points, shape (count, width).

        An argument has the shape (count, rows), or (rows,) if it is the same at all points.
        """
        out = np.zeros((count, width))
        if not out.size:
            return out
        stride = min(padded(count), BLOCK)
        same = {i: _repeated(a, stride) for i, a in enumerate(arguments) if a.ndim == 1}
        some = np.empty((width, stride))
        for first in range(0, count, stride):
            part = slice(first, first + stride)
            arrays = (same.get(i, a) for i, a in enumerate(arguments))
            self.call(
                name,
                *(a if i in same else columns(a[part], stride) for i, a in enumerate(arrays)),
                some,
            )
            out[part] = some[:, : min(stride, count - first)].T
        return out


def compiled_leaves(leaves: Mapping[str, Leaf]) -> Leaves:
    """The machine code of these leaves, from memory, the disk or LLVM."""
    text = leaves_text({_symbol(name): leaf for name, leaf in leaves.items()})
    digest = hashlib.sha256(text.encode()).hexdigest()
    with _compiling:
        if digest not in _known:
            names = {name: len(leaf.arguments) for name, leaf in leaves.items()}
            _known[digest] = Leaves(text, digest, names)
        return _known[digest]


_known: dict[str, Leaves] = {}
"""Those of this process, by the digest of their text."""


def compiled_text(text: str, *, optimised: bool = False) -> Machine:
    """The machine code of a text of LLVM, from memory, the disk or LLVM.

    optimised: whether LLVM improves the text before it is compiled. That keeps every bit, unless
    the text itself lets it contract products and sums.
    """
    text = f"; optimised, with vectors: {optimised}\n{text}"
    digest = hashlib.sha256(text.encode()).hexdigest()
    with _compiling:
        if digest not in _machines:
            _machines[digest] = Machine(text, digest, optimised)
        return _machines[digest]


_machines: dict[str, Machine] = {}


class Machine:
    """The functions of a text."""

    def __init__(self, text: str, digest: str, optimised: bool = False) -> None:
        self._engine = _engine(_object_code(text, digest, optimised))  # it holds the machine code

    def function(self, name: str, arguments: int) -> Any:
        """A function of pointers, which holds its machine code; other threads of Python run
        meanwhile."""
        function = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * arguments)(self.address(name))
        function.machine = self  # type: ignore[attr-defined]
        return function

    def address(self, name: str) -> int:
        return int(self._engine.get_function_address(name))


def padded(count: int) -> int:
    """The least number of columns for `count` points."""
    return -(-count // LANES) * LANES


def columns(rows: Array, stride: int) -> Array:
    """Points, one a row, as columns; the places that are left are repetitions of the last. rows:
    shape (points, numbers). The columns have the shape (numbers, stride): a row of the leaf's
    argument is one number at all points, so that a vector register takes several points."""
    out = np.empty((rows.shape[1], stride))
    out[:, : len(rows)] = rows.T
    out[:, len(rows) :] = rows[-1][:, np.newaxis]
    return out


def _repeated(values: Array, stride: int) -> Array:
    rows = np.empty((max(len(values), 1), stride))
    rows[: len(values)] = values[:, np.newaxis]
    return rows


def _symbol(name: str) -> str:
    return f"holdfast_{name}"  # unlike the names of libraries, which the linker finds too


@cache
def _machine() -> Any:
    """This processor, as LLVM has it."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


def _target() -> Any:
    cpu, features = _processor()
    return _machine().create_target_machine(
        cpu=cpu, features=features, opt=2, codemodel="jitdefault", jit=True
    )


@cache
def _processor() -> tuple[str, str]:
    """The name and the instruction sets of this processor: code for another one is not run here."""
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def _object_code(text: str, digest: str, optimised: bool = False) -> bytes:
    version = ".".join(map(str, llvm.llvm_version_info))
    key = (llvmlite.__version__, version, *_processor())
    stored = Stored("leaf", digest)
    code = stored.load(key)
    if code is None:
        module = llvm.parse_assembly(text)
        target = _target()
        module.triple = target.triple
        module.data_layout = str(target.target_data)
        module.verify()
        if optimised:
            optimise(module, target)
        code = target.emit_object(module)
        stored.save(key, code)
    return code


def optimise(module: Any, target: Any) -> None:
    """Inlined functions, variables in registers, several nodes at a time.

    Unrolling took four times as long to compile, and was no faster.
    """
    options = llvm.create_pipeline_tuning_options(2)
    options.loop_vectorization = True
    options.slp_vectorization = options.loop_unrolling = False
    builder = llvm.create_pass_builder(target, options)
    builder.getModulePassManager().run(module, builder)


def _engine(code: bytes) -> Any:
    target = _target()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


class Evaluator:
    """values(points)[i, j] = expressions[j] at points[i].

    `arguments` are the symbols of the columns of `points`. `parameters` give the values of their
    symbols unless `overrides` replaces them; of two with one name the last counts. Raises
    `DefinitionError` for an expression with any other symbol, `SimulationError` for points of
    another shape.
    """

    def __init__(
        self,
        expressions: Sequence[Any],
        arguments: Sequence[Any],
        parameters: Sequence[Parameter],
    ) -> None:
        self.count, self.width = len(expressions), len(arguments)
        self.parameters = tuple({q.name: q for q in parameters}.values())
        arrays = {"q": list(arguments), "p": [q.symbol for q in self.parameters]}
        self._leaves = compiled_leaves({"values": leaf_of(arrays, expressions)})

    def values(self, points: Array, overrides: Mapping[str, float] | None = None) -> Array:
        """The values at points of shape (count, arguments), shape (count, expressions)."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.width:
            raise SimulationError(
                f"points have the shape {points.shape}", expected=f"(count, {self.width})"
            )
        chosen = {q.name: q.value for q in self.parameters} | dict(overrides or {})
        numbers = np.array(list(chosen.values()), dtype=np.float64)
        return self._leaves.values("values", len(points), self.count, points, numbers)
