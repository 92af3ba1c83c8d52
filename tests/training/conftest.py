"""What tests of training ask of the command line: that it ends well, or refuses in one line."""

import json

import pytest


@pytest.fixture(scope="session")
def done(run_tokt):
    """Run a command that must end well."""

    def run(*arguments):
        ran = run_tokt(*arguments)
        assert ran.code == 0, ran.err
        return ran

    return run


@pytest.fixture(scope="session")
def told(done):
    """Run a command that must end well; the JSON that it prints."""
    return lambda *arguments: json.loads(done(*arguments, "--json").out)


@pytest.fixture(scope="session")
def refused(run_tokt):
    """Run a command that must fail, and say why in its last line; all that it said."""

    def run(why, *arguments):
        ran = run_tokt(*arguments)
        assert ran.code == 2 and why in ran.err, ran.err
        assert ran.err.splitlines()[-1].startswith("tokt: error: ")
        assert "Traceback" not in ran.err
        return str(ran.err)

    return run
