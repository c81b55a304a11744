"""The documentation of several versions, in one folder that any static host serves."""

import contextlib
import functools
import http.server
import json
import re
import shlex
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from tests.browser import browser, needs_browser

ROOT = Path(__file__).parent.parent


def published(text, folder):
    """What CONTRIBUTING says to type, in this folder."""
    for line in text.splitlines():
        if line.startswith("mike "):
            mike = [sys.executable, "-c", "from mike.driver import main; main()"]
            subprocess.run([*mike, *shlex.split(line)[1:]], cwd=folder, check=True)
        else:
            subprocess.run(line, shell=True, cwd=folder, check=True)


@contextlib.contextmanager
def static_host(folder):
    """The address of a server that knows files and nothing else."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.heavy
@needs_browser
def test_two_versions_are_served_from_one_folder_with_their_selector(tmp_path):
    """With the theme and the settings of the site, and one page in the place of all."""
    pytest.importorskip("mike")
    yaml = pytest.importorskip("yaml")
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))
    few = {name: settings[name] for name in ("site_name", "docs_dir", "theme", "extra")}
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(few))
    (tmp_path / "docs").mkdir()
    (typed,) = re.findall(
        r"```\n(mike .*?)```", (ROOT / "CONTRIBUTING.md").read_text("utf-8"), re.S
    )
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    for name, value in (("user.name", "us"), ("user.email", "us@example.org")):
        subprocess.run(["git", "config", name, value], cwd=tmp_path, check=True)
    for version in ("0.1.0", "0.2.0"):
        (tmp_path / "docs/index.md").write_text(f"# Of {version}\n")
        subprocess.run("git add docs && git commit -qm pages", shell=True, cwd=tmp_path, check=True)
        published(typed.replace("0.1.0", version), tmp_path)
    public = tmp_path / "public"
    versions = json.loads((public / "versions.json").read_text())
    assert [v["version"] for v in versions] == ["0.2.0", "0.1.0"]
    assert [v["aliases"] for v in versions] == [["latest"], []]
    assert not [p for p in public.rglob("*") if p.is_symlink()]
    with static_host(public) as address, browser() as window:
        page = window.new_page()
        page.goto(address)
        page.wait_for_url("**/latest/")
        assert page.inner_text("h1").startswith("Of 0.2.0")
        page.wait_for_selector(".md-version__link", state="attached")
        names = [x.text_content().split() for x in page.query_selector_all(".md-version__link")]
        assert [n[0] for n in names] == ["0.2.0", "0.1.0"]
        page.goto(f"{address}/0.1.0/")
        assert page.inner_text("h1").startswith("Of 0.1.0")
