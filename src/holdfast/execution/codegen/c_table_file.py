"""The table of an exported law in a file of its own, and the C that loads it.

The file is a header, which the C repeats byte by byte, and the numbers in the order of the grid:

| bytes | what |
|---|---|
| 8 | "HFTABLE" and a zero |
| 4 | the version of this layout, 1 |
| 4 | bytes of a number: 4 or 8 |
| 8 | the number of axes |
| 8 | how many numbers there are |
| 32 | the SHA-256 of the numbers |
| 8 each | the nodes of every axis |

Whole numbers and numbers are little-endian; zeros fill the header up to a multiple of 64 bytes.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.arguments import checked
from holdfast.errors import DefinitionError
from holdfast.execution.arrays import AnyArray
from holdfast.execution.codegen.c_text import c_file
from holdfast.execution.table_in_parts import in_turn
from holdfast.host.writing import atomic_file
from holdfast.maths.definitions.law import Law
from holdfast.maths.definitions.lookup import CellLookup, Lookup
from holdfast.maths.definitions.switching import Switching

LAYOUT = 1
DIGEST = 32
"""Where in the header the digest begins."""

MOST_AS_TEXT = 2**16
"""Numbers up to which `holdfast export-c` writes a table into the source."""

FAULTS = {
    "READY": "the table can be used",
    "NOT_FOUND": "the file cannot be opened",
    "TRUNCATED": "the file is shorter or longer than the table",
    "NONE": "the file is no table",
    "VERSION": "the table has another layout",
    "BYTE_ORDER": "this processor is not little-endian",
    "OTHER": "the table is that of another law",
    "DAMAGED": "the numbers are not those that were written",
    "ALIGNMENT": "the memory begins at an address at which such numbers cannot",
    "MEMORY": "there is no memory for the table",
}
"""What NAME_load and NAME_use answer, in the order of their numbers."""

INCLUDES = """#if defined(__unix__) || defined(__APPLE__)
#define HF_MAPS
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#else
#include <stdio.h>
#include <stdlib.h>
#endif"""


@checked
def export_c_table(law: Law | Switching, path: str | Path) -> Path:
    """Write the table of the law, for what `export_c(..., table="file")` wrote.

    Raises `DefinitionError` for a law without the table of a kernel, and `OutputError` where the
    file cannot be written.
    """
    if law.lookup is None or isinstance(law.lookup, CellLookup):
        raise DefinitionError(
            f"law '{law.name}' has no kernel", expected="the law of a kernel, whose table is large"
        )
    path = Path(path)
    with atomic_file(path) as partial, partial.open("wb") as file:
        file.write(header_of(law.lookup))
        for values in _numbers(law.lookup):
            file.write(_bytes(values))
    return path


def numbers_of(lookup: Lookup | None) -> int:
    """How many numbers the table of a kernel has; 0 without one."""
    if lookup is None or isinstance(lookup, CellLookup):
        return 0
    table: Any = lookup.table
    return int(np.prod([int(n) for n in table[3]]))


def header_of(lookup: Lookup) -> bytes:
    """The bytes before the numbers."""
    table: Any = lookup.table
    shape, digest = [int(n) for n in table[3]], hashlib.sha256()
    for values in _numbers(lookup):
        digest.update(_bytes(values))
    size, count = table[0].dtype.itemsize, numbers_of(lookup)
    said = struct.pack("<8sIIQQ", b"HFTABLE\0", LAYOUT, size, len(shape), count)
    text = said + digest.digest() + struct.pack(f"<{len(shape)}Q", *shape)
    return text + bytes(-len(text) % 64)


def loader(lookup: Lookup, name: str) -> str:
    """The C that loads the table, its names without the prefix of the law."""
    header = header_of(lookup)
    rows = (", ".join(map(str, header[k : k + 16])) for k in range(0, len(header), 16))
    count = numbers_of(lookup)
    return (
        f"{_fits(count)}#define HF_HEADER {len(header)}\n#define HF_DIGEST {DIGEST}\n"
        f"#define HF_COUNT ((size_t){count}u)\n"
        f"static const unsigned char hf_header[HF_HEADER] = {{\n    "
        + ",\n    ".join(rows)
        + "\n};\n"
        + _named(c_file("table"), name)
    )


def declarations(name: str) -> list[str]:
    """What the header says of loading."""
    text = [f"    NAME_TABLE_{fault}, /* {said} */" for fault, said in FAULTS.items()]
    lines = [
        "/* The table of the law is in a file. NAME_load opens it, NAME_use takes it from memory",
        "   that stays (flash, say). Each answers one of these; unless READY, NAME_step gives NAN.",
        "   The file is mapped: while it is loaded nobody may write to it; another one may be",
        "   given its name (rename), and be loaded then.",
        "   With NAME_LINKED defined as a path, the table is linked, and NAME_load takes that. */",
        "enum {",
        *text,
        "};",
        "int NAME_load(const char *path);",
        "int NAME_use(const void *memory, size_t size);",
        "void NAME_unload(void);",
        "",
    ]
    return _named("\n".join(lines), name).split("\n")


def _fits(count: int) -> str:
    """That whole numbers of C can count the numbers of a table."""
    if count < 2**31:
        return ""
    error = f"this table of {count} numbers needs a long of 64 bits"
    return f"#include <limits.h>\n#if LONG_MAX < {count}\n#error {error}\n#endif\n"


def _named(text: str, name: str) -> str:
    for part in ("TABLE_", "LINKED"):
        text = text.replace(f"NAME_{part}", f"{name.upper()}_{part}")
    return text.replace("NAME_", f"{name}_")


def _numbers(lookup: Lookup) -> Iterator[AnyArray]:
    """The numbers of the table, little-endian, in parts."""
    table: Any = lookup.table
    for part in in_turn(table[0]):
        values = np.ascontiguousarray(part)
        yield values.astype(values.dtype.newbyteorder("<"), copy=False)


def _bytes(values: AnyArray) -> memoryview:
    """The bytes of an array, without a copy."""
    return memoryview(values.view(np.uint8).data)
