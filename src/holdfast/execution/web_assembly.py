"""A simulation loop with its leaves as one module of WebAssembly, for a browser.

LLVM makes an object file of one module, in which every function, type and address has its final
number already, so that no linker is needed: the object is a module that lacks its exports. The
memory, the stack pointer and the table of functions are imports.

Operations of WebAssembly are those of IEEE 754, and none is fused: a run has the very bits of
`simulate`.

The format: WebAssembly Core Specification 2.0 (W3C), section 5; the symbols of an object: the tool
conventions of WebAssembly, "Linking".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import llvmlite.binding as llvm

from holdfast.errors import HoldfastError
from holdfast.execution.codegen.llvm_text import Leaf, leaves_text
from holdfast.execution.codegen.scalar_llvm import LEAF, scalars_text
from holdfast.execution.codegen.scalar_reader import scalars
from holdfast.execution.leaf import optimise
from holdfast.execution.simulation.built_loop import SINGLE, Loop

LANES = 2
"""Values of a step that are computed together: one register of WebAssembly."""

STACK = 1 << 20
"""Where the stack begins, and grows down from, in the memory; constants lie below it."""

FEATURES = "+simd128,+bulk-memory,+nontrapping-fptoint,+sign-ext,+mutable-globals"

_ROOT = re.compile(r"^define void @(holdfast_\w+)\(", re.MULTILINE)
_CUSTOM, _IMPORT, _EXPORT, _ELEMENTS, _CONSTANTS = 0, 2, 7, 9, 11
_FUNCTIONS, _MEMORY, _TABLE, _GLOBAL = 0, 2, 1, 3
_SYMBOLS, _DATA, _SECTION, _UNDEFINED, _NAMED = 8, 1, 3, 0x10, 0x40


def web_module(loop: Loop, leaves: Mapping[str, Leaf], exported: Sequence[str] = ()) -> bytes:
    """The module of a loop that calls its leaves by their names, and of these leaves.

    It exports the functions of the loop (`simulation/loop.py`) of (w, s, 0, stop), places in the
    memory, and the leaves `exported` as `leaf_NAME` (see `Leaf`), of a multiple of `LANES` columns.
    """
    every = {LEAF + name: leaf for name, leaf in {**leaves, **loop.leaves}.items()}
    roots = [*_ROOT.findall(loop.text), *(LEAF + name for name in exported)]
    texts = [loop.text, leaves_text(every, LANES)]
    for part in (name for name in loop.called if LEAF + name not in every):
        plain = part.removesuffix(SINGLE)
        text = scalars_text(scalars("simulation/parts"), [plain], single=plain != part)
        texts.append(text.replace(f"@{plain}(", f"@{part}("))
    return _with_exports(_object(_joined(texts, roots)), roots)


def _joined(texts: Sequence[str], roots: Sequence[str]) -> str:
    """One text: what is declared twice stands once, and functions that are no roots are its own."""
    declared: set[str] = set()
    lines = []
    for line in "\n".join(texts).splitlines():
        if line.startswith("declare"):
            if line in declared:
                continue
            declared.add(line)
        name = re.match(r"define void @(\w+)\(", line)
        if name is not None and name[1] not in roots:
            line = line.replace("define void", "define internal void", 1)
        lines.append(line)
    return "\n".join(lines)


@cache
def _machine() -> Any:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        target = llvm.Target.from_triple("wasm32-unknown-unknown")
    except RuntimeError:
        raise HoldfastError(
            "this LLVM has no WebAssembly", remedy="install llvmlite from its wheel"
        ) from None
    return target.create_target_machine(cpu="generic", features=FEATURES, opt=2, reloc="static")


def _object(text: str) -> bytes:
    machine, module = _machine(), llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    module.verify()
    optimise(module, machine)
    code: bytes = machine.emit_object(module)
    return code


# -- the exports of an object --------------------------------------------------------------------


def _with_exports(content: bytes, names: Sequence[str]) -> bytes:
    """The object as a module that exports these functions; what is for a linker is left out."""
    sections = list(_sections(content))
    _check_memory(dict(sections))
    numbers = {n: k for kind, body in sections if kind == _CUSTOM for n, k in _functions(body)}
    _check_imports(b"".join(body for kind, body in sections if kind == _IMPORT))
    entries = [_string(n) + bytes([_FUNCTIONS]) + _number(numbers[n]) for n in names]
    exports = _EXPORT, _number(len(entries)) + b"".join(entries)
    parts = [s for s in sections if s[0] != _CUSTOM]
    before = sum(kind < _EXPORT for kind, _ in parts)
    parts.insert(before, exports)
    return content[:8] + b"".join(bytes([k]) + _number(len(b)) + b for k, b in parts)


def _check_memory(sections: Mapping[int, bytes]) -> None:
    """Raises `HoldfastError` for addresses of functions, and constants that the stack may reach."""
    if _ELEMENTS in sections:
        raise HoldfastError("the module has a table of functions, which nothing fills")
    read = _Reader(sections.get(_CONSTANTS, b"\0"))
    for _ in range(read.number()):
        if read.number() != 0 or read.byte() != 0x41:  # active, at a constant number
            raise HoldfastError("the module has constants at no fixed place")
        first, _, size = read.number(), read.byte(), read.number()
        read.bytes(size)
        if first + size > STACK // 4:
            raise HoldfastError(f"the module has {first + size} bytes of constants")


def _check_imports(body: bytes) -> None:
    """Raises `HoldfastError` for a function that is not in the module."""
    read = _Reader(body)
    for _ in range(read.number()):
        module, name, kind = read.string(), read.string(), read.byte()
        if kind == _FUNCTIONS:
            raise HoldfastError(f"the module lacks the function {module}.{name}")
        if kind == _GLOBAL:
            read.bytes(2)
            continue
        if kind == _TABLE:
            read.byte()
        for _ in range(1 + (read.byte() & 1)):
            read.number()


def _functions(body: bytes) -> Iterator[tuple[str, int]]:
    """The functions of a module by name, from its section of symbols."""
    read = _Reader(body)
    if read.string() != "linking":
        return
    read.number()
    while read.more:
        kind, inner = read.byte(), _Reader(read.bytes(read.number()))
        for _ in range(inner.number() if kind == _SYMBOLS else 0):
            of, flags = inner.byte(), inner.number()
            if of == _SECTION:
                inner.number()
            elif of == _DATA:
                inner.string()
                if not flags & _UNDEFINED:
                    for _ in range(3):
                        inner.number()
            else:
                number = inner.number()
                name = inner.string() if flags & _NAMED or not flags & _UNDEFINED else ""
                if of == _FUNCTIONS:
                    yield name, number


def _sections(content: bytes) -> Iterator[tuple[int, bytes]]:
    read = _Reader(content[8:])
    while read.more:
        yield read.byte(), read.bytes(read.number())


class _Reader:
    """Numbers (LEB128), strings and bytes, in turn."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0

    @property
    def more(self) -> bool:
        return self.at < len(self.content)

    def byte(self) -> int:
        return self.bytes(1)[0]

    def bytes(self, count: int) -> bytes:
        self.at += count
        return self.content[self.at - count : self.at]

    def number(self) -> int:
        bits = shift = 0
        while (one := self.byte()) & 0x80:
            bits |= (one & 0x7F) << shift
            shift += 7
        return bits | one << shift

    def string(self) -> str:
        return self.bytes(self.number()).decode()


def _number(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def _string(text: str) -> bytes:
    return _number(len(text)) + text.encode()
