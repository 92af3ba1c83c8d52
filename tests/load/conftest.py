"""The developers' measurements as commands in this process."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest

from tokt.features.common.errors import ToktError

from .__main__ import main
from .page.tab import chromium


@pytest.fixture(scope="session")
def run_load(run_tokt: Callable[..., Any]) -> Callable[..., Any]:
    """Run ``python -m tests.load`` with these arguments."""
    return partial(run_tokt, program=main)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, or the reason why there is none.

    For one module: as long as Playwright's event loop runs in this thread, no other can.
    """
    try:
        with chromium() as started:
            yield started
    except ToktError as error:
        pytest.skip(str(error))
