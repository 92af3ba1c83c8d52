r"""Frames of another program, such as a simulator, over one TCP connection.

The other program listens; the runtime connects to it. Each frame is one line of JSON in ASCII and
the bytes of its pictures, the left one first, rows from the top, colours as blue, green, red::

    {"frame":12,"t":1461149301.25,"left":[271,360,3],"right":null,"missed":0}\n<bytes of left>

Every frame is judged, in its turn, however long the next one takes to come: a simulator that waits
for each verdict goes through the same run each time. For that reason a stream is no live source: it
has no heartbeat, and a frame of it is never too old.
"""

import json
import math
import select
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np

from tokt.features.common.address import parse_address
from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.inference.clock import Clock
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason

STREAM = "stream:"
MAX_HEADER = 4096
MAX_SIDE = 16_384
MAX_PICTURES = 64 << 20
"""Bytes of a header's line, pixels along a picture's side, and bytes of a frame's pictures (two of
11 megapixels in colour) that are not refused."""
MAX_NUMBER = 2**53
MAX_TIME_S = 1e11
"""Of a frame's number and of its time, either way: beyond it readers of JSON lose digits, and the
year is 5138."""
CONNECT_S = 10.0
_STOP_CHECK_S = 0.05
_READ = 1 << 20


def is_stream_source(text: str) -> bool:
    """Whether this names a stream, and not a folder or a file."""
    return text.startswith(STREAM)


def encode_frame(
    number: int, t: float, left: U8 | None, right: U8 | None, missed: int = 0
) -> bytes:
    """One frame as it stands in a stream: what the other program sends.

    Parameters
    ----------
    number : int
    t : float
        Seconds since 1970 (UTC) when it was taken.
    left, right : array of uint8, shape (height, width) or (height, width, 3), or None
        None where there is no picture.
    missed : int
        Frames between the one before and this one that are not sent.
    """
    shapes = [None if picture is None else picture.shape for picture in (left, right)]
    header = {"frame": number, "t": t, "left": shapes[0], "right": shapes[1], "missed": missed}
    line = json.dumps(header, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"
    return line + b"".join(picture.tobytes() for picture in (left, right) if picture is not None)


class StreamSource:
    """The frames of ``stream:HOST:PORT``, each in its turn; ToktError if nobody answers there."""

    live = False

    def __init__(self, text: str, clock: Clock) -> None:
        self._where = text
        self._clock = clock
        self._stopped = False
        self._buffer = bytearray()
        address = parse_address(text.removeprefix(STREAM))
        with os_errors_as(f"nobody sends frames at {text}"):
            self._socket = socket.create_connection(address, CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __iter__(self) -> Iterator[Frame]:
        """Frames until the other side ends the stream between two of them, or `stop` was called.

        ToktError if the stream ends within a frame, or what comes is no frame: where the next one
        begins is then not known. ToktError if it runs backwards, in numbers or in time: what comes
        are not the frames of now.
        """
        before, t_before = -math.inf, -math.inf
        while (line := self._line()) is not None:
            number, t, missed, shapes = _header(line, self._where)
            if number <= before or t < t_before:
                words = f"frame {number} of {t} s after frame {before} of {t_before} s"
                raise ToktError(f"{self._where} runs backwards: {words}")
            before, t_before = number, t
            left, right = map(self._picture, shapes)
            if self._stopped:
                return
            views = left, right, _fault("left", left), _fault("right", right)
            arrived = self._clock.monotonic()
            yield Frame(number, t, *views, missed, timed=True, arrived=arrived)

    def stop(self) -> None:
        """Deliver no further frame."""
        self._stopped = True

    def close(self) -> None:
        """Leave the stream."""
        self._socket.close()

    def _line(self) -> bytes | None:
        """The next header's line, or None at the end."""
        while (end := self._buffer.find(b"\n", 0, MAX_HEADER)) < 0:
            if len(self._buffer) >= MAX_HEADER:
                raise ToktError(f"{self._where} sends no frames: a line of {MAX_HEADER} bytes")
            if not self._receive():
                if self._buffer and not self._stopped:
                    raise ToktError(f"{self._where} ended within a frame")
                return None
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        return line

    def _picture(self, shape: tuple[int, ...] | None) -> U8 | None:
        if shape is None:
            return None
        size = math.prod(shape)
        while len(self._buffer) < size:
            if not self._receive():
                if self._stopped:
                    return None
                raise ToktError(f"{self._where} ended within a frame")
        pixels = np.frombuffer(self._buffer[:size], np.uint8).reshape(shape)
        del self._buffer[:size]
        return pixels

    def _receive(self) -> bool:
        """Take what has come, waiting for it; False at the end, or when stopped."""
        while not self._stopped:
            ready, _, _ = select.select([self._socket], [], [], _STOP_CHECK_S)
            if not ready:
                continue
            with os_errors_as(f"{self._where} is lost"):
                data = self._socket.recv(_READ)
            self._buffer += data
            return bool(data)
        return False


def _fault(side: str, picture: U8 | None) -> Fault:
    if picture is not None:
        return NO_FAULT
    return Fault(Reason.MISSING, f"the stream has no {side} picture")


def _header(line: bytes, where: str) -> tuple[Any, float, int, list[Any]]:
    """A frame's number, time, those missed before, its pictures' shapes, or ToktError."""
    refused = ToktError(f"{where} sends no frames: {line[:60].decode('ascii', 'replace')!r}")
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        raise refused from None
    if not isinstance(header, dict):
        raise refused
    number, t, missed = header.get("frame"), header.get("t"), header.get("missed", 0)
    shapes = [header.get(side) for side in ("left", "right")]
    fits = type(number) is int and abs(number) <= MAX_NUMBER
    fits = fits and type(missed) is int and 0 <= missed <= MANY_MISSED
    fits = fits and all(shape is None or _is_shape(shape) for shape in shapes)
    fits = fits and sum(math.prod(shape) for shape in shapes if shape) <= MAX_PICTURES
    if isinstance(t, bool) or not isinstance(t, int | float) or not (fits and abs(t) <= MAX_TIME_S):
        raise refused
    return number, float(t), missed, shapes


def _is_shape(shape: Any) -> bool:
    if not isinstance(shape, list) or len(shape) not in (2, 3) or shape[2:] not in ([], [3]):
        return False
    return all(type(side) is int and 1 <= side <= MAX_SIDE for side in shape)
