"""The measurements of `tests/load` that render their missions, as commands in this process."""

from tests.load.conftest import run_load

__all__ = ["run_load"]
