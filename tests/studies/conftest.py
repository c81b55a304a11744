"""What several tests of pages share."""

import pytest

from tests.browser import browser


@pytest.fixture(scope="module")
def chromium():
    """The browser of the system; its tests are marked with `needs_browser`."""
    with browser() as found:
        yield found
