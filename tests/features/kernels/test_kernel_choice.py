"""Which kernels a process uses: TOKT_KERNELS, and a package without the compiled ones."""

from pathlib import Path

import pytest

import tokt
import tokt.features
from tests.calls import refuses, run_python
from tokt.features.kernels.dispatch import load_kernels

from .each_kernel import needs_compiled

FEATURES = Path(tokt.features.__file__).parent
PARTS = ("labels", "training", "models", "inference")
NAME_AND_WHY = (
    "from tokt.features.kernels.dispatch import KERNELS; print(KERNELS.name, '|', KERNELS.why)"
)
LIBRARIES = "import sys; print(sorted({'skimage', 'mahotas', 'scipy'} & set(sys.modules)))"
A_RUN = ("-m", "tokt", "run", "--bundle", "model.tokt", "--source", "dive")
DESCRIBE = (
    "import numpy as np; from tokt.features.frames.grid import Grid; "
    "from tokt.features.extractors.extractor import extractor_named as named; "
    "named('haralick+lbp').describe(np.ones((60, 80, 3), np.uint8), Grid(3, 4, 40))"
)
# An editable install looks for modules that a package lacks in the checkout.
NO_EDITABLE_INSTALL = """
import sys
sys.meta_path[:] = [one for one in sys.meta_path if not one.__module__.startswith("__editable__")]
"""


def run(*arguments: str, kernels: str = "", path: Path | None = None) -> tuple[int, str, str]:
    """A new Python: its exit code, output and errors."""
    own = {"PYTHONPATH": str(path), "PYTHONSAFEPATH": "1"} if path else {}
    done = run_python(*arguments, TOKT_KERNELS=kernels, **own)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def without_extension(tmp_path_factory):
    """A folder to import this package from, complete but for the compiled kernels."""
    root = tmp_path_factory.mktemp("package")
    (root / "sitecustomize.py").write_text(NO_EDITABLE_INSTALL, encoding="utf-8")
    package = root / "tokt"
    (package / "features" / "kernels").mkdir(parents=True)
    for path in Path(tokt.__file__).parent.iterdir():
        if path.name != "features":
            (package / path.name).symlink_to(path)
    for path in FEATURES.iterdir():
        if path.name != "kernels":
            (package / "features" / path.name).symlink_to(path)
    for path in (FEATURES / "kernels").glob("*.py"):
        (package / "features" / "kernels" / path.name).symlink_to(path)
    for part in PARTS:
        if not (package / part).exists():
            (package / part).symlink_to(FEATURES.parent / part)
    return root


@needs_compiled
def test_compiled_unless_asked_otherwise():
    code, out, err = run("-c", NAME_AND_WHY)
    assert (code, err) == (0, "")
    assert out.startswith("compiled | ")


@pytest.mark.parametrize(
    ("name", "imported"),
    [
        pytest.param("compiled", set(), marks=needs_compiled),
        ("numpy", set()),
        ("library", {"skimage", "mahotas", "scipy"}),
    ],
)
def test_the_variable_chooses_and_fast_kernels_import_no_library(name, imported):
    code, out, err = run("-c", f"{NAME_AND_WHY}; {DESCRIBE}; {LIBRARIES}", kernels=name)
    assert code == 0, err
    assert out == f"{name} | TOKT_KERNELS={name}\n{sorted(imported)}\n"


def test_an_unknown_name_is_one_line():
    for name in ("", "nonsense", "NUMPY", "numpy,compiled", " "):
        refuses("unknown kernels", load_kernels, name)
    words = "unknown kernels (choose from compiled, numpy, library)"
    said = f"tokt: error: TOKT_KERNELS=Compiled: {words}\n"
    assert run(*A_RUN, kernels="Compiled") == (2, "", said)


def test_numpy_where_nothing_is_compiled(without_extension):
    code, out, err = run("-c", f"{DESCRIBE}; {NAME_AND_WHY}", path=without_extension)
    assert (code, err) == (0, "")
    assert out.startswith("numpy | no compiled ones: they were not built; install a platform's")
    code, out, err = run(*A_RUN, kernels="compiled", path=without_extension)
    assert (code, out, err.count("\n")) == (2, "", 1)
    words = "TOKT_KERNELS=compiled: not on this machine: they were not built"
    assert err.startswith(f"tokt: error: {words}")


def test_an_extension_built_from_other_sources_is_not_used():
    native = "tokt.features.kernels._native"
    old = f"import sys, types; sys.modules[{native!r}] = types.ModuleType('_native'); "
    code, out, err = run("-c", old + NAME_AND_WHY)
    assert code == 0, err
    assert out.startswith("numpy | no compiled ones: the extension was built from other sources")
