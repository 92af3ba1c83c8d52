"""The live view's server: the page, its newest picture and a stream of them, over HTTP.

The page asks for one picture after the other: none waits in a socket, so that a slow network makes
pictures fewer and not older. Its words come with each, in a header. Whoever connects gets pictures
of here; who has this page from here can name the object to hold.
"""

import hmac
import io
import json
import math
import secrets
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from tokt.features.common.address import LOOPBACK_NAMES, is_addressed
from tokt.inference.clock import SYSTEM_CLOCK

from .view_picture import ENDED, Shown

MAX_CLIENTS, MAX_REQUEST = 32, 16_384
"""Connections at a time that may look, and as many that have not shown that yet; and the bytes of a
request."""
_MAX_THREADS = 4 * MAX_CLIENTS  # those too that were hung up on and have not noticed
REQUEST_S = 5.0
"""Longest time in seconds that a client takes to ask, or to take what it is sent."""
_POLL_S, _FRESH_S, _WATCHED_S = 0.25, 0.5, 2.0
_SEND_BYTES = 1 << 17  # of a stream that wait in the system: a picture or two
_PAGE = Path(__file__).with_name("view.html")
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    # A stream is shown by pages of other origins, such as Cockpit's; none of them reads a pixel.
    "Cross-Origin-Resource-Policy": "cross-origin",
}
# Without frame-ancestors: any page may frame this one, as Cockpit does, its desktop program from no
# address at all. In a frame it shows no button, and no other page can read what it frames.
_POLICY = (
    "default-src 'none'; script-src 'nonce-NONCE'; style-src 'nonce-NONCE'; img-src blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)


class Pictures:
    """The newest picture, as JPEG, with its words, for many threads."""

    def __init__(self) -> None:
        self._asked_s = self._drawn_s = -math.inf
        self._changed = threading.Condition()
        self._newest: tuple[int, bytes, Shown] = 0, b"", Shown("", "", 0.0)

    @property
    def watched(self) -> bool:
        """Whether somebody asked lately: else nothing need be drawn."""
        return SYSTEM_CLOCK.monotonic() - self._asked_s < _WATCHED_S

    def put(self, jpeg: bytes, shown: Shown, drawn_s: float) -> None:
        """Have this one shown."""
        with self._changed:
            self._newest, self._drawn_s = (self._newest[0] + 1, jpeg, shown), drawn_s
            self._changed.notify_all()

    def after(self, number: str) -> tuple[int, bytes, Shown] | None:
        """A picture of another number, if it was just drawn, as old as it is now; or None."""

        def is_news() -> bool:
            self._asked_s = SYSTEM_CLOCK.monotonic()
            # Who comes after nobody looked must not get what was true then.
            return str(self._newest[0]) != number and self._asked_s - self._drawn_s < _FRESH_S

        with self._changed:
            if not self._changed.wait_for(is_news, REQUEST_S):
                return None
            newest, jpeg, shown = self._newest
            age_s = shown.age_s + SYSTEM_CLOCK.monotonic() - self._drawn_s
            return newest, jpeg, replace(shown, age_s=age_s)


class ViewServer(ThreadingHTTPServer):
    """Serve `pictures` on a socket that listens already, each connection in a thread.

    A request must show the token as ``?token=``. Where there is none it must be addressed to this
    computer's loopback by name: a page whose name leads there (DNS rebinding) is refused.
    """

    def __init__(self, listener: socket.socket, token: str | None, pictures: Pictures) -> None:
        super().__init__(listener.getsockname(), _ViewHandler, bind_and_activate=False)
        self.socket.close()
        # What is accepted has it too.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
        self.socket, self.token, self.pictures = listener, token, pictures
        # The newest box that was drawn: on which frame; x, y, width and height in shares of it.
        self.drawn: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=1)
        # By address, and whether they may look; who got on last stands last.
        self._clients: dict[Any, tuple[str, bool]] = {}
        self._lock = threading.Lock()
        threading.Thread(target=self.serve_forever, args=(_POLL_S,), daemon=True).start()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Whether there is room for one more: each has a thread."""
        return threading.active_count() < _MAX_THREADS

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer it in a thread, as one that has not shown yet that it may look."""
        self.admit(request, client_address[0], may_look=False)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection, which leaves its place."""
        with self._lock:
            self._clients.pop(request, None)
        super().shutdown_request(request)

    def admit(self, request: Any, address: str, may_look: bool) -> None:
        """Give a connection a place; where there is none hang up on the slowest.

        That is of the address that has most of them, and the one that has been longest in getting
        on: a crowd takes its own places. What it had asked before may still be answered.
        """
        with self._lock:
            self._clients.pop(request, None)
            alike = {one: at for one, (at, looks) in self._clients.items() if looks == may_look}
            if len(alike) >= MAX_CLIENTS:
                counts = Counter(alike.values())
                slowest = max(alike, key=lambda one: counts[alike[one]])  # the first of these
                del self._clients[slowest]
                with suppress(OSError):
                    slowest.shutdown(socket.SHUT_RDWR if may_look else socket.SHUT_RD)
            self._clients[request] = address, may_look

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that hang up or fall silent."""


