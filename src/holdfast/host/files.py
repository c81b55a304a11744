"""Atomic writing of files and folders of results: complete under their names or absent.

A file is written beside its place under the name of the process that writes it, and renamed at the
end. What a killed process leaves is removed by the next process that writes to the same folder.

Folders of results are checked before the work.

Files of the user are read if they are regular, of bounded size, never a device or a pipe; from the
web what the user asked for.

A cache has what was computed once: compiled code, of which only this user's is executed, and games.
Machine code can do anything that its writer wants. A folder that other users may write to is
therefore not used, nor a file of another user. Every file of the cache begins with the digest of
its content, so that a truncated one is compiled again.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import socket
import stat
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Protocol, TypeVar

import platformdirs

from holdfast.errors import CacheWarning, OutputError, ScenarioError

T = TypeVar("T")

LITTLE = 1 << 20
"""Bytes: a disk with less free space than this counts as full."""

LONGEST = 80
"""Bytes of the final name that are kept in the temporary name."""

_HOST = re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname())[:60] or "host"
_LEFT_OVER = re.compile(r"\..*\.by-(?P<host>\w+)-(?P<process>\d+)-[0-9a-f]{16}\.partial")
_unfinished: set[Path] = set()
_folders_made: set[Path] = set()
_one_at_a_time = threading.RLock()
_thread = threading.local()


class atomic_file:
    """Context manager: a temporary path beside `path`, renamed to it on success only.

    The target of a link is replaced, not the link; a device, a pipe or a folder is refused. The
    file is on the disk before it has its name, so that a power cut leaves the old one or the new.
    option: what chooses another folder, for messages.
    """

    def __init__(self, path: Path, mode: int = 0o666, option: str = "--out") -> None:
        self.path = path.resolve()  # follows a link to its target
        self.mode, self.option = mode, option

    def __enter__(self) -> Path:
        if self.path.exists() and not self.path.is_file():
            raise self._refusal(OSError("it exists and is not a regular file"))
        remove_left_over(self.path.parent)
        name = self.path.name.encode()[:LONGEST].decode(errors="ignore")
        token = secrets.token_hex(8)
        self.partial = self.path.with_name(f".{name}.by-{_HOST}-{os.getpid()}-{token}.partial")
        _unfinished.add(self.partial)  # registered first: an interruption may come at any time
        try:
            os.close(os.open(self.partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY, self.mode))
        except OSError as error:
            _unfinished.discard(self.partial)
            raise self._refusal(error) from None
        return self.partial

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        try:
            if problem is None:
                _on_disk(self.partial)
                os.replace(self.partial, self.path)
        except OSError as error:
            raise self._refusal(error) from None
        finally:
            self._discard()
        if isinstance(problem, OSError):
            raise self._refusal(problem) from None
        if problem is not None and str(problem).startswith("NetCDF: "):
            raise self._refusal(problem) from None

    def _refusal(self, problem: BaseException) -> OutputError:
        return not_written(self.path, problem, self.option)

    def _discard(self) -> None:
        self.partial.unlink(missing_ok=True)
        _unfinished.discard(self.partial)


def _on_disk(path: Path) -> None:
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def remove_left_over(folder: Path) -> None:
    """Remove the unfinished files of processes of this machine that have ended."""
    try:
        matches = [_LEFT_OVER.fullmatch(entry) for entry in os.listdir(folder)]
    except OSError:
        return  # the attempt to write there reports it
    for match in matches:  # of thousands of names few are left over
        if match is None or match["host"] != _HOST or (path := folder / match[0]) in _unfinished:
            continue
        process = int(match["process"])
        if process == os.getpid() or not _is_running(process):
            try:
                path.unlink(missing_ok=True)
            except OSError:
                continue  # owned by another user


def _is_running(process: int) -> bool:
    if os.name == "nt":  # signal 0 does not test for existence there
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def discarded_at_the_end(folder: Path) -> Path:
    """A temporary folder, removed when the process ends."""
    _unfinished.add(folder)
    return folder


def kept_at_the_end(folder: Path) -> None:
    """It is complete, or there no longer."""
    _unfinished.discard(folder)


@atexit.register
def discard_unfinished() -> None:
    """Remove every file that this process has not finished, and every folder that it made and that
    is empty; called when the process ends."""
    for path in list(_unfinished):
        try:
            path.unlink(missing_ok=True)
        except OSError:
            shutil.rmtree(path, ignore_errors=True)
    for folder in sorted(_folders_made, reverse=True):  # those within others first
        with contextlib.suppress(OSError):
            folder.rmdir()


def undisturbed(work: Callable[[], T]) -> T:
    """Run `work` in a thread that no signal interrupts, and return its result.

    Work with NetCDF files is done here: an exception between two locks of HDF5 would leave them
    taken for ever, and HDF5 crashes where two threads use it, so that one work is done at a time.
    Work that is asked for by another work is a part of it. An interruption is raised here as soon
    as the work is done.
    """
    if getattr(_thread, "works", False):
        return work()
    answers: list[T] = []
    failures: list[BaseException] = []
    done = threading.Lock()
    done.acquire()

    def run() -> None:
        _thread.works = True
        try:
            with _one_at_a_time:
                answers.append(work())
        except BaseException as error:
            failures.append(error)
        finally:
            done.release()

    threading.Thread(target=run, name="holdfast-undisturbed", daemon=True).start()
    interruption: BaseException | None = None
    while True:
        try:
            while not (answers or failures):
                done.acquire(timeout=0.1)
            break
        except BaseException as error:
            interruption = error
    if interruption is not None:
        raise interruption
    if failures:
        raise failures[0]
    return answers[0]


if hasattr(os, "register_at_fork"):  # a fork waits for the work, which no thread of it would end
    os.register_at_fork(
        before=_one_at_a_time.acquire,
        after_in_parent=_one_at_a_time.release,
        after_in_child=_one_at_a_time.release,
    )


def not_written(path: Path, problem: BaseException, option: str = "--out") -> OutputError:
    """The error of a file that cannot be written.

    HDF5 does not report why it failed; a full disk is the likely reason.
    """
    reason = getattr(problem, "strerror", None) or str(problem)
    free = shutil.disk_usage(path.parent).free if path.parent.exists() else LITTLE
    if free < LITTLE:
        reason += f"; the disk has {free / 1024:.0f} KiB left"
    return OutputError(
        f"{path} cannot be written ({reason})",
        remedy=f"make room, or choose another folder with {option}",
    )


class Saves(Protocol):
    """An object that writes itself to a file."""

    def save(self, path: Path) -> Path: ...


def check_writable(folder: Path, option: str = "--out") -> None:
    """Find out before the work whether the folder can be made and written."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        raise OutputError(
            f"the folder {folder} cannot be written "
            f"({place} is not a folder, or belongs to another user)",
            remedy=f"choose another with {option}",
        )


