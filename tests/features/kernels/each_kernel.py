"""The kernels that a property is tried on: each there is, and the reference they are held to."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import strategies as st

from tokt.features.kernels.dispatch import COMPILED, LIBRARY, NUMPY, Kernels, load_kernels

REFERENCE = load_kernels(LIBRARY)
try:
    COMPILED_KERNELS = load_kernels(COMPILED)
except ImportError:
    COMPILED_KERNELS = None
NUMPY_KERNELS = load_kernels(NUMPY)
needs_compiled = pytest.mark.skipif(
    COMPILED_KERNELS is None, reason="the compiled kernels are not built here"
)
fast = pytest.mark.parametrize(
    "kernels",
    [
        pytest.param(COMPILED_KERNELS, marks=needs_compiled, id=COMPILED),
        pytest.param(NUMPY_KERNELS, id=NUMPY),
    ],
)
THREADS = st.integers(1, 4)


def changed(kernels: Kernels, **functions: Any) -> Kernels:
    """The kernels with other functions in place of some."""
    return replace(kernels, module=SimpleNamespace(**{**vars(kernels.module), **functions}))
