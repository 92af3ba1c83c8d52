"""pymba, and the library of the Vimba SDK that it loads as soon as it is imported."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from types import ModuleType

from tokt.features.common.errors import ToktError

NO_PYMBA = "no pymba; live cameras need tokt[camera]"
WHAT_TO_SET = (
    "install Allied Vision's Vimba SDK and set GENICAM_GENTL64_PATH to the folder of its .cti "
    "file, as the SDK's own profile script does (on Windows: VIMBA_HOME)"
)
# How pymba 0.3.7 says that there is no Vimba at all, and not one that does not load.
_NO_VIMBA = ("_PATH environment set", "No libVimbaC.so found", "VimbaC.dll not found")


def pymba_version() -> str | None:
    """Which pymba is installed; None where there is none."""
    try:
        return version("pymba")
    except PackageNotFoundError:
        return None


def is_missing(reason: str) -> bool:
    """Whether these words of pymba's mean that there is no Vimba SDK.

    Parameters
    ----------
    reason : str
        What importing pymba raised, as text.
    """
    return any(words in reason for words in _NO_VIMBA)


def load_pymba() -> ModuleType:
    """Import pymba.

    Raises
    ------
    ToktError
        If it is not installed, or its library cannot be loaded: it says what to install and set.
    """
    installed = pymba_version()
    if installed is None:
        raise ToktError(NO_PYMBA)
    try:
        import pymba
    # Without the SDK its import fails in each of these ways, by what of it is missing (never with
    # an ImportError); ValueError is for a machine that pymba does not know.
    except (AssertionError, AttributeError, OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if is_missing(reason):
            message = f"pymba {installed} finds no Vimba library ({reason}): {WHAT_TO_SET}"
        else:
            message = f"pymba {installed} cannot load the Vimba library: {reason}"
        raise ToktError(message) from error
    module: ModuleType = pymba
    return module
