"""The developers' measurements as commands in this process."""

from functools import partial

import pytest

from .__main__ import main


@pytest.fixture(scope="session")
def run_load(run_tokt):
    return partial(run_tokt, program=main)
