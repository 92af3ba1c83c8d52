"""Facts of the machine: processor, system, and versions of the libraries that compute."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_LIBRARIES = {
    "numpy": ("numpy",),
    "opencv": ("opencv-python-headless", "opencv-python"),
    "scikit-image": ("scikit-image",),
    "mahotas": ("mahotas",),
    "scikit-learn": ("scikit-learn",),
}
_CPUINFO = Path("/proc/cpuinfo")


def _cpu() -> str:
    """The processor's name; what Python knows of it where Linux does not tell."""
    if _CPUINFO.is_file():
        for line in _CPUINFO.read_text("utf-8", "replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def installed_version(*names: str) -> str | None:
    """Version of the first of these packages that is installed; None where none is."""
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return None


def machine() -> dict[str, Any]:
    """Processor, system and library versions, as JSON values."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        **{name: installed_version(*names) for name, names in _LIBRARIES.items()},
    }
