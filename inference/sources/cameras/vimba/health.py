"""The doctor's check of Vimba cameras: pymba, and the library it drives them with."""

from __future__ import annotations

import subprocess
import sys

from tokt.features.common.finding import FAULT, NOTE, OK, Finding

from .library import NO_PYMBA, WHAT_TO_SET, is_missing, pymba_version

NAME = "camera driver"
_TIMEOUT_S = 20.0
_PROGRAM = "import pymba; print('VimbaC', pymba.Vimba.version())"


def camera_driver_finding(timeout_s: float = _TIMEOUT_S) -> Finding:
    """Whether pymba is there and loads its library.

    It is tried in another process: pymba loads the vendor's library when it is imported, and one
    that crashes, hangs or prints shall not take this process with it.

    Parameters
    ----------
    timeout_s : float
        How long the library may take, in seconds.
    """
    installed = pymba_version()
    if installed is None:
        return Finding(NAME, NOTE, NO_PYMBA)
    pymba = f"pymba {installed}"
    try:
        tried = subprocess.run(
            # -P: a folder named pymba in the current one is not it.
            [sys.executable, "-P", "-c", _PROGRAM],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return Finding(NAME, FAULT, f"{pymba}: its library does not answer in {timeout_s:g} s")
    if tried.returncode == 0:
        library = (tried.stdout.splitlines() or ["VimbaC"])[-1]
        return Finding(NAME, OK, f"{pymba} with {library}")
    reason = (tried.stderr.strip().splitlines() or [f"ended with {tried.returncode}"])[-1]
    if is_missing(reason):
        words = f"{pymba}, but no Vimba library ({_message(reason)}): {WHAT_TO_SET}"
        return Finding(NAME, NOTE, words)
    return Finding(NAME, FAULT, f"{pymba} cannot be used: {reason}")


def _message(reason: str) -> str:
    """The last line of a traceback without the exception's name."""
    return " ".join((reason.partition(": ")[2] or reason).split())
