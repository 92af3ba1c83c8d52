"""The process of one camera's video: ``python -m`` this module.

::

    socket, device ── reader ──> newest reading ──> sender ──> pipe
                      first thread                  second thread

A process of its own, since FFmpeg and drivers may hang or crash, and decoding takes the time of a
core. A stream that ends or falls silent is looked for again here; meanwhile the sender goes on
saying that it is lost. What the process is told and what it answers: `cameras.messages`.
"""

import threading
from importlib import import_module
from typing import IO

from av import VideoFrame

from tokt.features.common.address import without_credentials
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import Fault, Reason
from tokt.inference.sources.cameras.messages import begun, write_frame, write_message

from .address import VideoAddress
from .newest import NewestReading, Reading, StreamLostError

_OPEN_S = 8.0  # until the first one, after which the source is refused
_MIN_PAUSE_S, _MAX_PAUSE_S = 0.2, 1.0  # until a lost stream is tried again: at first, and at most
_LOOK_S = 0.1
_TELL_S = 0.3  # between two times that it is said to be lost
_READERS = {
    "rtp": ("rtp_stream", "read_rtp"),
    "rtsp": ("rtsp", "read_rtsp"),
    "udp": ("mpegts", "read_mpegts"),
    "http": ("mjpeg", "read_mjpeg"),
    "v4l2": ("v4l2", "read_v4l2"),
}


def main() -> None:
    """Do what the first line of the standard input says until that is closed."""
    answers, order, stopped = begun()
    address, newest = VideoAddress(**order["address"]), NewestReading(stopped)
    newest.alive()
    sender = threading.Thread(target=_send, args=(answers, address.name, newest))
    sender.start()
    try:
        _read(address, newest)
    finally:
        newest.stopped.set()
        sender.join()


def _read(address: VideoAddress, newest: NewestReading) -> None:
    """Read, and again when the stream is lost, until stopped."""
    module, name = _READERS[address.scheme if address.scheme == "v4l2" else address.scheme[:4]]
    reader = getattr(import_module(f"{__package__}.{module}"), name)
    pause_s = _MIN_PAUSE_S
    while not newest.stopped.is_set():
        newest.alive()
        began = SYSTEM_CLOCK.monotonic()
        try:
            reader(address, newest)
        except StreamLostError as error:
            if newest.last_put > began:
                pause_s = _MIN_PAUSE_S
            newest.lost = without_credentials(str(error))
        newest.stopped.wait(pause_s)
        pause_s = min(2 * pause_s, _MAX_PAUSE_S)


def _send(answers: IO[bytes], name: str, newest: NewestReading) -> None:
    """Send the newest reading, again and again; the thread's whole life."""
    opened, told, ready, number = SYSTEM_CLOCK.monotonic(), 0.0, False, 0
    try:
        while not newest.stopped.is_set():
            taken = newest.take(_LOOK_S)
            now = SYSTEM_CLOCK.monotonic()
            if taken is not None:
                if not ready:
                    ready = True
                    about = {"period_s": None, "shared_clock": False}
                    write_message(answers, {"kind": "ready", **about})
                number, reading = taken
                _write(answers, number, reading)
            elif not ready and now - opened > _OPEN_S:
                words = newest.lost or f"nothing has come in {_OPEN_S:g} s"
                write_message(answers, {"kind": "refused", "words": f"source {name}: {words}"})
                break
            elif ready and (silent_s := newest.silent_s(now)) and now - told > _TELL_S:
                told, words = now, newest.lost or "nothing comes"
                fault = Fault(Reason.CAMERA_LOST, f"{name}: {words}, for {silent_s:.0f} s")
                _write(answers, number, Reading(None, now, fault))
    except BrokenPipeError:
        pass  # the runtime is gone, or does not listen any more
    finally:
        newest.stopped.set()


def _bgr(shown: VideoFrame) -> bytes | memoryview:
    """Pixels in BGR order, without numpy: a quarter of this process's memory."""
    plane, wide = shown.reformat(format="bgr24").planes[0], 3 * shown.width
    padded = memoryview(plane)
    if plane.line_size == wide:
        return padded
    rows = range(0, len(padded), plane.line_size)
    return b"".join(padded[row : row + wide] for row in rows)


def _write(answers: IO[bytes], number: int, reading: Reading) -> None:
    picture, shown = None, reading.picture
    if isinstance(shown, VideoFrame):
        picture = shown.height, shown.width, "BGR8", _bgr(shown)
    elif shown is not None:
        picture = *shown.shape[:2], "Mono8" if shown.ndim == 2 else "BGR8", shown
    times = reading.taken_s, reading.captured_t
    write_frame(answers, number, reading.arrived, reading.fault, picture, *times)


if __name__ == "__main__":
    main()
