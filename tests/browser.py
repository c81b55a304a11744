"""Pages in a real browser: the Chromium of the system, without a window."""

import base64
import shutil
from contextlib import contextmanager

import numpy as np
import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")


class Opened:
    """A page with what it has said: errors, and requests to anything but itself."""

    def __init__(self, page):
        self.page, self.errors, self.requests = page, [], []
        page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: self.errors.append(str(e)))
        page.on("request", lambda r: self.requests.append(r.url) if "://" in r.url[:8] else None)

    def until(self, condition):
        """Wait for it; the page itself forbids to evaluate text, as the tool's own waiting does."""
        self.page.evaluate(
            f"(async () => {{ while (!({condition})) await new Promise((r) => setTimeout(r, 5)); }})()"
        )

    def numbers(self, script):
        """The array of doubles that an expression of the page gives, bit for bit."""
        text = self.page.evaluate(
            f"""async () => {{
              const bytes = new Uint8Array((await ({script})).buffer);
              let text = "";
              for (let k = 0; k < bytes.length; k += 8192)
                text += String.fromCharCode(...bytes.subarray(k, k + 8192));
              return btoa(text);
            }}"""
        )
        return np.frombuffer(base64.b64decode(text), dtype=np.float64)


@contextmanager
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tool:
        found = tool.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        try:
            yield found
        finally:
            found.close()


@contextmanager
def opened(found, path, *, link="", width=1280, height=900, **options):
    """The page of a file, once it runs."""
    context = found.new_context(viewport={"width": width, "height": height}, **options)
    try:
        one = Opened(context.new_page())
        one.page.goto(path.as_uri() + link)
        one.page.wait_for_selector("body[data-ready]", timeout=60_000)
        yield one
    finally:
        context.close()
