"""JPEGs over HTTP, as multipart/x-mixed-replace.

A JPEG does not say when it was taken, and TCP hands on what was held up as if it were new. So what
has come is read to its end before the newest picture is decoded, and ``X-Timestamp`` is believed
where a server sends it.
"""

import os
import re
import select
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from http.client import HTTPException, HTTPResponse
from urllib import request
from urllib.error import HTTPError

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError
from tokt.features.frames.image_file import decode_image
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import NO_FAULT, Fault, Reason

from .address import VideoAddress
from .newest import NewestReading, Reading, StreamLostError
from .rtp import Delay

_ANSWER_S = 3.0  # without a byte
_MAX_WAIT_S = 0.5  # that a picture waits for newer ones
_CHUNK, _MAX_BYTES, _MAX_HEAD = 1 << 18, 16 << 20, 1 << 14
_HEADERS = rb"((?:[^\r\n]{1,400}\r?\n){0,40})\r?\n"  # bounded: no bytes may take long
_LENGTH = re.compile(rb"(?im)^content-length:[ \t]*(\d{1,9})\s*$")
_TAKEN = re.compile(rb"(?im)^x-timestamp:[ \t]*(\d{1,10}(?:\.\d{1,9})?)\s*$")
_MIN_UTC = 1e9
_HANDLERS = (
    *(request.HTTPHandler, request.HTTPSHandler, request.HTTPRedirectHandler),
    *(request.HTTPDefaultErrorHandler, request.HTTPErrorProcessor, request.UnknownHandler),
)

JpegDecoder = Callable[[bytes], tuple[U8 | None, Fault]]
"""Gives the picture of a JPEG, or why there is none."""


@contextmanager
def jpeg_decoder() -> Iterator[JpegDecoder]:
    """Yield a decoder that refuses what libjpeg complains about.

    libjpeg decodes damaged pictures, too, and says so on standard error alone, which goes to a file
    meanwhile. What is lost or repeated is told so, zeros in its place nearly always; single bits
    that are wrong seldom are, but TCP and USB tell those.
    """

    def decoded(data: bytes) -> tuple[U8 | None, Fault]:
        words = ""
        for form in dict.fromkeys((data, _without_padding(data))):
            said.seek(0)
            said.truncate()
            try:
                picture = decode_image(form, "the picture")
            except FrameError as error:
                return None, Fault(Reason.INCOMPLETE, str(error))
            said.seek(0)
            words = " ".join(said.read(200).decode("utf-8", "replace").split())
            if not words:
                return picture, NO_FAULT
        return None, Fault(Reason.INCOMPLETE, f"the picture is damaged ({words})")

    with tempfile.TemporaryFile() as said:
        stderr = os.dup(2)
        os.dup2(said.fileno(), 2)
        try:
            yield decoded
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)


def _without_padding(data: bytes) -> bytes:
    """A JPEG without the zeros that some cameras put in front of its end."""
    end = data.rfind(b"\xff\xd9")
    body = data[: max(end, 0)].rstrip(b"\0")
    return body + data[end:] if end >= 0 else data


class Parts:
    """The parts of a multipart stream: when each was taken, where the server tells, and its bytes.

    Servers write the boundary with and without the dashes that stand in front of it, and lengths or
    none; a length that is wrong costs a part, and no more.
    """

    def __init__(self, boundary: str) -> None:
        text = re.escape(boundary.strip("-").encode("utf-8", "surrogateescape"))
        line = rb"--" + text + rb"-*[ \t]*\r?\n"
        self._boundary, self._head = re.compile(line), re.compile(line + _HEADERS)
        self._buffer = bytearray()
        self._looked = 0

    def feed(self, data: bytes) -> list[tuple[float | None, bytes]]:
        """Take what has come; the parts complete by it. StreamLostError if one does not end."""
        self._buffer += data
        parts = list(iter(self._part, None))
        if len(self._buffer) > _MAX_BYTES:
            raise StreamLostError("the server sends a picture that has no end")
        return parts

    def _part(self) -> tuple[float | None, bytes] | None:
        buffer = self._buffer
        head = self._head.search(buffer)
        if head is None:
            del buffer[:-_MAX_HEAD]
            return None
        start, length = head.end(), _LENGTH.search(head[1])
        if length and int(length[1]):
            end = start + int(length[1])
        elif found := self._boundary.search(buffer, max(start, self._looked)):
            end = found.start()
        else:
            self._looked = len(buffer) - _MAX_HEAD
            return None
        if len(buffer) < end:
            return None
        taken, body = _TAKEN.search(head[1]), bytes(buffer[start:end])
        del buffer[:end]
        self._looked = 0
        return float(taken[1]) if taken else None, body


def read_mjpeg(address: VideoAddress, newest: NewestReading) -> None:
    """Read an HTTP address until stopped; StreamLostError if it cannot be had, or ends."""
    try:
        opened = _opener(address).open(address.url, timeout=_ANSWER_S)
        with closing(opened), jpeg_decoder() as decode:
            _read(opened, newest, decode)
    except HTTPError as error:
        more = ": it wants a user and a password" if error.code == 401 else ""
        raise StreamLostError(f"the server answers {error.code} {error.reason}{more}") from None
    except (OSError, HTTPException, ValueError, NotImplementedError) as error:
        words = str(getattr(error, "reason", error)) or type(error).__name__
        raise StreamLostError(f"the server sends no more, or no sense ({words})") from None


def _opener(address: VideoAddress) -> request.OpenerDirector:
    """Who asks the server: by HTTP alone, through no proxy."""
    opener = request.OpenerDirector()
    for handler in _HANDLERS:
        opener.add_handler(handler())
    if address.user or address.password:
        known = request.HTTPPasswordMgrWithDefaultRealm()
        known.add_password(None, address.url, address.user, address.password)
        opener.add_handler(request.HTTPDigestAuthHandler(known))
        opener.add_handler(request.HTTPBasicAuthHandler(known))
    return opener


def _read(response: HTTPResponse, newest: NewestReading, decode: JpegDecoder) -> None:
    """Read a server's answer to its end."""
    boundary = response.headers.get_param("boundary")
    if response.headers.get_content_maintype() != "multipart":
        kind = response.headers.get_content_type()
        raise StreamLostError(f"the server sends {kind}, no stream of pictures")
    if not isinstance(boundary, str) or not boundary.strip("-"):
        raise StreamLostError("the server names no boundary of its pictures")
    parts, delay, waiting, shown = Parts(boundary), Delay(), None, SYSTEM_CLOCK.monotonic()
    while not newest.stopped.is_set():
        newest.alive()
        data = response.read1(_CHUNK)
        now = SYSTEM_CLOCK.monotonic()
        for taken_s, body in parts.feed(data):
            arrived = now if taken_s is None else delay.undelayed(taken_s, now)
            waiting = taken_s, body, arrived
        more = data and not response.isclosed() and select.select([response], [], [], 0)[0]
        if waiting and (not more or now - shown > _MAX_WAIT_S):
            taken_s, body, arrived = waiting
            captured_t = taken_s if taken_s and taken_s > _MIN_UTC else None
            picture, fault = decode(body)
            newest.put(Reading(picture, arrived, fault, taken_s, captured_t))
            waiting, shown = None, now
        if not data:
            raise StreamLostError("the server has ended the stream")
