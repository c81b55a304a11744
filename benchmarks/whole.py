"""Run what the fast tests leave out, and keep the verdicts.

    python benchmarks/whole.py                    # every test that is marked heavy or thesis
    python benchmarks/whole.py --missing          # those alone that have not passed in the record
    python benchmarks/whole.py tests/thesis       # those of some files or folders

`whole.json` names every such test with its verdict, its seconds and the commit; it is written as
each test ends. What has passed at this commit is not run again, so that a run goes on where Ctrl-C
ended it; `--again` runs it all the same. A "+" behind a commit says that files were changed since.

Exit status 0 if all passed or were skipped for a reason, 1 if one failed, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import datetime
import json
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
RECORD = Path(__file__).with_suffix(".json")
MARKED = "heavy or thesis"
VERSIONS = ("holdfast", "numpy", "scipy", "sympy", "llvmlite", "xarray", "pytest")


def git(*words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def commit() -> str:
    """The short name of the commit, and "+" if another file than the record was changed since."""
    changed = git("status", "--porcelain", "--", ".", f":!{RECORD.relative_to(ROOT)}")
    return git("rev-parse", "--short=10", "HEAD") + "+" * bool(changed)


def pytest_words(*more: str) -> list[str]:
    """What pytest is called with; the marked tests alone."""
    return ["-q", "-p", "no:cacheprovider", "-o", "addopts=--strict-markers", "-m", MARKED, *more]


def marked(paths: list[str]) -> list[str]:
    """The ids of the marked tests."""
    words = [sys.executable, "-m", "pytest", *pytest_words("--collect-only", *paths)]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    if listed.returncode not in (0, 5):  # 5: no test is marked
        raise SystemExit(listed.stdout + listed.stderr)
    return [line for line in listed.stdout.splitlines() if "::" in line]


class Record:
    """The verdicts, which a plugin of pytest writes as the tests end."""

    def __init__(self) -> None:
        self.data = json.loads(RECORD.read_text("utf-8")) if RECORD.exists() else {"tests": {}}
        self.commit = commit()
        self.seconds: dict[str, float] = {}
        self.failures = 0

    def passed(self, name: str, here: bool = True) -> bool:
        """Whether a test has passed or was skipped: at this commit, or at any. Of files that were
        changed since a commit nothing is known."""
        verdict = self.data["tests"].get(name, "failed")
        at_commit = not self.commit.endswith("+") and verdict.endswith(self.commit)
        return not verdict.startswith("failed") and (not here or at_commit)

    def retain(self, names: list[str]) -> None:
        """The verdicts of tests that are there no more go."""
        self.data["tests"] = {n: v for n, v in self.data["tests"].items() if n in set(names)}

    def write(self) -> None:
        self.data = {
            "date": datetime.date.today().isoformat(),
            "commit": self.commit,
            "versions": {"python": platform.python_version()} | {n: version(n) for n in VERSIONS},
            "tests": dict(sorted(self.data["tests"].items())),
        }
        partial = RECORD.with_suffix(".partial")
        partial.write_text(json.dumps(self.data, indent=1) + "\n", "utf-8")
        partial.replace(RECORD)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Of the three parts of a test the last is its end; a part that did not pass is told."""
        name = report.nodeid
        self.seconds[name] = self.seconds.get(name, 0.0) + report.duration
        if report.when == "setup":
            self.data["tests"].pop(name, None)
        if report.failed:
            said = str(report.longrepr).strip().splitlines()
            self.data["tests"][name] = f"failed: {said[-1][:200] if said else report.when}"
            self.failures += 1
        elif report.skipped:
            reason = (
                report.longrepr[2] if isinstance(report.longrepr, tuple) else "expected to fail"
            )
            self.data["tests"][name] = f"skipped: {reason.removeprefix('Skipped: ')}"
        if report.when == "teardown":
            verdict = self.data["tests"].get(name, "passed")
            self.data["tests"][name] = f"{verdict}, {self.seconds[name]:.1f} s, {self.commit}"
            self.write()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="*", default=["tests"], help="files or folders of tests")
    parser.add_argument("--again", action="store_true", help="also what has passed at this commit")
    parser.add_argument("--missing", action="store_true", help="only what never passed")
    parser.add_argument("--workers", default="auto", help="processes (every core)")
    asked = parser.parse_args()
    names, record = marked(asked.paths), Record()
    if asked.paths == ["tests"]:
        record.retain(names)
    left = [n for n in names if asked.again or not record.passed(n, here=not asked.missing)]
    print(f"{len(names)} tests are marked {MARKED}; {len(left)} of them are run", flush=True)
    status = 0
    if left:
        with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
            file.write("\n".join(left))
            file.flush()
            workers = ["-n", asked.workers, "--dist", "worksteal"]
            status = pytest.main(pytest_words(*workers, f"@{file.name}"), plugins=[record])
    if asked.paths == ["tests"]:
        record.write()
    without = [n for n in left if n not in record.data["tests"]]
    print(f"{record.failures} failures; {len(without)} tests were not reached: {RECORD}")
    if status == pytest.ExitCode.INTERRUPTED:
        return 130
    return 1 if status or without else 0


if __name__ == "__main__":
    sys.exit(main())
