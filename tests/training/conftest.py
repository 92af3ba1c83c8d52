"""What tests of training ask of the command line: that it ends well, or refuses in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture(scope="session")
def done(run_tokt: Callable[..., Any]) -> Callable[..., Any]:
    """Run a command that must end well."""

    def run(*arguments: object) -> Any:
        ran = run_tokt(*arguments)
        assert ran.code == 0, ran.err
        return ran

    return run


@pytest.fixture(scope="session")
def told(done: Callable[..., Any]) -> Callable[..., Any]:
    """Run a command that must end well; the JSON that it prints."""
    return lambda *arguments: json.loads(done(*arguments, "--json").out)


@pytest.fixture(scope="session")
def refused(run_tokt: Callable[..., Any]) -> Callable[..., str]:
    """Run a command that must fail, and say why in its last line; all that it said."""

    def run(why: str, *arguments: object) -> str:
        ran = run_tokt(*arguments)
        assert ran.code == 2 and why in ran.err, ran.err
        assert ran.err.splitlines()[-1].startswith("tokt: error: ")
        assert "Traceback" not in ran.err
        return str(ran.err)

    return run
