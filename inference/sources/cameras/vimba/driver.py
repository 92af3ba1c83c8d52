"""Cameras of Allied Vision and their streams, by the Vimba SDK or Vimba X."""

import ctypes
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import frame_from_camera
from tokt.inference.clock import Clock
from tokt.inference.config import SourceConfig
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.sources.cameras.capture import CameraDriver, Capture, Deliver

from .features import VimbaFeatures, set_features
from .system import VimbaSystem, load_pymba
from .vimbax_system import load_vimbax

_BUFFERS = 6  # a buffer is away for the few ms of its copy: these cover a pause of a tenth of a s


class VimbaStream:
    """The stream of one opened camera, from `start` to `stop`.

    By the C API and not by pymba's `Camera.arm`, for three reasons. There a callback that
    raises never queues its buffer again, and after as many as there are buffers nothing comes any
    more. There each buffer gets a new callback from within the old one, whose memory is then freed
    while it runs; if queueing fails after that, Python reports an exception of a function that is
    no more. And there `disarm` gives up at the first step that a camera which was pulled out
    refuses, so that buffers stay announced whose memory is about to go; so does vmbpy's `Stream`.

    `received` is given the VmbFrame of each buffer that was filled, on a thread of the
    library's. The buffer is written again as soon as it returns. It must not raise.
    """

    def __init__(self, system: VimbaSystem, camera: Any, received: Callable[[Any], None]) -> None:
        self._system = system
        self._camera = camera
        self._received = received
        self._running = False
        self._frames: list[Any] = []
        self._callback = camera.callback(self._filled)

    def start(self, features: VimbaFeatures) -> None:
        """Announce and queue the buffers, as the camera's features ask, and let it send.

        ToktError if one of the steps is refused; `stop` then undoes those before.
        """
        camera, call = self._camera, self._system.call
        try:
            alignment = features.get("StreamBufferAlignment") or 1
            for _ in range(max(_BUFFERS, features.get("StreamAnnounceBufferMinimum") or 1)):
                frame = self._new_frame(alignment)
                self._frames.append(frame)
                announced = ctypes.byref(frame), ctypes.sizeof(frame)
                call("vmb_frame_announce", camera.stream, *announced)
            call("vmb_capture_start", camera.stream)
            self._running = True
            for frame in self._frames:
                self._queue(frame)
            camera.run_feature_command("AcquisitionStart")
        except self._system.errors as error:
            raise ToktError(f"camera {camera.camera_id} does not stream: {error}") from error

    def stop(self) -> bool:
        """Undo every step of `start` that can be undone; the last callback has returned then.

        It says whether the library has let go of the buffers. If not, this object must be kept: it
        holds the memory that the library may still write to.
        """
        self._running = False
        handle, stream = self._camera.handle, self._camera.stream
        done = [
            self._is_done("vmb_feature_command_run", handle, b"AcquisitionStop"),
            self._is_done("vmb_capture_end", stream),  # joins the thread of the callbacks
            self._is_done("vmb_capture_queue_flush", stream),
            self._is_done("vmb_frame_revoke_all", stream),
            self._is_done("vmb_camera_close", handle),
        ]
        if released := any(done[-2:]):
            self.forget()
        return released

    def forget(self) -> None:
        """Free the memory of the buffers."""
        self._frames.clear()

    def _new_frame(self, step: int) -> Any:
        """A VmbFrame with memory of its own, which begins and ends at multiples of a step."""
        size = -(-self._camera.payload() // step) * step
        memory = (ctypes.c_ubyte * (size + step - 1))()
        address = ctypes.addressof(memory)
        frame = self._system.c.VmbFrame()
        frame.memory = memory  # it must not go before the frame does
        frame.buffer, frame.bufferSize = address + -address % step, size
        return frame

    def _queue(self, frame: Any) -> None:
        queued = self._camera.stream, ctypes.byref(frame), self._callback
        self._system.call("vmb_capture_frame_queue", *queued)

    def _is_done(self, name: str, *arguments: Any) -> bool:
        with suppress(*self._system.errors):
            self._system.call(name, *arguments)
            return True
        return False

    def _filled(self, *called: Any) -> None:
        """The library's callback: looks at a buffer and queues it again."""
        frame = called[-1].contents
        self._received(frame)
        if self._running:
            with suppress(*self._system.errors):  # of a camera that was pulled out
                self._queue(frame)


_COMPLETE = 0  # VmbFrameStatusComplete
_HAS_TIMESTAMP = 8  # VmbFrameFlagsTimestamp
_FORMATS = {  # VmbPixelFormat; the same in pymba/vimba_pixelformat.py
    0x01080001: "Mono8",
    0x01080008: "BayerGR8",
    0x01080009: "BayerRG8",
    0x0108000A: "BayerGB8",
    0x0108000B: "BayerBG8",
    0x02180014: "RGB8",
    0x02180015: "BGR8",
}
# So many streams are kept whose buffers the library did not let go of. Each is of a camera that was
# pulled out: when it was opened four times more, no packet from before is on its way any longer.
_KEPT_STREAMS = 4
_INCOMPLETE = Fault(Reason.INCOMPLETE, "the camera's frame did not arrive whole")


@dataclass(eq=False)
class VimbaDriver:
    """One camera of the Vimba API, `LEFT` or `RIGHT`.

    Its `name` is how the user called it: its ID, serial number, IP or MAC address, or index;
    `share` is its part of the bandwidth. The system is the same for all cameras.
    """

    camera: int
    name: str
    options: SourceConfig
    share: float
    clock: Clock
    system: VimbaSystem

    def __post_init__(self) -> None:
        # An index is looked up once: after a camera was pulled out it may be another's.
        self._id: str | None = None
        self._ticks_per_s = math.nan
        self.period_s: float | None = None
        self.shared_clock = False
        self._stream: VimbaStream | None = None
        self._unreleased: list[VimbaStream] = []
        self.failures = 0

    def start(self, deliver: Deliver) -> None:
        """Open the camera, set it and let it send; ToktError if it is not there, or refuses."""
        self.system.enter()
        try:
            self._id = self._id or self.system.camera_id(self.name)
            opened = self.system.open(self._id)
        except ToktError:
            self.system.leave()
            raise

        def received(frame: Any) -> None:
            try:
                deliver(self._capture(frame, opened.image(frame)))
            # Called from C, on a thread of the library's, there is nobody to raise to: Python would
            # print it, and the buffer would be lost for good. A lost capture is counted.
            except Exception:  # noqa: BLE001
                self.failures += 1

        self._stream = VimbaStream(self.system, opened, received)
        errors = self.system.errors
        try:
            features = VimbaFeatures(opened, errors, self.name, self.clock)
            self._ticks_per_s, self.period_s = set_features(features, self.options, self.share)
            self.shared_clock = self.options.ptp
            self._stream.start(features)
        except ToktError:
            self.stop()
            raise
        except errors as error:
            self.stop()
            raise ToktError(f"camera {self.name} cannot be set: {error}") from error

    def stop(self) -> None:
        """Close the camera; nothing is delivered after that."""
        stream, self._stream = self._stream, None
        if stream is None:
            return
        if not stream.stop():
            self._unreleased.append(stream)
            if len(self._unreleased) > _KEPT_STREAMS:
                self._unreleased.pop(0).forget()
        self.system.leave()

    def lost(self) -> str:
        """Why the camera is known to be gone, or nothing."""
        if self._id is None or self.system.is_there(self._id):
            return ""
        return f"camera {self.name} is no longer found"

    def _capture(self, frame: Any, image: tuple[int, int, int]) -> Capture:
        """What is in a buffer, in memory of its own."""
        arrived, t = self.clock.monotonic(), self.clock.time()
        taken_s = math.nan
        if frame.receiveFlags & _HAS_TIMESTAMP and frame.timestamp:  # 0 is a camera's way to say no
            taken_s = frame.timestamp / self._ticks_per_s
        picture, fault = _picture(frame, *image)
        return Capture(self.camera, frame.frameID, taken_s, arrived, t, picture, fault)


def _picture(frame: Any, address: int, size: int, room: int) -> tuple[U8 | None, Fault]:
    """A copy of a buffer's picture, or why there is none."""
    if frame.receiveStatus != _COMPLETE:
        return None, _INCOMPLETE
    pixel_format = _FORMATS.get(frame.pixelFormat)
    if pixel_format is None:
        return None, Fault(Reason.DAMAGED, f"pixel format {frame.pixelFormat:#010x} is not known")
    if not 0 < size <= room:
        return None, Fault(Reason.DAMAGED, f"the frame has {size} bytes in a buffer of {room}")
    buffer: Any = (ctypes.c_ubyte * size).from_address(address)
    data = np.frombuffer(buffer, np.uint8)
    try:
        return frame_from_camera(data, frame.height, frame.width, pixel_format), NO_FAULT
    except ValueError as error:
        return None, Fault(Reason.DAMAGED, str(error))


def open_drivers(
    ids: Sequence[str], options: SourceConfig, clock: Clock, vimbax: bool = False
) -> Sequence[CameraDriver]:
    """The drivers of one camera, or of a left and a right one, by the Vimba SDK or by Vimba X.

    Nothing is opened yet. ToktError if pymba or vmbpy is missing, or its library.
    """
    system = load_vimbax() if vimbax else load_pymba()
    return [
        VimbaDriver(camera, name, options, 1 / len(ids), clock, system)
        for camera, name in enumerate(ids)
    ]
