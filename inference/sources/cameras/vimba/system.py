"""The Vimba API as a whole: pymba, which loads it, its start, the cameras that it finds."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError
from tokt.features.common.machine import installed_version

NO_PYMBA = "no pymba; live cameras need the extra 'camera'"
WHAT_TO_SET = (
    "install Allied Vision's Vimba SDK and set GENICAM_GENTL64_PATH to the folder of its .cti "
    "file, as the SDK's own profile script does (on Windows: VIMBA_HOME)"
)
# How pymba 0.3.7 says that there is no Vimba at all, and not one that does not load.
_NO_VIMBA = ("_PATH environment set", "No libVimbaC.so found", "VimbaC.dll not found")


def _without_sdk(reason: str) -> str:
    """What to install, if these words, raised by importing pymba, mean that there is no SDK."""
    missing = any(words in reason for words in _NO_VIMBA)
    return f"no Vimba library ({reason}): {WHAT_TO_SET}" if missing else ""


def load_pymba() -> VimbaSystem:
    """The Vimba API by pymba.

    ToktError says what to install and set if it is not installed, or its library cannot be loaded.
    """
    installed = installed_version("pymba")
    if installed is None:
        raise ToktError(NO_PYMBA)
    try:
        import pymba
    # Without the SDK its import fails in each of these ways, by what of it is missing (never with
    # an ImportError); ValueError is for a machine that pymba does not know.
    except (AssertionError, AttributeError, OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        words = _without_sdk(reason)
        message = f"finds {words}" if words else f"cannot load the Vimba library: {reason}"
        raise ToktError(f"pymba {installed} {message}") from error
    # AttributeError is its way to say that the camera has no such feature.
    return VimbaSystem(pymba.vimba_c, (pymba.VimbaException, AttributeError))


_IN_USE = (-6, -27)  # VmbErrorInvalidAccess, VmbErrorInUse; they have other names in pymba


class VimbaSystem:
    """The API by pymba, open for as long as somebody uses it; `VimbaXSystem` overrides its steps.

    What these raise is one of `errors`, the first that of the C API, of which `c` has the types.
    """

    def __init__(self, c: Any, errors: tuple[type[Exception], ...]) -> None:
        self.errors = errors
        self.c = c
        self._lock = threading.Lock()
        self._users = 0
        self._vimba: Any = None

    def enter(self) -> None:
        """Start the API unless it is, and look for cameras; ToktError if it does not start."""
        with self._lock:
            try:
                if self._users == 0:
                    self._start()
                else:
                    self._look_again()
            except self.errors as error:
                raise ToktError(f"the Vimba API does not start: {error}") from error
            self._users += 1

    def leave(self) -> None:
        """Shut the API down if nobody else uses it."""
        with self._lock:
            self._users -= 1
            if self._users == 0:
                self._shut_down()

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
        except self.errors as error:
            raise ToktError(f"the Vimba API lists no cameras: {error}") from error
        if named:
            return named
        if text.isdecimal() and int(text) < len(found):
            return found[int(text)]["id"]
        listed = ", ".join(f"{at['id']} ({at['model']}, {at['serial']})" for at in found)
        raise ToktError(f"no camera {text!r}; found: {listed or 'none'}")

    def is_there(self, camera_id: str) -> bool:
        """Whether the API still knows of a camera."""
        with suppress(*self.errors):
            return any(each["id"] == camera_id for each in self._found())
        return False

    def open(self, camera_id: str) -> Any:
        """Open a camera anew: one that was lost may be of no use; ToktError if it does not open."""
        try:
            return self._opened(camera_id)
        except self.errors as error:
            if self._code(error) in _IN_USE:
                raise ToktError(f"camera {camera_id} is in use by another program") from error
            raise ToktError(f"camera {camera_id} cannot be opened: {error}") from error

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the C API, by pymba's name for it; one of `errors` if it fails."""
        if code := getattr(self.c, name)(*arguments):
            raise self.errors[0](code)

    def _start(self) -> None:
        from pymba import Vimba

        vimba = Vimba()
        try:
            vimba.startup()  # discovers as well
        except self.errors:
            vimba.shutdown()
            raise
        self._vimba = vimba

    def _look_again(self) -> None:
        # A camera that was pulled out is found again only if it is looked for.
        if self._vimba.system().GeVTLIsPresent:
            self._vimba.system().GeVDiscoveryAllOnce()

    def _shut_down(self) -> None:
        self._vimba.shutdown()
        self._vimba = None

    def _opened(self, camera_id: str) -> Any:
        from pymba.camera import Camera

        camera = Camera(self._vimba, camera_id)
        camera.open(adjust_packet_size=False)
        return PymbaCamera(camera, self.c.vmb_frame_callback_func)

    def _code(self, error: Any) -> int:
        return int(getattr(error, "error_code", 0))

    def _found(self) -> list[dict[str, str]]:
        count, size = ctypes.c_uint32(), ctypes.sizeof(self.c.VmbCameraInfo)
        self.call("vmb_cameras_list", None, 0, ctypes.byref(count), size)
        infos = (self.c.VmbCameraInfo * count.value)()
        if count.value:
            self.call("vmb_cameras_list", infos, count.value, ctypes.byref(count), size)
        return [_known_by(info) for info in infos[: count.value]]

    def _asked(self, text: str) -> str:
        """The ID of the camera that the API itself knows by this name; empty if it knows none."""
        info = self.c.VmbCameraInfo()
        if text.isascii():
            with suppress(*self.errors):
                asked = text.encode(), ctypes.byref(info), ctypes.sizeof(info)
                self.call("vmb_camera_info_query", *asked)
        return _known_by(info)["id"]


