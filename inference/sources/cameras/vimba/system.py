"""The Vimba API as a whole: started once for all cameras, and the cameras that it finds."""

from __future__ import annotations

import threading
from types import ModuleType
from typing import Any

from tokt.features.common.errors import ToktError

_ACCESS_DENIED = -6  # VmbErrorInvalidAccess; pymba names it ERR_OPERATION_INVALID_FOR_ACCESS_MODE


class VimbaSystem:
    """The API, open for as long as somebody uses it.

    Parameters
    ----------
    pymba : module
    """

    def __init__(self, pymba: ModuleType) -> None:
        self._pymba = pymba
        self._lock = threading.Lock()
        self._users = 0
        self._vimba: Any = None

    def enter(self) -> None:
        """Start the API unless it is, and look which cameras are there now.

        Raises
        ------
        ToktError
            If it does not start.
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
        """The ID of the camera that a user means.

        Parameters
        ----------
        text : str
            Its ID, serial number, IP address, MAC address, or its index among those found.

        Raises
        ------
        ToktError
            If there is none; it lists those that there are.
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

        Raises
        ------
        ToktError
            If it does not open.
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
