"""The digest of the code is that of what runs, or one of its own."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import holdfast

ASKS = """
from holdfast.host.files import code_digest, version_digest
{}
print(code_digest(), code_digest("host"), version_digest())
"""


def asked(place, between="pass"):
    """The digests in another process, which does something between its beginning and the question."""
    command = [sys.executable, "-c", ASKS.format(between)]
    said = subprocess.run(
        command, env={"PYTHONPATH": str(place)}, capture_output=True, text=True, check=True
    )
    return said.stdout.split()


def test_a_file_that_is_edited_while_a_process_runs_makes_its_digest_no_other_ones(tmp_path):
    folder = tmp_path / "code"
    shutil.copytree(
        Path(holdfast.__file__).parent, folder / "holdfast",
        ignore=shutil.ignore_patterns("__pycache__"),
    )  # fmt: skip
    before = asked(folder)
    edited = folder / "holdfast" / "host" / "streams.py"
    during = asked(folder, f"open({str(edited)!r}, 'a').write('# edited')")
    after = asked(folder)
    assert asked(folder) == after
    assert len({*before[:2], *during[:2], *after[:2]}) == 6
    assert during[2] == after[2] == after[0], "processes that work together compare the files"
    later = time.time() + 3600
    os.utime(edited, (later, later))
    assert asked(folder) == after, "a time that is yet to come says nothing"
