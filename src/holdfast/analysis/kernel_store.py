"""A store of kernels: value functions by the digest of their file, with names.

A store is a folder with an index, `index.json`, and the files, each under its SHA-256. `publish`
makes such a folder of some of them, to be put beside a paper: on a disk, or behind http(s). What an
index says is not trusted: a name is looked up in it and nothing else, and a file is read only when
it has the size and the digest that the index gives.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import platformdirs

from holdfast.analysis.kernel_index import (
    INDEX,
    Entry,
    check_digest,
    check_name,
    check_size,
    copied,
    found_in,
    index_of,
    index_text,
    is_file_of,
)
from holdfast.errors import OutputError
from holdfast.host.output import make_folder
from holdfast.host.reading import check_file, read_small_text
from holdfast.host.writing import atomic_file

STORE_VARIABLE = "HOLDFAST_STORE"
"""Environment variable that moves the store."""


class Store:
    """The kernels in a folder, by default that of `HOLDFAST_STORE` or of this user's data."""

    def __init__(self, folder: str | Path | None = None) -> None:
        chosen = folder or os.environ.get(STORE_VARIABLE)
        default = Path(platformdirs.user_data_dir("holdfast")) / "kernels"
        self.folder = Path(chosen) if chosen else default

    def entries(self) -> dict[str, Entry]:
        """The kernels by name."""
        path = self.folder / INDEX
        if self.folder.exists() and not self.folder.is_dir():
            raise OutputError(
                f"the store {self.folder} is not a folder",
                remedy=f"let {STORE_VARIABLE} name a folder",
            )
        if not path.exists():
            return {}
        return index_of(read_small_text(path), str(path))

    def entry(self, name: str) -> Entry:
        """The kernel of that name, or of a digest that begins so (8 characters or more)."""
        return found_in(self.entries(), name, str(self.folder))

    def path(self, name: str) -> Path:
        """The file of a kernel, which is there and has its size; `verify` reads it."""
        entry = self.entry(name)
        path = self.folder / entry.file
        check_size(path, entry)
        return path

    def add(self, path: str | Path, entry: Entry) -> Entry:
        """Keep a file under a name. The entry's digest and bytes are those of the file.

        Raises `OutputError` for a name that another file has, and for a folder that cannot be
        written.
        """
        check_name(entry.name)
        path = Path(path)
        check_file(path)
        make_folder(self.folder, STORE_VARIABLE)
        with self._alone():
            entries = self.entries()
            before = entries.get(entry.name)
            if before and before.sha256 != entry.sha256:
                raise OutputError(
                    f"the store has another kernel '{entry.name}' ({before.sha256[:12]})",
                    remedy="choose another name, or remove that one first",
                )
            target = self.folder / entry.file
            if not is_file_of(target, entry):
                with (
                    atomic_file(target) as partial,
                    path.open("rb") as source,
                    partial.open("wb") as copy,
                ):
                    if copied(source, copy, entry.bytes) != entry.sha256:
                        raise OutputError(
                            f"{path} is not the file of kernel '{entry.name}'",
                            expected=f"SHA-256 {entry.sha256[:12]}...",
                            remedy="add it again, if it changed while it was read",
                        )
            self._write({**entries, entry.name: entry})
        return entry

    def remove(self, name: str) -> Entry:
        """Forget a name; its file too, if no other name has it."""
        with self._alone():
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
        for name in names:
            entry = self.verify(name)
            other.add(self.folder / entry.file, entry)
        return other.folder / INDEX

    def _write(self, entries: Mapping[str, Entry]) -> None:
        with atomic_file(self.folder / INDEX) as partial:
            partial.write_text(index_text(entries), "utf-8")

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """While no other process changes this store."""
        if not self.folder.is_dir():
            raise OutputError(f"there is no store {self.folder}", remedy="holdfast store add FILE")
        try:
            lock = (self.folder / ".lock").open("a")
        except OSError as error:
            raise OutputError(
                f"the store {self.folder} cannot be written ({error.strerror})",
                remedy=f"set {STORE_VARIABLE} to a folder that can",
            ) from None
        with lock:
            with contextlib.suppress(ImportError):  # elsewhere the index is still whole
                import fcntl

                fcntl.flock(lock, fcntl.LOCK_EX)
            yield
