"""The handwritten C parts of an exported law, and the table of a kernel as C."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from importlib.resources import files
from typing import Any

import numpy as np

from holdfast.maths.definitions.lookup import Lookup


def c_name(name: str) -> str:
    """The name as a C identifier: underscores for other characters, law_ before a digit."""
    return re.sub(r"^(?=\d|$)", "law_", re.sub(r"\W", "_", name, flags=re.ASCII))


def c_file(name: str) -> str:
    """The text of a file of this package's folder `c`."""
    return (files("holdfast.execution.codegen") / "c" / f"{name}.c").read_text("utf-8")


def c_needed(name: str, text: str) -> str:
    """The functions of such a file that the text calls, directly or through others.

    Compilers warn of unused functions. Blank lines stand only between functions.
    """
    found: list[str] = []
    for block in reversed(c_file(name).split("\n\n")):
        defined = re.search(r"^static .*?(\w+)\(", block, re.MULTILINE)
        if defined and re.search(rf"\b{defined[1]}\(", text):
            found.insert(0, block.rstrip("\n"))
            text += block
    return "".join(f"{block}\n\n" for block in found)


def c_own(text: str, name: str) -> str:
    """The text with the law's name as a prefix of every name of this package: hf_, HF_."""
    return re.sub(r"\bHF_", f"{name.upper()}_HF_", re.sub(r"\bhf_", f"{name}_hf_", text))


def c_comment(*lines: str) -> str:
    """The lines as a C comment; sequences that would end it are replaced."""
    plain = [
        re.sub(r"\?(?=\?)", "? ", " ".join(x.split()).replace("*/", "* /").replace("/*", "/ *"))
        for x in lines
    ]
    if len(plain) == 1:
        return f"/* {plain[0]} */"
    return "/* " + "\n".join([plain[0], *(f" * {x}".rstrip() for x in plain[1:]), " */"])


def c_table(lookup: Lookup) -> str:
    """The grid and the values of a table, for the functions of `interpolate.py`."""
    table: Any = lookup.table
    values, low, steps, shape, periodic = table
    single = values.dtype == np.float32
    n = len(shape)
    return (
        f"typedef {'float' if single else 'double'} hf_table;\n"
        f"static const double hf_low[{n}] = {{{_listed(low)}}};\n"
        f"static const double hf_steps[{n}] = {{{_listed(steps)}}};\n"
        f"static const long hf_shape[{n}] = {{{', '.join(str(int(k)) for k in shape)}}};\n"
        f"static const long hf_periodic[{n}] = {{{', '.join(str(int(k)) for k in periodic)}}};\n"
        f"static const hf_table hf_values[{len(values)}] = {{\n"
        f"{_listed(values)}\n}};\n"
    )


def _listed(values: Iterable[Any]) -> str:
    """The numbers of an array, eight per line."""
    texts = [_number(v) for v in values]
    return ",\n".join(", ".join(texts[k : k + 8]) for k in range(0, len(texts), 8))


def _number(value: Any) -> str:
    """The shortest text that reads back as this number."""
    if math.isfinite(value):
        return f"{value!s}f" if isinstance(value, np.float32) else repr(float(value))
    return "NAN" if math.isnan(value) else ("INFINITY" if value > 0 else "-INFINITY")
