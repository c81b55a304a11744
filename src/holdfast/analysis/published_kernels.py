"""Kernels by reference: of the store, of a folder beside a paper, or of an address on the web.

Files from the web are fetched on from where a download stopped, and checked by their digest.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from http.client import HTTPException
from pathlib import Path
from typing import IO, Any

from holdfast.analysis.kernel_store import (
    INDEX,
    NAME,
    PART,
    PIECE,
    STORE_VARIABLE,
    Entry,
    Store,
    check_digest,
    check_size,
    found_in,
    index_of,
    locked,
    pieces,
)
from holdfast.errors import OutputError
from holdfast.host.reading import MOST_TEXT as MOST_INDEX
from holdfast.host.reading import read_small_text
from holdfast.host.writing import make_folder, not_written

PATIENCE = 30.0
"""Seconds without an answer after which a download is given up."""

PARTIAL, NOTHING_MORE = 206, 416
"""Answers of a server: what follows is a part; there is nothing from that byte on."""


def downloaded_text(address: str, most: int) -> str:
    """The text at an address, of at most so many bytes."""
    with _opened(address) as answer:
        data = b"".join(_received(answer, address, most))
    if len(data) > most:
        raise OutputError(f"{address} is too large", expected=f"at most {most >> 20} MiB")
    return str(data, "utf-8", "replace")


def downloaded(address: str, entry: Entry, store: Store) -> Entry:
    """The kernel at an address, moved into the store once it has the size and the digest.

    What came before a download stopped is kept, and the next one asks the server for the rest.

    Raises `OutputError` where the file cannot be fetched or written, and for another file than that
    of the entry, of which nothing is kept.
    """
    make_folder(store.folder, STORE_VARIABLE)
    part = store.folder / f".{entry.sha256}{PART}"
    try:
        with _alone_with(part) as file:
            with store.alone():  # who fetched it may not have written the index yet
                own = store.kept(entry)
            if own:
                part.unlink()
                return own
            _check_space(store.folder, entry, file.seek(0, os.SEEK_END))
            digest = _continued(address, entry, file)
            if file.tell() < entry.bytes:
                raise OutputError(
                    f"{address} ended after {file.tell():,} of {entry.bytes:,} bytes",
                    remedy="fetch it again: it goes on from there",
                )
            if file.tell() > entry.bytes or digest != entry.sha256:
                part.unlink()
                raise OutputError(
                    f"{address} has not the digest that its index gives",
                    expected=f"{entry.bytes:,} bytes with SHA-256 {entry.sha256[:12]}...",
                    remedy="fetch it again; if that fails, tell its author",
                )
            os.fsync(file.fileno())
            return store.take(part, entry)
    except OSError as error:
        raise not_written(part, error, STORE_VARIABLE) from None


def _continued(address: str, entry: Entry, file: IO[bytes]) -> str:
    """Append what is missing to a file; the digest of all of it."""
    digest, have = hashlib.sha256(), 0
    file.seek(0)
    while piece := file.read(PIECE):
        digest.update(piece)
        have += len(piece)
    if have > entry.bytes:
        file.truncate(0)
        digest, have = hashlib.sha256(), 0
    if have == entry.bytes:
        return digest.hexdigest()
    with _opened(address, have) as answer:
        if have and answer.status != PARTIAL:  # all of it comes again
            file.truncate(0)
            digest, have = hashlib.sha256(), 0
        for piece in _received(answer, address, entry.bytes - have):
            file.write(piece)
            digest.update(piece)
    file.seek(0, os.SEEK_END)
    return digest.hexdigest()


@contextlib.contextmanager
def _alone_with(part: Path) -> Iterator[IO[bytes]]:
    """A file to append to, which no other process writes."""
    while True:
        with part.open("a+b") as file:
            locked(file.fileno())
            if _is_at(file, part):  # and no other process took it meanwhile
                yield file
                return


def _is_at(file: IO[bytes], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _check_space(folder: Path, entry: Entry, have: int) -> None:
    free = shutil.disk_usage(folder).free
    if entry.bytes - have > free:
        raise OutputError(
            f"kernel '{entry.name}' has {entry.bytes / 2**30:.3g} GiB, and {folder} has room for "
            f"{free / 2**30:.3g}",
            remedy=f"make room, or set {STORE_VARIABLE} to another disk",
        )


def _opened(address: str, begin: int = 0) -> Any:
    """The answer of a server: of all, or from a byte on where it can."""
    try:
        parts = urllib.parse.urlsplit(address)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError("no http(s) address")
        headers = {"Range": f"bytes={begin}-"} if begin else {}
        request = urllib.request.Request(address, headers=headers)
        answer = urllib.request.urlopen(request, timeout=PATIENCE)
    except (OSError, ValueError, HTTPException) as error:
        if begin and getattr(error, "code", 0) == NOTHING_MORE:
            return _opened(address)
        raise _offline(address, error) from None
    told = answer.headers.get("Content-Range", "")
    if answer.status == PARTIAL and not (begin and told.startswith(f"bytes {begin}-")):
        answer.close()
        if begin:
            return _opened(address)
        raise _offline(address, ValueError("it answers with a part"))
    return answer


def _received(answer: Any, address: str, most: int) -> Iterator[bytes]:
    try:
        yield from pieces(answer, most)
    except (OSError, HTTPException) as error:
        raise _offline(address, error) from None


def _offline(address: str, error: Exception) -> OutputError:
    reason = getattr(error, "reason", None) or error
    return OutputError(
        f"{address} cannot be fetched ({reason})",
        remedy="check the address and the network; what is in the store needs none (store:NAME)",
    )


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
