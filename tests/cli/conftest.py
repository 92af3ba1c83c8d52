"""The command line in a process of its own, as an install without some packages has it."""

import pytest

from tests.calls import run_python
from tests.inference.sources.video.v4l2_device import device, stand_in  # noqa: F401


def without(modules, folder, *arguments, **environment):
    program = (
        f"import runpy, sys; sys.modules.update(dict.fromkeys({(*modules,)!r}));"
        "runpy.run_module('tokt', run_name='__main__')"
    )
    return run_python("-c", program, *arguments, folder=folder, **environment)


@pytest.fixture(scope="session")
def tokt_without():
    """Call the command line in a folder where some modules cannot be imported."""
    return without
