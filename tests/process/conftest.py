"""What the sdist and the wheels must hold."""

from pathlib import PurePosixPath

import pytest

from tests.fixtures import ROOT


def _import_path(name):
    """Where a file of the checkout belongs in the wheel; None for one outside of the product."""
    folder = PurePosixPath(name).parts[0]
    if (ROOT / "src/tokt" / folder).is_symlink():
        return f"tokt/{name}"
    return name.removeprefix("src/") if folder == "src" else None


@pytest.fixture(scope="session")
def product(git_files):
    if not git_files:
        pytest.skip("not a git checkout")
    # The scripts' types are for editors: the sdist holds them.
    placed = {_import_path(name): ROOT / name for name in git_files if not name.endswith(".d.ts")}
    return {path: file for path, file in placed.items() if path and not file.is_symlink()}