def _known_by(info: Any) -> dict[str, str]:
    """Whose a library's VmbCameraInfo is: ``id``, ``model``, ``serial``."""
    names = {"id": "cameraIdString", "model": "modelName", "serial": "serialString"}
    return {
        key: (getattr(info, name) or b"").decode(errors="replace") for key, name in names.items()
    }


class PymbaCamera:
    """An opened camera of pymba's, and what its stream needs."""

    def __init__(self, camera: Any, callback: Any) -> None:
        self._camera, self.callback, self.stream = camera, callback, camera.handle

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def payload(self) -> int:
        """Bytes that a buffer needs."""
        return int(self._camera.PayloadSize)

    def image(self, frame: Any) -> tuple[int, int, int]:
        """Address and bytes of a filled buffer's image, and the bytes that there is room for."""
        return frame.buffer, frame.imageSize, frame.bufferSize


_PROGRAM = "import pymba; print('VimbaC', pymba.Vimba.version())"


def camera_driver_finding(timeout_s: float = 20.0) -> Finding:
    """Whether pymba is there and loads its library in so many seconds."""

    def missing(reason: str) -> str:  # without the exception's name
        return _without_sdk(" ".join((reason.partition(": ")[2] or reason).split()))

    return library_finding("camera driver", "pymba", NO_PYMBA, _PROGRAM, missing, timeout_s)


def library_finding(
    name: str,
    package: str,
    no_package: str,
    program: str,
    missing: Callable[[str], str],
    timeout_s: float,
) -> Finding:
    """Whether a package is there and loads its vendor's library, by a program that prints its name.

    In another process: the library is loaded on import, and one that crashes, hangs or prints shall
    not take this one with it. `missing` says of the reason for which the program failed what is to
    be installed; nothing where that is not it.
    """
    if (installed := installed_version(package)) is None:
        return Finding(name, NOTE, no_package)
    module = f"{package} {installed}"
    try:
        tried = subprocess.run(
            # -P: a folder named pymba in the current one is not it.
            [sys.executable, "-P", "-c", program],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return Finding(name, FAULT, f"{module}: its library does not answer in {timeout_s:g} s")
    if tried.returncode == 0:
        library = (tried.stdout.splitlines() or ["its library"])[-1]
        return Finding(name, OK, f"{module} with {library}")
    reason = (tried.stderr.strip().splitlines() or [f"ended with {tried.returncode}"])[-1]
    if words := missing(reason):
        return Finding(name, NOTE, f"{module}, but {words}")
    return Finding(name, FAULT, f"{module} cannot be used: {reason}")
