"""Chromium without a window, for tests and for the measurements of the page."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError

SHELL = "chromium-headless-shell"
"""Chromium without what a window needs: it takes two thirds of the time, and draws pages alike."""
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", SHELL)
_ARGUMENTS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-background-timer-throttling"),
    *("--disable-renderer-backgrounding", "--disable-backgrounding-occluded-windows"),
)


@contextmanager
def chromium(*, shell: bool = False) -> Iterator[Any]:
    """A headless browser: the system's Chromium, or else the one Playwright fetched.

    Times are measured in the browser that people use; a test may take its `shell` where it is.
    Raises ToktError where there is none.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        raise ToktError("no Chromium without Playwright (tokt's extra dev)") from None
    names = sorted(_NAMES, key=lambda name: name != SHELL) if shell else _NAMES
    with sync_playwright() as playwright:
        own = Path(playwright.chromium.executable_path)
        found = next((path for path in map(shutil.which, names) if path), None)
        if found is None and not own.is_file():
            raise ToktError("no Chromium here (apt, or playwright install chromium)")
        browser = playwright.chromium.launch(executable_path=found or own, args=list(_ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()
