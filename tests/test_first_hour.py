"""The wheel in an empty environment: the first hour of a person (`first_hour.py`) as they have it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "tests/first_hour.py"


def ran(*line, cwd, **environment):
    bare = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        list(map(str, line)), cwd=cwd, capture_output=True, text=True, env=bare | environment
    )
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """An interpreter beside which are the wheel, what it needs, and what runs notebooks."""
    folder = tmp_path_factory.mktemp("environment")
    ignored = shutil.ignore_patterns(
        ".git", "runs", "site", "*.egg-info", "__pycache__", ".*_cache"
    )
    shutil.copytree(ROOT, folder / "tree", ignore=ignored)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    code, text = ran(
        *pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, folder / "tree", cwd=folder
    )
    if code and "Could not find a version" in text:
        pytest.skip("there is no package registry to build a wheel with")
    assert code == 0, text
    (wheel,) = folder.glob("holdfast-*.whl")
    assert ran(sys.executable, "-m", "venv", folder / "venv", cwd=folder)[0] == 0
    interpreter = folder / "venv/bin/python"
    code, text = ran(
        interpreter, *pip[1:], "install", "--quiet", wheel, "nbclient", "ipykernel", cwd=folder
    )
    assert code == 0, text
    return interpreter


@pytest.mark.heavy
def test_the_first_hour_of_a_person_goes_as_the_pages_say(python, tmp_path):
    code, text = ran(
        python, SCRIPT, cwd=tmp_path, MPLBACKEND="Agg", HOLDFAST_CACHE_DIR=str(tmp_path / "cache")
    )
    assert code == 0, text
    seconds = json.loads((tmp_path / "first_hour.json").read_text())
    assert set(seconds) == {
        "installed", "from_a_file", "my_kernel", "my_controller_kept_safe", "in_a_notebook",
        "mistakes_are_explained",
    }  # fmt: skip
    book = json.loads((tmp_path / "first_hour.ipynb").read_text())
    assert "<math" in json.dumps(book), "the notebook shows the equations"
