"""The handwritten C parts of an exported law, its names and its comments."""

from __future__ import annotations

import re
from importlib.resources import files


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
