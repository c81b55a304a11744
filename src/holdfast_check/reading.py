"""What the file of a certificate says, and whether every part of it has its form."""

from __future__ import annotations

import array
import base64
import hashlib
import itertools
import json
import math
import os
import struct
import sys
import zlib
from collections.abc import Sequence
from typing import Any

from holdfast_check.intervals import Expression

MAGICS = ("holdfast-certificate 1", "holdfast-flowpipe 1")
MOST_OF_ENTRIES, MOST_OF_NODES, ROOM, LITTLE = 16, 64, 1 << 20, 1 << 16
OPTIONAL = {"depth": 0, "steps": 1, "halves": 0, "enclosure": ""}
"""What a header need not say; with which enclosures cells were found matters to no proof."""

Values = dict[str, Any]


class NotValidError(Exception):
    """Where and why a certificate does not prove what it says."""


def content_of(path: str) -> bytes:
    """All of a file, which is no device."""
    if not os.path.isfile(path):
        raise OSError("it is no file")
    with open(path, "rb") as file:
        return file.read()


def read(content: bytes) -> tuple[Values, list[Any]]:
    """What a file says: its header, and entries of a cell, the number of its input, and a level; of
    a flowpipe, whose header has a start, how small its steps are.

    Raises `NotValidError` if a bit of it is not as it was written.
    """
    first, _, rest = content.partition(b"\n")
    words = first.decode("ascii", "replace").split(" ")
    if (magic := " ".join(words[:2])) not in MAGICS or len(words) != 3:
        raise NotValidError("it is not a certificate of this version")
    if hashlib.sha256(rest).hexdigest() != words[2]:
        raise NotValidError("it was changed: its digest is not that of its content")
    text, _, packed = rest.partition(b"\n")
    try:
        said = json.loads(text, object_pairs_hook=_once)
    except RecursionError:
        raise NotValidError("the header is nested too deep") from None
    pipe = magic == MAGICS[1]
    header = formed(said if pipe else OPTIONAL | said, FLOWPIPE if pipe else HEADER, "the header")
    count, packing = max(header["entries"], 0), "<B" if pipe else "<IHI"
    numbers = _unpacked(packed, MOST_OF_ENTRIES, LITTLE if pipe else ROOM)
    if len(numbers) != struct.calcsize(packing) * count or count < 1:
        raise NotValidError(f"it has not the {count} entries that it says, or none")
    return header, list(struct.iter_unpack(packing, numbers))


def _once(pairs: Any) -> Values:
    if len(dict(pairs)) < len(pairs):
        raise NotValidError("a key of the header stands twice")
    return dict(pairs)


def formed(value: Any, form: Any, where: str) -> Any:
    """What a file says there, if it has this form.

    That is {key: form}, {...: form} of any keys, [form] of any length, [form, form] of two values,
    (none, form, what none means), a type, or a function that fails for what it does not read.
    """
    match form:
        case dict() if type(value) is dict and form.keys() in ({...}, value.keys()):
            return {k: formed(v, form.get(k) or form[...], k) for k, v in value.items()}
        case list() if type(value) is list and len(form) in (1, len(value)):
            return [formed(v, f, where) for v, f in zip(value, itertools.cycle(form))]
        case tuple([none, other, meaning]):
            return meaning if value == none else formed(value, other, where)
        case _ if type(value) is form:
            return value
        case _ if callable(form) and form not in (str, int, bool):
            try:
                return form(value)
            except Exception as error:  # whatever a file contains
                raise NotValidError(f"{where} is {value!r:.60}: {error}") from None
    odd = [*value.keys() ^ form.keys()] if type(value) is type(form) is dict else value
    raise NotValidError(f"{where} has another form: {odd!r:.60}")


def _number(text: str) -> float:
    if math.isfinite(value := float.fromhex(text)):
        return value
    raise ValueError("it is not finite")


def _unpacked(packed: bytes, times: int, room: int = ROOM) -> bytes:
    """What is packed: so many times as long at most, so that a small file takes little memory."""
    most = times * len(packed) + room
    numbers = zlib.decompressobj().decompress(packed, most + 1)
    if len(numbers) > most:
        raise NotValidError(f"it unpacks to more than {times} times its length")
    return numbers


def _nodes(text: str) -> Sequence[float]:
    numbers = array.array("d", _unpacked(base64.b64decode(text), MOST_OF_NODES))
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


ENDS, NAMED = [_number, _number], {"name": str, "unit": str}
RANGED, LIMIT = NAMED | {"range": ENDS}, NAMED | {"expression": Expression}
TABLE = {"axes": [[Expression, ENDS, int, bool]], "nodes": {...: [_nodes, _nodes]}}
PROGRAM = {
    "wanted": (None, [Expression], None), "rows": [[Expression]], "hard": int,
    "scales": [Expression], "limits": [Expression], "box": (None, [[Expression, Expression]], None),
}  # fmt: skip


def _inputs(value: Any) -> Any:
    """Of an option: what it gives, or the program of a safeguard."""
    return formed(value, PROGRAM if type(value) is dict else [Expression], "an option")


LAW: Values = {
    "names": [str], "initial": int, "modes": [[[[Expression], _inputs, int]]],
    "parts": [[_number]], "under_way": [ENDS],
    "table": (None, TABLE, {"axes": [], "nodes": {}}),
}  # fmt: skip
NO_LAW = {key: [] for key in LAW} | {"initial": 0, "table": LAW["table"][2]}
COMMON = {
    "title": str, "states": [NAMED], "inputs": [NAMED], "disturbances": [RANGED],
    "parameters": [RANGED], "rates": [Expression], "constraints": [LIMIT], "target": [LIMIT],
    "law": ([], LAW, NO_LAW), "hold": _number, "errors": [_number], "entries": int,
}  # fmt: skip
HEADER = COMMON | {
    "delay": _number, "holds": (None, int, None), "edges": [[_number]], "periodic": [bool],
    "candidates": [[_number]], "depth": int, "steps": int, "halves": int,
    "enclosure": str, "cells_in_region": int, "cells_kept": int,
}  # fmt: skip
FLOWPIPE = COMMON | {
    "holds": int, "start": [ENDS], "degrees": [int, int], "splits": [int],
}  # fmt: skip
