"""The Vimba API as a whole: pymba, which loads it, its start, the cameras that it finds."""

import subprocess
import sys
import threading
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError

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
    """Whether these words, raised by importing pymba, mean that there is no Vimba SDK."""
    return any(words in reason for words in _NO_VIMBA)


def load_pymba() -> ModuleType:
    """Import pymba.

    ToktError says what to install and set if it is not installed, or its library cannot be loaded.
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
        message = f"cannot load the Vimba library: {reason}"
        if is_missing(reason):
            message = f"finds no Vimba library ({reason}): {WHAT_TO_SET}"
        raise ToktError(f"pymba {installed} {message}") from error
    module: ModuleType = pymba
    return module


_ACCESS_DENIED = -6  # VmbErrorInvalidAccess; pymba names it ERR_OPERATION_INVALID_FOR_ACCESS_MODE


class VimbaSystem:
    """The API, open for as long as somebody uses it."""

    def __init__(self, pymba: ModuleType) -> None:
        self._pymba = pymba
        self._lock = threading.Lock()
        self._users = 0
        self._vimba: Any = None

    def enter(self) -> None:
        """Start the API unless it is, and look which cameras are there now.

        ToktError if it does not start.
        """
        with self._lock:
            vimba = self._vimba or self._pymba.Vimba()
            try:
                if self._users == 0:
                    vimba.startup()  # discovers as well
                elif vimba.system().GeVTLIsPresent:
                    # A camera that was pulled out is found again only if it is looked for.
                    vimba.system().GeVDiscoveryAllOnce()
            except (self._pymba.VimbaException, AttributeError) as error:
                if self._users == 0:
                    vimba.shutdown()
                raise ToktError(f"the Vimba API does not start: {error}") from error
            self._vimba = vimba
            self._users += 1

    def leave(self) -> None:
        """Shut the API down if nobody else uses it."""
        with self._lock:
            self._users -= 1
            if self._users == 0:
                self._vimba.shutdown()
                self._vimba = None

    def camera_id(self, text: str) -> str:
        """The ID of the camera that a user means; ToktError lists those that there are.

        By its ID, serial number, IP address, MAC address, or its index among those found.
        """
        try:
            found = self._found()
            for camera in found:
                if text in (camera["id"], camera["serial"]):
                    return camera["id"]
            named = self._asked(text.replace(":", "").replace("-", "")) or self._asked(text)
        except self._pymba.VimbaException as error:
            raise ToktError(f"the Vimba API lists no cameras: {error}") from error
        if named:
            return named
        if text.isdecimal() and int(text) < len(found):
            return found[int(text)]["id"]
        listed = ", ".join(f"{at['id']} ({at['model']}, {at['serial']})" for at in found)
        raise ToktError(f"no camera {text!r}; found: {listed or 'none'}")

    def is_there(self, camera_id: str) -> bool:
        """Whether the API still knows of a camera."""
        return bool(self._asked(camera_id))

    def open(self, camera_id: str) -> Any:
        """Open a camera, as a new object: one that was lost may not be used again.

        ToktError if it does not open.
        """
        from pymba.camera import Camera

        camera = Camera(self._vimba, camera_id)
        try:
            camera.open(adjust_packet_size=False)
        except self._pymba.VimbaException as error:
            if error.error_code == _ACCESS_DENIED:
                raise ToktError(f"camera {camera_id} is in use by another program") from error
            raise ToktError(f"camera {camera_id} cannot be opened: {error}") from error
        return camera

    def _found(self) -> list[dict[str, str]]:
        ids = self._vimba.camera_ids()
        infos = [self._vimba.camera(camera_id).info for camera_id in ids]
        return [
            {
                "id": camera_id,
                "model": (info.modelName or b"").decode(errors="replace"),
                "serial": (info.serialString or b"").decode(errors="replace"),
            }
            for camera_id, info in zip(ids, infos, strict=True)
        ]

    def _asked(self, text: str) -> str:
        """The ID of the camera that the API itself knows by this name; empty if it knows none."""
        if not text.isascii():
            return ""
        try:
            info = self._vimba.camera(text).info
        except self._pymba.VimbaException:
            return ""
        return str((info.cameraIdString or b"").decode(errors="replace"))


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
        # Without the exception's name.
        message = " ".join((reason.partition(": ")[2] or reason).split())
        return Finding(NAME, NOTE, f"{pymba}, but no Vimba library ({message}): {WHAT_TO_SET}")
    return Finding(NAME, FAULT, f"{pymba} cannot be used: {reason}")
