"""Headless Chromium through Playwright, for the bench of the labelling page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError

if TYPE_CHECKING:
    from playwright.sync_api import Browser

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--disable-backgrounding-occluded-windows",
)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A headless browser: the system's Chromium, or else the one Playwright fetched.

    Raises
    ------
    ToktError
        If Playwright or a Chromium is missing.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        raise ToktError(
            "measuring the page needs Playwright (pip install playwright, or tokt's extra dev)"
        ) from None
    with sync_playwright() as playwright:
        own = Path(playwright.chromium.executable_path)
        found = next((path for path in map(shutil.which, _NAMES) if path), None)
        if found is None and not own.is_file():
            raise ToktError(
                "no Chromium here (apt install chromium, or playwright install chromium)"
            )
        browser = playwright.chromium.launch(executable_path=found or own, args=list(_ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()
