"""The index of a store of kernels: an entry a kernel, each checked as it is read."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import HoldfastError, OutputError
from holdfast.host.reading import check_file

INDEX, LAYOUT = "index.json", 1
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
SHA = re.compile(r"[0-9a-f]{64}")
PIECE = 1 << 20

LARGEST = 1 << 62
"""Bytes that a file may have."""

DEEPEST = 6
"""Levels of tables and lists in what an entry says of its problem."""


@dataclass(frozen=True)
class Entry:
    """A kernel of a store: its file by SHA-256 and bytes, and what it is of.

    problem: what the file says of its problem: kind, system, region, the digest of the system's
    definition, grid, scenario. licence, citation: text for those who use it.
    """

    name: str
    sha256: str
    bytes: int
    problem: Mapping[str, Any] = field(default_factory=dict)
    licence: str = ""
    citation: str = ""

    @property
    def file(self) -> str:
        """The name of its file in a store."""
        return f"{self.sha256}.nc"


def check_name(name: str) -> None:
    """Refuse a name that could be a path, a digest or an option."""
    if not NAME.fullmatch(name) or SHA.fullmatch(name) or name.endswith(".nc"):
        raise OutputError(
            f"'{name[:80]}' is no name of a kernel",
            expected="letters, digits, '-', '_' and '.', the first a letter or a digit, at most 80",
        )


def index_of(text: str, where: str) -> dict[str, Entry]:
    """The kernels of an index, each entry checked; `OutputError` where it is not one."""
    try:
        said = json.loads(text)
        layout, kernels = said["holdfast_store"], said["kernels"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(
            f"{where} is no index of kernels", expected="one that `holdfast store publish` wrote"
        ) from None
    if layout != LAYOUT:
        raise OutputError(f"{where} has the layout {layout!r:.20}", expected=f"layout {LAYOUT}")
    found: dict[str, Entry] = {}
    for given in kernels if isinstance(kernels, list) else [None]:
        entry = _entry(given, where)
        if entry.name in found:
            raise OutputError(f"{where} has two kernels '{entry.name}'", expected="one of a name")
        found[entry.name] = entry
    return found


def found_in(entries: Mapping[str, Entry], name: str, where: str) -> Entry:
    """The entry of that name, or of the beginning of a digest."""
    if name in entries:
        return entries[name]
    if re.fullmatch(r"[0-9a-f]{8,64}", name):
        same = [e for e in entries.values() if e.sha256.startswith(name)]
        if len({e.sha256 for e in same}) == 1:
            return same[0]
    if not entries:
        raise OutputError(f"{where} has no kernels", remedy="holdfast store add FILE --name NAME")
    known = ", ".join(sorted(entries)[:10])
    raise OutputError(f"{where} has no kernel '{name[:80]}'", expected=f"one of: {known}")


def index_text(entries: Mapping[str, Entry]) -> str:
    """The text of an index."""
    kernels = [vars(entries[n]) for n in sorted(entries)]
    return json.dumps({"holdfast_store": LAYOUT, "kernels": kernels}, indent=2) + "\n"


def entry_of(
    path: Path, value: ValueFunction | PartsValue, name: str, licence: str = "", citation: str = ""
) -> Entry:
    """The entry of a file, which is read once for its digest."""
    check_name(name)
    try:
        problem = _problem(value)
        said = json.loads(json.dumps(problem))
    except (TypeError, ValueError, AttributeError, RecursionError) as error:
        raise OutputError(f"what {path} says of its problem cannot be read ({error})") from None
    if not _is_flat(said):
        raise OutputError(f"what {path} says of its problem has too many levels")
    return Entry(name, digest_of(path), path.stat().st_size, said, licence, citation)


def _problem(value: ValueFunction | PartsValue) -> dict[str, Any]:
    """What a value is of, with a digest of that, and what was found."""
    posed = _posed(value)
    text = json.dumps(posed, sort_keys=True)
    report = (value.values[0] if isinstance(value, PartsValue) else value).report
    return posed | {
        "digest": hashlib.sha256(text.encode()).hexdigest(),
        "converged": value.converged if isinstance(value, PartsValue) else report.converged,
        "scenario": report.scenario,
        "holdfast_version": report.holdfast_version,
    }


def _posed(value: ValueFunction | PartsValue) -> dict[str, Any]:
    """What a value is of."""
    if isinstance(value, PartsValue):
        whole = value.decomposition
        return {
            "kind": whole.kind, "system": whole.system.name, "verdict": whole.verdict,
            "parts": [_posed(v) for v in value.values],
        }  # fmt: skip
    report = value.report
    grid = {a.name: [a.low, a.high, a.count, a.ends] for a in value.grid.axes}
    return {
        "kind": report.kind, "system": report.system, "definition": report.definition,
        "region": report.region, "parameters": dict(report.parameters),
        "disturbance": dict(report.disturbance), "grid": grid, "horizon_s": report.horizon_s,
        "scheme": report.scheme, "precision": report.precision,
    }  # fmt: skip


def digest_of(path: Path) -> str:
    """The SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_size(path: Path, entry: Entry) -> None:
    """Refuse a file that is missing or of another size."""
    try:
        check_file(path)
        size = path.stat().st_size
    except (HoldfastError, OSError):
        raise OutputError(
            f"the file of kernel '{entry.name}' is missing ({path})", remedy="add or fetch it again"
        ) from None
    if size != entry.bytes:
        raise OutputError(
            f"the file of kernel '{entry.name}' has {size:,} bytes ({path})",
            expected=f"{entry.bytes:,}",
            remedy="remove the kernel, and add or fetch it again",
        )


def check_digest(path: Path, entry: Entry) -> None:
    """Refuse a file with another digest."""
    if (found := digest_of(path)) != entry.sha256:
        raise OutputError(
            f"the file of kernel '{entry.name}' has the SHA-256 {found[:12]}... ({path})",
            expected=f"{entry.sha256[:12]}...",
            remedy="remove the kernel, and add or fetch it again",
        )


def _entry(given: Any, where: str) -> Entry:
    expected = "name, sha256, bytes, problem, licence, citation"
    try:
        entry = Entry(**given)
        texts = (entry.name, entry.sha256, entry.licence, entry.citation)
        fits = all(isinstance(t, str) for t in texts) and isinstance(entry.problem, dict)
        fits = fits and type(entry.bytes) is int and 0 < entry.bytes < LARGEST
        fits = fits and SHA.fullmatch(entry.sha256) is not None and _is_flat(entry.problem)
    except TypeError:
        fits = False
    if not fits:
        raise OutputError(f"{where} has an entry that is no kernel", expected=expected)
    check_name(entry.name)
    return entry


def _is_flat(said: Any, levels: int = DEEPEST) -> bool:
    """Whether tables and lists are not within one another without end."""
    if not isinstance(said, dict | list):
        return True
    parts = said.values() if isinstance(said, dict) else said
    return levels > 0 and all(_is_flat(p, levels - 1) for p in parts)


def is_file_of(path: Path, entry: Entry) -> bool:
    """Whether a file is there and is the one of the entry."""
    return path.is_file() and path.stat().st_size == entry.bytes and digest_of(path) == entry.sha256


def pieces(source: IO[bytes], most: int) -> Iterator[bytes]:
    """What can be read, piece by piece: `most` bytes, and one more if there are more."""
    left = most + 1
    while left and (piece := source.read(min(PIECE, left))):
        yield piece
        left -= len(piece)
