"""The measurements of `tests/load` that render their missions, as commands in this process."""

from tests.load.conftest import browser, run_load

__all__ = ["browser", "run_load"]