def make_folder(folder: Path, option: str = "--out") -> None:
    """Make a folder of results, before the work; one that stays empty is removed again."""
    absolute = folder.absolute()
    try:
        missing = [place for place in (absolute, *absolute.parents) if not place.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        _folders_made.update(missing)
    except OSError as error:
        raise OutputError(
            f"the folder {folder} cannot be made ({error.strerror})",
            remedy=f"choose another with {option}",
        ) from None


def saved(result: Saves, path: Path) -> Path:
    """The file; where it cannot be written the result is not lost, but beside other such."""
    try:
        return result.save(path)
    except OutputError as error:
        spare = Path(tempfile.mkdtemp(prefix="holdfast-")) / path.name
        try:
            result.save(spare)
        except OutputError:
            raise error from None
        raise OutputError(error.cause, remedy=f"the results are in {spare}") from None


def write_summary(path: Path, said: dict[str, Any]) -> Path:
    return write_text(path, json.dumps(said, indent=2) + "\n")


def write_text(path: Path, text: str) -> Path:
    """The file with this text, whole or not at all."""
    with atomic_file(path) as partial:
        partial.write_text(text, "utf-8")
    return path


MOST_TEXT = 10 * 2**20
"""Bytes of a text file: a scenario takes a few thousand."""

FETCH_VARIABLE = "HOLDFAST_FETCH"
"""Environment variable, 1 where scenarios may fetch what they name from the web."""


def scenarios_may_fetch() -> bool:
    """Whether a scenario, which may be a stranger's, opens addresses that it names."""
    return os.environ.get(FETCH_VARIABLE, "") == "1"


def check_file(path: str | Path) -> None:
    """Refuse a path that is missing or is not a regular file, after following links."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError) as error:  # ValueError: a NUL character in the name
        reason = getattr(error, "strerror", None) or "not a valid file name"
        raise ScenarioError(f"{path}: cannot be read ({reason})") from None
    if not stat.S_ISREG(mode):
        raise ScenarioError(f"{path}: cannot be read ({_kind(mode)})", expected="a file")


def read_small_text(path: str | Path, most: int = MOST_TEXT) -> str:
    """The text of a file in UTF-8, with or without a byte order mark.

    Raises `ScenarioError` if the path cannot be read, is not a regular file, is not text or is too
    """
    check_file(path)
    try:
        with open(path, "rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > most:
        size = os.stat(path).st_size / 2**20
        raise ScenarioError(
            f"{path}: is too large ({size:,.0f} MiB)", expected=f"at most {most // 2**20} MiB"
        )
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except ValueError:
        raise ScenarioError(f"{path}: is not a text file in UTF-8") from None


def _kind(mode: int) -> str:
    for kind, name in (
        (stat.S_ISDIR, "it is a folder"),
        (stat.S_ISFIFO, "it is a pipe"),
        (stat.S_ISCHR, "it is a device"),
        (stat.S_ISBLK, "it is a device"),
        (stat.S_ISSOCK, "it is a socket"),
    ):
        if kind(mode):
            return name
    return "it is not a file"


ROOM = 20 * 2**20
"""Bytes of free space required: compiled code of a few closed loops."""

CACHE_VARIABLE = "HOLDFAST_CACHE_DIR"
"""Environment variable that moves the cache."""

PRIVATE = 0o600


def cache_directory() -> Path:
    """The folder of compiled code and of games, created if missing, for this user only.

    A cache that cannot be written, and a default one that others may write to, is replaced by a
    temporary folder for this process; what the user chose, and others may write to, is an
    `OutputError`.
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
            _warn_once(
                f"the cache folder {path} cannot be written "
                f"({getattr(error, 'strerror', None) or error}); every run compiles anew; set "
                f"{CACHE_VARIABLE} to a folder that can"
            )
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


_BEGUN = time.time() - 0.02  # the times of files are up to some hundredths of a second behind


@cache
def version_digest(room: str = ".") -> str:
    """A digest of the files of the code, or of one room of it: of two processes the same version
    has the same."""
    digest = hashlib.sha256()
    for source in _sources(room):
        digest.update(source.read_bytes())
    return digest.hexdigest()


@cache
def code_digest(room: str = ".") -> str:
    """A digest of the code that stored results depend on, so that another version computes them
    anew.

    Where a file was edited after this process had begun, it may be no text of the code that runs:
    the digest is then one that no other process has.
    """
    now, digest = time.time(), version_digest(room)
    for source in _sources(room):
        status = source.stat()
        if any(_BEGUN < edited <= now for edited in (status.st_mtime, status.st_ctime)):
            return digest + secrets.token_hex(16)
    return digest


@cache
def _sources(room: str) -> list[Path]:
    return sorted((Path(str(resources.files("holdfast"))) / room).rglob("*.py"))


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
