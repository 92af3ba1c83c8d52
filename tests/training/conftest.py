"""What tests of training ask of the command line: that it ends well, or refuses in one line."""

import json

import pytest

from tests import calls


@pytest.fixture(scope="session")
def done():
    """`tests.calls.succeeds`."""
    return calls.succeeds


@pytest.fixture(scope="session")
def told(done):
    """Run a command that must end well; the JSON that it prints."""
    return lambda *arguments: json.loads(done(*arguments, "--json").out)


@pytest.fixture(scope="session")
def refused():
    """`tests.calls.refused`."""
    return calls.refused
