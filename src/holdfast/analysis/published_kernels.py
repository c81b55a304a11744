"""Kernels by reference: of the store, of a folder beside a paper, or of an address on the web."""

from __future__ import annotations

import os
from pathlib import Path

from holdfast.analysis.kernel_download import downloaded, downloaded_text
from holdfast.analysis.kernel_index import (
    INDEX,
    NAME,
    Entry,
    check_digest,
    check_size,
    found_in,
    index_of,
)
from holdfast.analysis.kernel_store import Store
from holdfast.errors import OutputError
from holdfast.host.reading import MOST_TEXT as MOST_INDEX
from holdfast.host.reading import read_small_text

OF_STORE = "store:"
WEB = ("http://", "https://")


def is_reference(text: str) -> bool:
    """Whether a text names a kernel of a store or of an index, and not a file."""
    if text.startswith((OF_STORE, *WEB)):
        return True
    _, mark, name = text.rpartition("#")
    return bool(mark) and not (name and _is_no_name(name))


def referred(text: str, store: Store | None = None) -> Path:
    """The file that a reference stands for: store:NAME, FOLDER#NAME or https://...#NAME.

    A file that does not exist, and whose name could be one of the store, is looked for there.
    """
    return found(text, store or Store())[0]


def found(text: str, store: Store) -> tuple[Path, Entry | None]:
    """The file of a reference and what its index says; None for a file of no index."""
    if text.startswith(OF_STORE):
        name = text.removeprefix(OF_STORE)
        return store.path(name), store.entry(name)
    if text.startswith(WEB):
        return _fetched(text, store)
    if os.path.exists(text):
        return Path(text), None
    if is_reference(text):
        return _beside(text)
    if not _is_no_name(text) and _is_in(store, text):
        return store.path(text), store.entry(text)
    return Path(text), None


def _beside(reference: str) -> tuple[Path, Entry]:
    """A kernel of a folder with an index, which is read there once for its digest."""
    where, _, name = reference.rpartition("#")
    if not os.path.isdir(where):
        raise OutputError(
            f"{where} is not a folder of published kernels",
            expected="FOLDER#NAME; a file is named alone, without #",
        )
    source = f"{where}/{INDEX}"
    entry = _chosen(read_small_text(source), source, where, name)
    path = Path(where) / entry.file
    check_size(path, entry)
    check_digest(path, entry)
    return path, entry


def _fetched(address: str, store: Store) -> tuple[Path, Entry]:
    """A kernel of the web, kept in the store. What was fetched before is not fetched again.

    address: http(s)://...#NAME; without #NAME the index has one kernel.
    """
    where, _, name = address.partition("#")
    where = where.removesuffix(INDEX).rstrip("/")
    source = f"{where}/{INDEX}"
    entry = _chosen(downloaded_text(source, MOST_INDEX), source, where, name)
    own = store.kept(entry) or downloaded(f"{where}/{entry.file}", entry, store)
    return store.folder / own.file, own


def _chosen(text: str, source: str, where: str, name: str) -> Entry:
    entries = index_of(text, source)
    if name:
        return found_in(entries, name, source)
    if len(entries) != 1:
        raise OutputError(
            f"{source} has {len(entries)} kernels",
            expected=f"{where}#NAME, one of: {', '.join(sorted(entries)[:10])}",
        )
    return next(iter(entries.values()))


def _is_no_name(text: str) -> bool:
    """Whether a text can be no name and no digest of a kernel."""
    return not NAME.fullmatch(text) or text.endswith(".nc")


def _is_in(store: Store, name: str) -> bool:
    """Whether a store can be read and has a kernel of that name or digest."""
    try:
        store.entry(name)
    except OutputError:
        return False
    return True
