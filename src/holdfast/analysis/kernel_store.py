"""A store of kernels: value functions by the digest of their file, with names.

A store is a folder with an index, `index.json`, and the files, each under its SHA-256. `publish`
makes such a folder of some of them, to be put beside a paper: on a disk, or behind http(s). What an
index says is not trusted: a name is looked up in it and nothing else, and a file is read only when
it has the size and the digest that the index gives.

The index has an entry a kernel, each checked as it is read.

A kernel is referred to by the place that it is in: the store, a folder beside a paper, or an
address on the web. Files from the web are fetched on from where a download stopped, and checked by
their digest.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from http.client import HTTPException
from pathlib import Path
from typing import IO, Any

import platformdirs

from holdfast.analysis.decomposition.parts_value import PartsValue
from holdfast.analysis.reachability.value_function import ValueFunction
from holdfast.errors import HoldfastError, OutputError
from holdfast.host.files import MOST_TEXT as MOST_INDEX
from holdfast.host.files import atomic_file, check_file, make_folder, not_written, read_small_text

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
    entries: dict[str, Entry] = {}
    for kernel in kernels if isinstance(kernels, list) else [None]:
        entry = _entry(kernel, where)
        if entry.name in entries:
            raise OutputError(f"{where} has two kernels '{entry.name}'", expected="one of a name")
        entries[entry.name] = entry
    return entries


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
    names = ", ".join(sorted(entries)[:10])
    raise OutputError(f"{where} has no kernel '{name[:80]}'", expected=f"one of: {names}")


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
    if (digest := digest_of(path)) != entry.sha256:
        raise OutputError(
            f"the file of kernel '{entry.name}' has the SHA-256 {digest[:12]}... ({path})",
            expected=f"{entry.sha256[:12]}...",
            remedy="remove the kernel, and add or fetch it again",
        )


def _entry(fields: Any, where: str) -> Entry:
    expected = "name, sha256, bytes, problem, licence, citation"
    try:
        entry = Entry(**fields)
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


STORE_VARIABLE = "HOLDFAST_STORE"
"""Environment variable that moves the store."""

PART = ".part"
"""The end of the name of a file that is being fetched: the digest is before it, and a dot first."""


class Store:
    """The kernels in a folder, by default that of `HOLDFAST_STORE` or of this user's data."""

    def __init__(self, folder: str | Path | None = None) -> None:
        chosen = folder or os.environ.get(STORE_VARIABLE)
        default = Path(platformdirs.user_data_dir("holdfast")) / "kernels"
        self.folder = Path(chosen) if chosen else default
        self.option = "FOLDER" if folder else STORE_VARIABLE

    def entries(self) -> dict[str, Entry]:
        """The kernels by name."""
        path = self.folder / INDEX
        try:
            os.stat(path)
        except FileNotFoundError:
            return {}
        except NotADirectoryError:
            raise OutputError(
                f"the store {self.folder} is not a folder",
                remedy=f"let {STORE_VARIABLE} name a folder",
            ) from None
        except (OSError, ValueError) as error:
            raise OutputError(f"the store {self.folder} cannot be read ({error})") from None
        try:
            return index_of(read_small_text(path), str(path))
        except HoldfastError as error:
            raise OutputError(error.cause, expected=error.expected, remedy=error.remedy) from None

    def entry(self, name: str) -> Entry:
        """The kernel of that name, or of a digest that begins so (8 characters or more)."""
        return found_in(self.entries(), name, str(self.folder))

    def path(self, name: str) -> Path:
        """The file of a kernel, which is there and has its size; `verify` reads it."""
        entry = self.entry(name)
        path = self.folder / entry.file
        check_size(path, entry)
        return path

    def kept(self, entry: Entry) -> Entry | None:
        """The entry here of the same file, which is there and has its size; None without one."""
        for stored in self.entries().values():
            if stored.sha256 == entry.sha256:
                with contextlib.suppress(OutputError):
                    check_size(self.folder / stored.file, stored)
                    return stored
        return None

    def unnamed(self) -> list[Path]:
        """Files that no name has: of a process that was killed, or of a download that stopped."""
        named = {e.file for e in self.entries().values()}
        files = sorted(self.folder.iterdir()) if os.path.isdir(self.folder) else []
        alone = [p for p in files if p.suffix == ".nc" and SHA.fullmatch(p.stem)]
        parts = [p for p in files if p.suffix == PART and SHA.fullmatch(p.stem[1:])]
        return [p for p in alone if p.name not in named] + parts

    def add(self, path: str | Path, entry: Entry) -> Entry:
        """Keep a file under a name. The entry's digest and bytes are those of the file.

        A licence and a citation of the same file under this name stay where the entry has none.

        Raises `OutputError` for a name that another file has, and for a folder that cannot be
        written.
        """
        check_name(entry.name)
        path = Path(path)
        check_file(path)
        make_folder(self.folder, self.option)
        with self.alone():
            entries = self.entries()
            before = entries.get(entry.name)
            if before and before.sha256 != entry.sha256:
                raise OutputError(
                    f"{self.folder} has another kernel '{entry.name}' ({before.sha256[:12]})",
                    remedy="choose another name, or remove that one first",
                )
            if before:
                texts = {n: getattr(entry, n) or getattr(before, n) for n in _TEXTS}
                entry = replace(entry, **texts)
            if not is_file_of(self.folder / entry.file, entry):
                self._copy(path, entry)
            self._write({**entries, entry.name: entry})
        return entry

    def take(self, file: IO[bytes], part: Path, entry: Entry) -> Entry:
        """Move a file that was checked, open and locked at `part`, into the store.

        It gets its name or, where another kernel has that, the beginning of its digest behind it.
        It is locked no more when the index has it: HDF5 reads no file that is.
        """
        with self.alone():
            entries = self.entries()
            names = [entry.name, *(f"{entry.name[:40]}-{entry.sha256[:n]}" for n in (12, 39))]
            free = [n for n in names if n not in entries or entries[n].sha256 == entry.sha256]
            if not free:
                raise OutputError(f"{self.folder} has other kernels '{names[-1]}'")
            entry = replace(entry, name=free[0])
            try:
                os.replace(part, self.folder / entry.file)
            except OSError as error:
                raise not_written(self.folder / entry.file, error, self.option) from None
            unlocked(file.fileno())
            self._write({**entries, entry.name: entry})
        return entry

    def remove(self, name: str) -> Entry:
        """Forget a name; its file too, if no other name has it."""
        with self.alone():
            entry = self.entry(name)
            rest = {n: e for n, e in self.entries().items() if n != entry.name}
            self._write(rest)
            if all(e.sha256 != entry.sha256 for e in rest.values()):
                (self.folder / entry.file).unlink(missing_ok=True)
        return entry

    def verify(self, name: str) -> Entry:
        """Read the file of a kernel as a whole; `OutputError` where it is not what was added."""
        entry = self.entry(name)
        path = self.folder / entry.file
        check_size(path, entry)
        check_digest(path, entry)
        return entry

    def publish(self, names: Sequence[str], folder: str | Path) -> Path:
        """A folder with these kernels and their index, to be read as a store from anywhere."""
        other = Store(folder)
        if other.folder.resolve() == self.folder.resolve():
            raise OutputError(f"{folder} is the store itself", expected="another folder")
        for entry in [self.verify(name) for name in names]:
            other.add(self.folder / entry.file, entry)
        return other.folder / INDEX

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """While no other process changes this store."""
        if not os.path.isdir(self.folder):
            raise OutputError(f"there is no store {self.folder}", remedy="holdfast store add FILE")
        try:
            lock = (self.folder / ".lock").open("a")
            locked(lock.fileno())
        except OSError as error:
            raise OutputError(
                f"the store {self.folder} cannot be written ({error.strerror})",
                remedy=f"choose another with {self.option}",
            ) from None
        with lock:
            yield

    def _copy(self, path: Path, entry: Entry) -> None:
        digest = hashlib.sha256()
        with (
            atomic_file(self.folder / entry.file, option=self.option) as partial,
            path.open("rb") as source,
            partial.open("wb") as copy,
        ):
            for piece in pieces(source, entry.bytes):
                copy.write(piece)
                digest.update(piece)
            if digest.hexdigest() != entry.sha256:
                raise OutputError(
                    f"{path} is not the file of kernel '{entry.name}'",
                    expected=f"SHA-256 {entry.sha256[:12]}...",
                    remedy="add it again, if it changed while it was read",
                )

    def _write(self, entries: Mapping[str, Entry]) -> None:
        text = index_text(entries)
        if len(text) > MOST_INDEX:
            raise OutputError(
                f"the index of {self.folder} would be larger than {MOST_INDEX >> 20} MiB",
                remedy="shorten --licence and --citation, or remove kernels",
            )
        with atomic_file(self.folder / INDEX, option=self.option) as partial:
            partial.write_text(text, "utf-8")


_TEXTS = ("licence", "citation")


def locked(file: int) -> None:
    """Wait until no other process has this open file locked, and lock it until it is closed."""
    with contextlib.suppress(ImportError):  # elsewhere the index is still whole
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX)


def unlocked(file: int) -> None:
    """Have others lock or read this open file."""
    with contextlib.suppress(ImportError):
        import fcntl

        fcntl.flock(file, fcntl.LOCK_UN)


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
                stored = store.kept(entry)
            if stored:
                part.unlink()
                return stored
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
            return store.take(file, part, entry)
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
    content_range = answer.headers.get("Content-Range", "")
    if answer.status == PARTIAL and not (begin and content_range.startswith(f"bytes {begin}-")):
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
    stored = store.kept(entry) or downloaded(f"{where}/{entry.file}", entry, store)
    return store.folder / stored.file, stored


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
