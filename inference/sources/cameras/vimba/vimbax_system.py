"""Vimba X by vmbpy's binding of its C API: its start, a camera, its features."""

import ctypes
from typing import Any

from tokt.features.common.errors import Finding, ToktError
from tokt.features.common.machine import installed_version

from .system import VimbaSystem, library_finding

NO_VMBPY = "no vmbpy; cameras of Vimba X need the extra 'vimbax'"
NO_TRANSPORT = (
    "Vimba X finds no transport layer: install Vimba X and set GENICAM_GENTL64_PATH to the folder "
    "of its .cti files, as its own profile script does"
)


def load_vimbax() -> VimbaSystem:
    """The API of Vimba X; ToktError if vmbpy or its library is missing."""
    if installed_version("vmbpy") is None:
        raise ToktError(NO_VMBPY)
    try:
        from vmbpy import VmbFeatureError, c_binding
    # Where its library does not load, its own error has no name yet: it is in what is imported.
    except Exception as error:
        raise ToktError(f"vmbpy cannot load its library: {error}") from error
    # KeyError is a camera without such a feature.
    return VimbaXSystem(c_binding, (c_binding.VmbCError, VmbFeatureError, KeyError))


class VimbaXSystem(VimbaSystem):
    """The VmbC API by vmbpy."""

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the C API, by pymba's name for it."""
        self.c.call_vmb_c(name.title().replace("_", ""), *arguments)

    def _start(self) -> None:
        try:
            self.call("vmb_startup", None)
        except self.c.VmbCError as error:
            if error.get_error_code() == self.c.VmbError.NoTL:
                raise ToktError(NO_TRANSPORT) from error
            raise

    def _look_again(self) -> None:
        """Nothing: it looks by itself, again and again."""

    def _shut_down(self) -> None:
        self.call("vmb_shutdown")

    def _opened(self, camera_id: str) -> Any:
        return VimbaXCamera(self, camera_id)

    def _code(self, error: Any) -> int:
        return int(error.get_error_code()) if isinstance(error, self.c.VmbCError) else 0


_PROGRAM = (
    "import vmbpy.c_binding as c; print('VmbC', c.VMB_C_VERSION); c.call_vmb_c('VmbStartup', None)"
)


def vimbax_finding(timeout_s: float = 20.0) -> Finding:
    """Whether vmbpy is there, loads its library and finds a transport layer in so many seconds."""

    def missing(reason: str) -> str:
        return NO_TRANSPORT if "NoTL" in reason or "No TL" in reason else ""

    return library_finding("Vimba X", "vmbpy", NO_VMBPY, _PROGRAM, missing, timeout_s)


class VimbaXCamera:
    """An opened camera, with the methods of pymba's that tokt uses, and what its stream needs.

    Some features are the camera's, others its stream's, such as those of the packet size.
    """

    def __init__(self, system: VimbaSystem, camera_id: str) -> None:
        from vmbpy.c_binding.vmb_c import FRAME_CALLBACK_TYPE
        from vmbpy.feature import discover_features

        self.callback, self.camera_id = FRAME_CALLBACK_TYPE, camera_id
        self._system, c = system, system.c
        self.handle, info = c.VmbHandle(), c.VmbCameraInfo()
        opened = camera_id.encode(), c.VmbAccessMode.Full, ctypes.byref(self.handle)
        system.call("vmb_camera_open", *opened)
        try:
            asked = self.handle, ctypes.byref(info), ctypes.sizeof(info)
            system.call("vmb_camera_info_query_by_handle", *asked)
            if not info.streamCount:
                raise c.VmbCError(c.VmbError.NoData)
            self.stream = c.VmbHandle(info.streamHandles[0])
            found = (*discover_features(self.stream), *discover_features(self.handle))
        except system.errors:
            system.call("vmb_camera_close", self.handle)
            raise
        self._features = {feature.get_name(): feature for feature in found}

    def feature_names(self) -> list[str]:
        """Names of the features that it has."""
        return list(self._features)

    def feature(self, name: str) -> "VimbaXFeature":
        """One of them."""
        return VimbaXFeature(self._features[name])

    def run_feature_command(self, name: str) -> None:
        """Begin a command."""
        self._features[name].run()

    def feature_command_is_done(self, name: str) -> bool:
        """Whether it has ended."""
        return bool(self._features[name].is_done())

    def payload(self) -> int:
        """Bytes that a buffer needs."""
        size = ctypes.c_uint32()
        self._system.call("vmb_payload_size_get", self.stream, ctypes.byref(size))
        return size.value

    def image(self, frame: Any) -> tuple[int, int, int]:
        """Address and bytes of a filled buffer's image, and the bytes that there is room for."""
        start = ctypes.cast(frame.imageData, ctypes.c_void_p).value or frame.buffer
        bits = frame.pixelFormat >> 16 & 0xFF  # of a pixel, in GenICam's numbers of formats
        size = frame.width * frame.height * bits // 8
        return start, size, frame.bufferSize - (start - frame.buffer)


class VimbaXFeature:
    """A feature of vmbpy's, as pymba's are read and set."""

    def __init__(self, feature: Any) -> None:
        self._feature = feature

    @property
    def value(self) -> Any:
        """Its value, of an enumeration the entry's name; None while there is none to be read."""
        if not self._feature.is_readable():
            return None
        value = self._feature.get()
        return value if isinstance(value, bool | int | float | str) else str(value)

    @value.setter
    def value(self, value: Any) -> None:
        now = self.value
        if value != now:  # what cannot be set may be as it is wanted
            self._feature.set(float(value) if isinstance(now, float) else value)

    @property
    def step(self) -> int:
        """Between the whole numbers that it takes."""
        return self._feature.get_increment() or 1

    @property
    def range(self) -> Any:
        """Its least and its most, or its entries; None where it has neither."""
        if hasattr(self._feature, "get_available_entries"):
            return [str(entry) for entry in self._feature.get_available_entries()]
        return self._feature.get_range() if hasattr(self._feature, "get_range") else None
