"""The developers' measurements as commands in this process."""

from functools import partial

import pytest

from tokt.features.common.errors import ToktError

from .__main__ import main
from .page.tab import chromium


@pytest.fixture(scope="session")
def run_load(run_tokt):
    """Run ``python -m tests.load`` with these arguments."""
    return partial(run_tokt, program=main)


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium, or the reason why there is none.

    For one module: as long as Playwright's event loop runs in this thread, no other can.
    """
    try:
        with chromium() as started:
            yield started
    except ToktError as error:
        pytest.skip(str(error))
