"""The other program: what `holdfast-check` consists of, for those who ask it."""

from __future__ import annotations

import hashlib
import importlib
import warnings
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

from holdfast.errors import ModelWarning, OutputError, SimulationError
from holdfast.execution.cache import Stored


def part_of_checker(name: str) -> ModuleType:
    """A module of the checker, which is a program of its own and shares no code with this one.

    Raises `SimulationError` where the library of its numbers is missing.
    """
    try:
        return importlib.import_module(f"holdfast_check.{name}")
    except ImportError as error:
        if error.name != "flint":
            raise
        raise SimulationError(
            "the checker of certificates needs python-flint",
            remedy="python -m pip install 'holdfast[check]'",
        ) from error


def check_content(file: Path, content: bytes, share: float) -> None:
    """Let the checker read the content of a file, and warn of what it did not check.

    share: of its entries, drawn anew each time; 0 for none. That a whole file is valid is kept in
    the cache, by the digest of the content and of the checker, so that it is asked once.

    Raises `OutputError` for what is not valid.
    """
    if share == 0:
        return _warn(f"{file} was not checked: that its cells are kept is what it says")
    try:
        checker = part_of_checker("checker")
    except SimulationError as missing:
        return _warn(
            f"{file} was not checked: that its cells are kept is what it says; {missing.cause}",
            missing.remedy,
        )
    verdicts = Stored("certificate", _digest_of_checker())
    digest = hashlib.sha256(content).hexdigest()
    if verdicts.load(digest) is not None:
        return None
    numbers = checker.flint.ctx
    bits = numbers.prec
    try:
        verdict = checker.proved(content, share)
    except checker.NotValidError as wrong:
        raise OutputError(
            f"{file} is not valid: {wrong}", remedy="certify again; nothing of it is proved"
        ) from None
    except Exception as error:  # whatever a file contains
        raise OutputError(
            f"{file} cannot be checked ({type(error).__name__}: {error!s:.200})"
        ) from error
    finally:
        numbers.prec = bits
    if not verdict["valid"]:
        return _warn(
            f"{verdict['checked']} of {verdict['entries']} entries of {file} were checked (seed "
            f"{verdict['seed']}): that the others are kept is what it says"
        )
    return verdicts.save(digest, b"valid")


def _warn(cause: str, remedy: str | None = None) -> None:
    text = cause if remedy is None else f"{cause}: {remedy}"
    warnings.warn(text, ModelWarning, stacklevel=5)


def _digest_of_checker() -> str:
    """Of its source and of the version of its numbers, so that another one is asked anew."""
    digest = hashlib.sha256(version("python-flint").encode())
    for path in sorted(Path(str(resources.files("holdfast_check"))).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
