"""The developers' measurements as commands in this process."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from .__main__ import main


@pytest.fixture(scope="session")
def run_load(run_tokt: Callable[..., Any]) -> Callable[..., Any]:
    """Run ``python -m tests.load`` with these arguments."""
    return partial(run_tokt, program=main)