class _ViewHandler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "tokt", ""
    server: ViewServer

    def handle_one_request(self) -> None:
        """Answer what was asked in time and is short, whoever asks; hang up on the rest.

        The library's time-out is of each byte, and its headers may take 6 MB of each client.
        """
        asked, until_s = b"", time.monotonic() + REQUEST_S
        while not asked.endswith((b"\r\n\r\n", b"\n\n")):
            self.connection.settimeout(max(until_s - time.monotonic(), 0.001))
            more = self.connection.recv(MAX_REQUEST - len(asked))
            if not more:
                self.close_connection = True
                return
            asked += more
        self.connection.settimeout(REQUEST_S)
        self.rfile = io.BytesIO(asked)
        super().handle_one_request()

    def do_GET(self) -> None:
        """Answer what only looks."""
        self._route({"/": self._page, "/picture": self._picture, "/stream.mjpg": self._stream})

    def do_POST(self) -> None:
        """Take a box from this server's own page: browsers say whose page sends something."""
        if self.headers.get("Origin") != f"http://{self.headers.get('Host')}":
            self.send_error(403, "Only this server's own page names an object")
        else:
            self._route({"/object": self._object})

    def _route(self, answers: dict[str, Callable[[], None]]) -> None:
        path, _, query = self.path.partition("?")
        self._query = dict(parse_qsl(query))
        hosts, port = self.headers.get_all("host", []), self.server.server_address[1]
        token, given = self.server.token, self._query.get("token", "").encode("utf-8", "replace")
        if token is None and not is_addressed(hosts, port, LOOPBACK_NAMES, any_address=False):
            self.send_error(403, "This server is not addressed by that host name")
        elif token is not None and not hmac.compare_digest(given, token.encode()):
            self.send_error(401, "Open the address that tokt run printed: it holds the token")
        elif path in answers:
            self.server.admit(self.connection, self.client_address[0], may_look=True)
            answers[path]()
        else:
            self.send_error(404)

    do_HEAD = do_GET  # noqa: N815 - as `http.server` calls it

    def _page(self) -> None:
        nonce = secrets.token_urlsafe(16)
        page, policy = _PAGE.read_text("utf-8"), _POLICY.replace("NONCE", nonce)
        body = page.replace("NONCE", nonce).encode()
        self._answer("text/html; charset=utf-8", body, {"Content-Security-Policy": policy})

    def _picture(self) -> None:
        found = self.server.pictures.after(self._query.get("after", ""))
        if found is None:
            self.send_error(503, "There is no picture")
            return
        number, jpeg, shown = found
        self._answer(
            "image/jpeg", jpeg, {"X-Tokt": json.dumps({"number": number, **asdict(shown)})}
        )

    def _object(self) -> None:
        try:
            frame, *box = map(float, self._query.get("box", "").split(","))
            x, y, wide, high = box
            self.server.drawn.append((int(frame), (x, y, wide, high)))
        except (ValueError, OverflowError):
            self.send_error(400, "A box is frame,x,y,width,height")
            return
        self._answer("text/plain", b"", {})

    def _stream(self) -> None:
        """Send one picture after the other; the newest, however long the client takes."""
        self.close_connection = True
        self._answer("multipart/x-mixed-replace; boundary=frame", b"--frame\r\n", {})
        number, ended = 0, self.command == "HEAD"
        while not ended and (found := self.server.pictures.after(str(number))):
            number, jpeg, shown = found
            ended = shown.word == ENDED
            self.server.admit(self.connection, self.client_address[0], may_look=True)
            head = b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
            # The next boundary goes with it: browsers show no picture before they have seen that.
            self.wfile.write(head + jpeg + b"\r\n--frame%b\r\n" % (b"--" if ended else b""))

    def _answer(self, kind: str, body: bytes, headers: dict[str, str]) -> None:
        if not self.close_connection:
            headers = {"Content-Length": str(len(body)), **headers}
        self.send_response(200)
        for name, text in {"Content-Type": kind, **headers}.items():
            self.send_header(name, text)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def end_headers(self) -> None:
        """What every answer has, errors too."""
        for name, text in _HEADERS.items():
            self.send_header(name, text)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: standard error is for people."""
