"""RTSP: a camera's stream by aiortsp, its packets to `RtpStream`."""

import asyncio
import math
import ssl
import struct
from base64 import b64decode
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

from aiortsp.rtsp.connection import RTSPConnection
from aiortsp.rtsp.errors import RTSPError, RTSPResponseError
from aiortsp.rtsp.session import RTSPMediaSession
from aiortsp.transport.tcp import TCPTransport
from aiortsp.transport.udp import UDPTransport

from tokt.inference.clock import SYSTEM_CLOCK

from .access_units import CODECS
from .address import VideoAddress
from .newest import NewestReading, Reading, StreamLostError
from .rtp_stream import RtpStream

_ANSWER_S = 5.0
_OPEN_S = 8.0  # for some answers, before the process that hangs is ended
_SILENT_S = 5.0  # without a packet: the session is dead, whatever the server says
_CLOSE_S = 1.0
_LOOK_S = 0.02
_BURST_S, _SETTLED_S, _MAX_BURST_S = 0.1, 0.2, 4.0
_PORT, _PORT_TLS = 554, 322
_NO_SENSE = (AssertionError, LookupError, TypeError, ValueError, AttributeError, struct.error)
"""What aiortsp raises for answers and packets that make no sense."""


class _Packets:
    """Hands a session's packets on; mixed into aiortsp's transports."""

    stream: RtpStream | None = None
    newest: NewestReading
    heard = 0.0
    failure: StreamLostError | None = None
    _least, _since, _begun = math.inf, 0.0, math.inf

    def handle_rtp_data(self, data: bytes) -> None:
        """Take a packet of RTP, and let aiortsp count it for its receiver reports."""
        self._take(data, super().handle_rtp_data)  # type: ignore[misc]

    def handle_rtcp_data(self, data: bytes) -> None:
        """Take a packet of RTCP."""
        self._take(data, super().handle_rtcp_data)  # type: ignore[misc]

    def _take(self, data: bytes, count: Callable[[bytes], None]) -> None:
        self.heard = SYSTEM_CLOCK.monotonic()
        if self.stream is not None and not self.failure:
            try:
                self.put(self.stream.datagram(bytes(data), self.heard))
            except StreamLostError as error:  # which asyncio would keep to itself
                self.failure = error
        with suppress(*_NO_SENSE):
            count(data)

    def put(self, readings: Iterable[Reading]) -> None:
        """Hand on what came, but no picture while a server sends at once what it had kept.

        Of those each comes later after it was taken than the next one, so none tells its age. A
        sender whose clock is fast looks the same, so that is only for its first seconds.
        """
        self._begun = min(self._begun, self.heard)
        for reading in readings:
            if reading.taken_s is not None:
                least = reading.arrived - reading.taken_s
                if least < self._least - _BURST_S:
                    self._least, self._since = least, self.heard
            settled = self.heard > min(self._since + _SETTLED_S, self._begun + _MAX_BURST_S)
            if settled or reading.picture is None:
                self.newest.put(reading)


class _Tcp(_Packets, TCPTransport):  # type: ignore[misc]
    """Packets within the connection."""


class _Udp(_Packets, UDPTransport):  # type: ignore[misc]
    """Packets to two ports, of the address that the server is reached from alone."""

    def get_socket_pair(self, bind_address: str | None = None, retry: int = 10) -> Any:
        """See aiortsp."""
        mine = self.connection._transport.get_extra_info("sockname")[0]
        return UDPTransport.get_socket_pair(bind_address or mine, retry)


def read_rtsp(address: VideoAddress, newest: NewestReading) -> None:
    """Play an address until stopped; StreamLostError if the server refuses, or sends no more."""
    try:
        asyncio.run(_played(address, newest))
    except RTSPResponseError as error:
        answer = error.response
        words = "no sense" if answer is None else f"{answer.status} {answer.status_msg}"
        if answer is not None and answer.status == 401:
            words += ": it wants a user and a password"
        raise StreamLostError(f"the server answers {words}") from None
    except (RTSPError, OSError, TimeoutError) as error:
        words = str(error.__cause__ or error) or type(error).__name__
        raise StreamLostError(f"no RTSP session: {words}") from None
    except _NO_SENSE as error:
        words = f"{type(error).__name__}: {error}"
        raise StreamLostError(f"the server's answers make no sense ({words})") from None


async def _played(address: VideoAddress, newest: NewestReading) -> None:
    secure = address.scheme == "rtsps"
    port = address.port or (_PORT_TLS if secure else _PORT)
    context = ssl.create_default_context() if secure else None
    url = address.url.replace("rtspu:", "rtsp:", 1)
    connection = RTSPConnection(
        *(address.host, port, address.user, address.password), ssl=context, timeout=_ANSWER_S
    )
    async with connection:
        kind = _Udp if address.scheme == "rtspu" else _Tcp
        transport = kind(connection, timeout=0)
        transport.newest = newest
        async with transport:
            session = RTSPMediaSession(connection, url, transport=transport)
            newest.alive()
            await asyncio.wait_for(session.setup(), _OPEN_S)
            try:
                transport.stream = _stream(session)
                await session.play()
                await _kept(session, transport, newest)
            finally:
                with suppress(RTSPError, OSError, TimeoutError, *_NO_SENSE):
                    await asyncio.wait_for(session.teardown(), _CLOSE_S)


def _stream(session: RTSPMediaSession) -> RtpStream:
    """What decodes the session's video, by its description (SDP)."""
    media = session.sdp.get_media("video") or {}
    told = media.get("attributes", {})
    mapped, given = told.get("rtpmap"), told.get("fmtp")
    if not isinstance(mapped, dict):
        raise StreamLostError("the server offers no video")
    codec = CODECS.get(mapped["encoding"].lower())
    if codec is None:
        raise StreamLostError(f"the server sends {mapped['encoding']}, not H.264 or H.265")
    stream = RtpStream(codec, mapped["pt"])
    for name in ("sprop-vps", "sprop-sps", "sprop-pps", "sprop-parameter-sets"):
        for text in (given.get(name, "") if isinstance(given, dict) else "").split(","):
            with suppress(ValueError):
                stream.take_set(b64decode(text))
    return stream


async def _kept(session: RTSPMediaSession, transport: Any, newest: NewestReading) -> None:
    """Keep a session alive until it is stopped, or nothing comes any more."""
    now = transport.heard = SYSTEM_CLOCK.monotonic()
    asking = asyncio.create_task(_asked_to_keep(session))
    while not newest.stopped.is_set() and transport.running and session.connection.running:
        newest.alive()
        if transport.failure:
            raise transport.failure
        if now - transport.heard > _SILENT_S:
            raise StreamLostError(f"the server has sent nothing for {_SILENT_S:g} s")
        transport.put(transport.stream.expired(now))
        await asyncio.sleep(_LOOK_S)
        now = SYSTEM_CLOCK.monotonic()
    asking.cancel()
    if not newest.stopped.is_set():
        raise StreamLostError("the server has ended the session")


async def _asked_to_keep(session: RTSPMediaSession) -> None:
    """Ask again and again to keep a session: what the server says to it, the packets show."""
    while True:
        await asyncio.sleep(max(1.0, session.session_keepalive))
        with suppress(RTSPError, OSError, TimeoutError, *_NO_SENSE):
            await session.keep_alive()
