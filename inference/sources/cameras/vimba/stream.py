"""A Vimba camera's stream: buffers are queued, filled, looked at and queued again.

By pymba's own bindings and not by its `Camera.arm`, for three reasons. There a callback that
raises never queues its buffer again, and after as many as there are buffers nothing comes any
more. There each buffer gets a new callback from within the old one, whose memory is then freed
while it runs; if queueing fails after that, Python reports an exception of a function that is no
more. And there `disarm` gives up at the first step that a camera which was pulled out refuses, so
that buffers stay announced whose memory is about to go.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from tokt.features.common.errors import ToktError

_BUFFERS = 6  # a buffer is away for the few ms of its copy: these cover a pause of a tenth of a s


class VimbaStream:
    """The stream of one opened camera, from `start` to `stop`.

    Parameters
    ----------
    camera : pymba.camera.Camera
    received : callable
        Given pymba's VmbFrame of each buffer that was filled, on a thread of the library's. The
        buffer is written again as soon as it returns. What it raises is counted.
    """

    def __init__(self, camera: Any, received: Callable[[Any], None]) -> None:
        from pymba import vimba_c

        self.failures = 0
        self._camera = camera
        self._received = received
        self._api = vimba_c
        self._running = False
        self._frames: list[Any] = []
        self._callback = vimba_c.vmb_frame_callback_func(self._filled)

    def start(self) -> None:
        """Announce and queue the buffers and let the camera send.

        Raises
        ------
        ToktError
            If one of the steps is refused; `stop` then undoes those before.
        """
        from pymba import VimbaException

        try:
            for _ in range(_BUFFERS):
                frame = self._camera.new_frame()
                frame.announce()
                self._frames.append(frame)
            self._camera.start_capture()
            self._running = True
            for frame in self._frames:
                code = self._queue(frame.data)
                if code:
                    raise VimbaException(code)
            self._camera.run_feature_command("AcquisitionStart")
        # AttributeError is pymba's way to say that the camera has no such feature.
        except (VimbaException, AttributeError) as error:
            raise ToktError(f"camera {self._camera.camera_id} does not stream: {error}") from error

    def stop(self) -> bool:
        """Undo every step of `start` that can be undone; the last callback has returned then.

        Returns
        -------
        bool
            Whether the library has let go of the buffers. If not, this object must be kept: it
            holds the memory that the library may still write to.
        """
        self._running = False
        handle = self._camera.handle
        self._api.vmb_feature_command_run(handle, b"AcquisitionStop")
        self._api.vmb_capture_end(handle)  # joins the thread of the callbacks
        self._api.vmb_capture_queue_flush(handle)
        codes = [self._api.vmb_frame_revoke_all(handle), self._api.vmb_camera_close(handle)]
        released = 0 in codes
        if released:
            self.forget()
        return released

    def forget(self) -> None:
        """Free the memory of the buffers."""
        self._frames.clear()

    def _queue(self, frame: Any) -> int:
        return int(
            self._api.vmb_capture_frame_queue(
                self._camera.handle, ctypes.byref(frame), self._callback
            )
        )

    def _filled(self, handle: int | None, frame: Any) -> None:
        """The library's callback: looks at a buffer and queues it again, whatever happens."""
        try:
            self._received(frame.contents)
        # Called from C, on a thread of the library's, there is nobody to raise to: Python would
        # print it and go on. A lost capture is counted; a lost buffer would be one for good.
        except Exception:  # noqa: BLE001
            self.failures += 1
        if self._running:
            self._queue(frame.contents)
