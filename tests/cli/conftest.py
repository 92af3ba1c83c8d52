"""The command line in a process of its own, as an install without some packages has it."""

import os
import subprocess
import sys

import pytest

from tests.waiting import MAX_S


def without(modules, folder, *arguments, **environment):
    program = (
        f"import runpy, sys; sys.modules.update(dict.fromkeys({(*modules,)!r}));"
        "runpy.run_module('tokt', run_name='__main__')"
    )
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=MAX_S,
        check=False,
    )


@pytest.fixture(scope="session")
def tokt_without():
    """Call the command line in a folder where some modules cannot be imported."""
    return without
