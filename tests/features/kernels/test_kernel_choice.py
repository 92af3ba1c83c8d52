"""Which kernels a process uses: TOKT_KERNELS, and a package without the compiled ones."""

import pytest

from tests.calls import refuses, run_python
from tokt.features.kernels.dispatch import load_kernels

from .each_kernel import needs_compiled

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
NOT_BUILT = """
import sys
class NotBuilt:
    @staticmethod
    def find_spec(name, *_):
        if name == "tokt.features.kernels._native":
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, NotBuilt)
"""
"""A Python in which the package has all but the compiled kernels."""


def run(*arguments: str, kernels: str = "") -> tuple[int, str, str]:
    """A new Python: its exit code, output and errors."""
    done = run_python(*arguments, TOKT_KERNELS=kernels)
    return done.returncode, done.stdout, done.stderr


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


def test_numpy_where_nothing_is_compiled():
    code, out, err = run("-c", f"{NOT_BUILT}{DESCRIBE}; {NAME_AND_WHY}")
    assert (code, err) == (0, "")
    assert out.startswith("numpy | no compiled ones: they were not built; install a platform's")
    tokt = f"{NOT_BUILT}sys.argv = ['tokt', *{A_RUN[2:]}]\nfrom tokt.cli import main\nmain()"
    code, out, err = run("-c", tokt, kernels="compiled")
    assert (code, out, err.count("\n")) == (2, "", 1)
    words = "TOKT_KERNELS=compiled: not on this machine: they were not built"
    assert err.startswith(f"tokt: error: {words}")


def test_an_extension_built_from_other_sources_is_not_used():
    native = "tokt.features.kernels._native"
    old = f"import sys, types; sys.modules[{native!r}] = types.ModuleType('_native'); "
    code, out, err = run("-c", old + NAME_AND_WHY)
    assert code == 0, err
    assert out.startswith("numpy | no compiled ones: the extension was built from other sources")
