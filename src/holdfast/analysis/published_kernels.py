"""Kernels by reference: of the store, of a folder beside a paper, or of an address on the web."""

from __future__ import annotations

import contextlib
import shutil
import urllib.parse
import urllib.request
from dataclasses import replace
from http.client import HTTPException
from pathlib import Path
from typing import Any

from holdfast.analysis.kernel_index import (
    INDEX,
    NAME,
    Entry,
    check_digest,
    check_size,
    copied,
    found_in,
    index_of,
    is_file_of,
)
from holdfast.analysis.kernel_store import STORE_VARIABLE, Store
from holdfast.errors import OutputError
from holdfast.host.output import make_folder
from holdfast.host.reading import MOST_TEXT as MOST_INDEX
from holdfast.host.reading import read_small_text
from holdfast.host.writing import atomic_file

OF_STORE = "store:"
WEB = ("http://", "https://")
PATIENCE = 30.0
"""Seconds without an answer after which a download is given up."""


def is_reference(text: str) -> bool:
    """Whether a text names a kernel of a store or of an index, and not a file."""
    return text.startswith((OF_STORE, *WEB)) or "#" in text


def referred(text: str, store: Store | None = None) -> Path:
    """The file that a reference stands for: store:NAME, FOLDER#NAME or https://...#NAME.

    A file that does not exist, and whose name could be one of the store, is looked for there.
    """
    store = store or Store()
    if text.startswith(OF_STORE):
        return store.path(text.removeprefix(OF_STORE))
    if is_reference(text) and not Path(text).exists():
        return fetched(text, store)
    if NAME.fullmatch(text) and not text.endswith(".nc") and not Path(text).exists():
        with contextlib.suppress(OutputError):
            return store.path(text)
    return Path(text)


def fetched(address: str, store: Store) -> Path:
    """The file of a published kernel, kept in the store and checked.

    address: FOLDER#NAME or http(s)://...#NAME, where the folder has an index; without #NAME the
    index has one kernel. What was fetched before is not fetched again.
    """
    where, _, name = address.partition("#")
    remote = where.startswith(("http://", "https://"))
    where = where.removesuffix(INDEX).rstrip("/")
    source = f"{where}/{INDEX}"
    if not remote and not Path(where).is_dir():
        raise OutputError(
            f"{where} is not a folder of published kernels",
            expected="FOLDER#NAME; a file is named alone, without #",
        )
    text = _downloaded_text(source) if remote else read_small_text(source)
    entries = index_of(text, source)
    if not name and len(entries) != 1:
        raise OutputError(
            f"{source} has {len(entries)} kernels",
            expected=f"{where}#NAME, one of: {', '.join(sorted(entries)[:10])}",
        )
    entry = found_in(entries, name, source) if name else next(iter(entries.values()))
    if not remote:
        path = Path(where) / entry.file
        check_size(path, entry)
        check_digest(path, entry)
        return path
    kept = store.folder / entry.file
    if is_file_of(kept, entry):
        return kept
    make_folder(store.folder, STORE_VARIABLE)
    _check_space(store.folder, entry)
    with atomic_file(kept) as partial, partial.open("wb") as file:
        with _opened(f"{where}/{entry.file}") as answer:
            try:
                digest = copied(answer, file, entry.bytes)
            except (OSError, HTTPException) as error:
                raise _offline(f"{where}/{entry.file}", error) from None
        if file.tell() != entry.bytes or digest != entry.sha256:
            raise OutputError(
                f"{where}/{entry.file} has not the digest that its index gives",
                expected=f"{entry.bytes:,} bytes with SHA-256 {entry.sha256[:12]}...",
                remedy="fetch it again; if that fails, tell its author",
            )
    with contextlib.suppress(OutputError):  # a name that is taken: it is found by its digest
        store.add(kept, entry)
        return kept
    store.add(kept, replace(entry, name=f"{entry.name[:60]}-{entry.sha256[:12]}"))
    return kept


def _check_space(folder: Path, entry: Entry) -> None:
    free = shutil.disk_usage(folder).free
    if entry.bytes > free:
        raise OutputError(
            f"kernel '{entry.name}' has {entry.bytes / 2**30:.3g} GiB, and {folder} has room for "
            f"{free / 2**30:.3g}",
            remedy=f"make room, or set {STORE_VARIABLE} to another disk",
        )


def _downloaded_text(address: str) -> str:
    with _opened(address) as answer:
        try:
            data = answer.read(MOST_INDEX + 1)
        except (OSError, HTTPException) as error:
            raise _offline(address, error) from None
    if len(data) > MOST_INDEX:
        raise OutputError(f"{address} is too large", expected=f"at most {MOST_INDEX >> 20} MiB")
    return str(data, "utf-8", "replace")


def _opened(address: str) -> Any:
    try:
        parts = urllib.parse.urlsplit(address)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError("no http(s) address")
        return urllib.request.urlopen(address, timeout=PATIENCE)
    except (OSError, ValueError, HTTPException) as error:
        raise _offline(address, error) from None


def _offline(address: str, error: Exception) -> OutputError:
    reason = getattr(error, "reason", None) or error
    return OutputError(
        f"{address} cannot be fetched ({reason})",
        remedy="check the address and the network; kernels that were fetched before need none",
    )
