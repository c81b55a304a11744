"""A store of kernels: value functions by the digest of their file, with names.

A store is a folder with an index, `index.json`, and the files, each under its SHA-256. `publish`
makes such a folder of some of them, to be put beside a paper: on a disk, or behind http(s). What an
index says is not trusted: a name is looked up in it and nothing else, and a file is read only when
it has the size and the digest that the index gives.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import platformdirs

from holdfast.analysis.kernel_index import (
    INDEX,
    SHA,
    Entry,
    check_digest,
    check_name,
    check_size,
    found_in,
    index_of,
    index_text,
    is_file_of,
    pieces,
)
from holdfast.errors import HoldfastError, OutputError
from holdfast.host.output import make_folder
from holdfast.host.reading import MOST_TEXT as MOST_INDEX
from holdfast.host.reading import check_file, read_small_text
from holdfast.host.writing import atomic_file, not_written

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
        for own in self.entries().values():
            if own.sha256 == entry.sha256:
                with contextlib.suppress(OutputError):
                    check_size(self.folder / own.file, own)
                    return own
        return None

    def unnamed(self) -> list[Path]:
        """Files that no name has: of a process that was killed, or of a download that stopped."""
        known = {e.file for e in self.entries().values()}
        found = sorted(self.folder.iterdir()) if os.path.isdir(self.folder) else []
        alone = [p for p in found if p.suffix == ".nc" and SHA.fullmatch(p.stem)]
        parts = [p for p in found if p.suffix == PART and SHA.fullmatch(p.stem[1:])]
        return [p for p in alone if p.name not in known] + parts

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

    def take(self, part: Path, entry: Entry) -> Entry:
        """Move a file that was checked into the store.

        It gets its name or, where another kernel has that, the beginning of its digest behind it.
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
