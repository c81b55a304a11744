"""The cache of what was computed once: compiled code, of which only this user's is executed, and
games; damaged files are computed again.

Machine code can do anything that its writer wants. A folder that other users may write to is
therefore not used, nor a file of another user. Every file begins with the digest of
its content, so that a truncated one is compiled again.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from functools import cache
from importlib import resources
from pathlib import Path

import platformdirs

from holdfast.errors import CacheWarning, OutputError
from holdfast.host.files import atomic_file, discarded_at_the_end

ROOM = 20 * 2**20
"""Bytes of free space required: compiled code of a few closed loops."""

CACHE_VARIABLE = "HOLDFAST_CACHE_DIR"
"""Environment variable that moves the cache."""

PRIVATE = 0o600


def cache_directory() -> Path:
    """The folder of compiled code and of games, created if missing, for this user only.

    A default cache that cannot be written, or that others may write to, is replaced by a temporary
    folder for this process; a cache set by the user is then an `OutputError`.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    path = Path(chosen) if chosen else Path(platformdirs.user_cache_dir("holdfast"))
    try:
        path = path.resolve()
        _make_private(path)
        with tempfile.TemporaryFile(dir=path):
            pass
        if shutil.disk_usage(path).free < ROOM:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        reason = distrust(path)
    except (OSError, RuntimeError) as error:  # RuntimeError: a link to itself
        if chosen:
            raise OutputError(
                f"the cache folder {path} cannot be written "
                f"({getattr(error, 'strerror', None) or error})",
                remedy=f"set {CACHE_VARIABLE} to a folder that can",
            ) from None
        return _temporary()
    if not reason:
        return path
    cause = f"the cache folder {path} is not used: {reason}, and its content is executed"
    remedy = f"remove that permission (chmod go-w), or set {CACHE_VARIABLE} to a folder of your own"
    if chosen:
        raise OutputError(cause, remedy=remedy)
    _warn_once(f"{cause}; every run compiles anew; {remedy}")
    return _temporary()


def distrust(folder: Path) -> str:
    """The reason why others could change the folder's content; "" if they cannot."""
    if not hasattr(os, "geteuid"):
        return ""
    me = os.geteuid()
    for place in (folder, *folder.parents):
        status = place.stat()
        if status.st_uid != me and (place == folder or status.st_uid != 0):
            return f"{place} belongs to another user"
        shared = (
            stat.S_ISVTX & status.st_mode and place != folder
        )  # as /tmp: each user owns his files there
        if _others_write(status) and not shared:
            return f"others may write to {place}"
    return ""


def _others_write(status: os.stat_result) -> bool:
    if status.st_mode & stat.S_IWOTH:
        return True
    return bool(status.st_mode & stat.S_IWGRP) and not _own_group(status.st_gid)


@cache
def _own_group(number: int) -> bool:
    """Whether the group contains only this user or the administrator."""
    import grp
    import pwd

    try:
        me, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(number)
    except KeyError:
        return False
    alone = set(group.gr_mem) <= {me.pw_name, "root"}
    return alone and number == me.pw_gid and group.gr_name in (me.pw_name, "root")


def _make_private(path: Path) -> None:
    for place in reversed((path, *path.parents)):
        if not place.exists():
            place.mkdir(mode=0o700, exist_ok=True)
    path.mkdir(exist_ok=True)  # raises an error if it is not a folder


@cache
def _temporary() -> Path:
    return discarded_at_the_end(Path(tempfile.mkdtemp(prefix="holdfast-")))


@cache
def _warn_once(message: str) -> None:
    warnings.warn(message, CacheWarning, stacklevel=2)


@cache
def code_digest(room: str = ".") -> str:
    """A digest of the code that results depend on, or of one room of it, so that another version
    computes them anew."""
    digest = hashlib.sha256()
    for path in sorted((Path(str(resources.files("holdfast"))) / room).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class Stored:
    """Data on disk, by the digest of what it follows from: of machine code its text and the
    machine."""

    def __init__(self, name: str, stamp: str) -> None:
        self.name = "".join(c if c.isalnum() or c in "._-" else "_" for c in name)
        self.stamp = stamp

    def _place(self, key: object) -> tuple[Path, bytes]:
        """The path of the file, and the key of its content."""
        about = f"{self.name}\n{self.stamp}\n{key!r}".encode()
        digest = hashlib.sha256(about).hexdigest()[:24]
        return cache_directory() / f"{self.name}-{digest}.code", about

    def load(self, key: object) -> bytes | None:
        """The saved data; None if the file is missing or cannot be trusted."""
        path, about = self._place(key)
        try:
            with path.open("rb") as file:
                status = os.fstat(file.fileno())
                if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
                    return None
                if _others_write(status) and os.name != "nt":
                    return None
                digest, data = file.read(hashlib.sha256().digest_size), file.read()
        except OSError:
            return None
        if hashlib.sha256(about + data).digest() != digest:
            return None
        return data

    def save(self, key: object, data: bytes) -> None:
        """Save the data for the next process; without space for it the next computes them again."""
        path, about = self._place(key)
        try:
            with atomic_file(path, PRIVATE) as partial:
                partial.write_bytes(hashlib.sha256(about + data).digest() + data)
        except OutputError:
            return
