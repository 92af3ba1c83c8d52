"""An HTTP server of JPEGs one after the other, as Raspberry Pi and ESP32 cameras send them.

Arguments: width, height, rate, first number, file of the stamps, port. The path says what is wrong:
``/stream.mjpg?fault=cut`` and the other names in `FAULTS`.
"""

import sys
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

import cv2

from .feed import pace
from .pictures import bgr
from .stamps import Stamps

FAULTS = ("", "cut", "ends", "hangs", "no length", "garbage", "page", "missing")
"""Nothing; each third JPEG ends too soon; the stream ends, or hangs, within the tenth picture; no
lengths are told; each third part is no JPEG; a web page; no such file."""
BOUNDARY = "frame"


class Handler(BaseHTTPRequestHandler):
    """One client."""

    server: "Server"

    def do_GET(self) -> None:
        """Send pictures until the client goes."""
        fault = parse_qs(urlsplit(self.path).query).get("fault", [""])[0]
        if fault == "missing":
            return self.send_error(404)
        self.send_response(200)
        kind = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        self.send_header("Content-Type", "text/html" if fault == "page" else kind)
        self.end_headers()
        if fault == "page":
            self.wfile.write(b"<html><body>A camera</body></html>")
            return None
        with suppress(OSError):
            self.pictures(fault)
        return None

    def pictures(self, fault: str) -> None:
        for place, _ in enumerate(pace(self.server.rate)):
            number = self.server.next_number()
            self.server.stamps.note(number, time.monotonic())
            done, coded = cv2.imencode(".jpg", bgr(number, self.server.size))
            assert done
            data = coded.tobytes()
            if fault == "cut" and place % 3 == 2:
                data = data[: len(data) // 2]
            if fault == "garbage" and place % 3 == 2:
                data = b"no picture at all"
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\n"
            if fault != "no length":
                head += f"Content-Length: {len(data)}\r\n"
            self.wfile.write(head.encode() + b"\r\n")
            if fault in ("ends", "hangs") and place == 9:
                self.wfile.write(data[: len(data) // 2])
                self.wfile.flush()
                if fault == "ends":
                    return
                time.sleep(3600)
            self.wfile.write(data + b"\r\n")
            self.wfile.flush()

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing."""


class Server(ThreadingHTTPServer):
    """One camera: its numbers go on over all clients."""

    daemon_threads = True

    def __init__(self, port, size, rate, first, stamps):
        super().__init__(("127.0.0.1", port), Handler)
        self.size, self.rate, self.stamps = size, rate, stamps
        self._next = first

    def next_number(self) -> int:
        self._next += 1
        return self._next - 1


def main() -> None:
    """Serve until this process is ended."""
    width, height, rate, first = (int(text) for text in sys.argv[1:5])
    server = Server(int(sys.argv[6]), (width, height), rate, first, Stamps(sys.argv[5]))
    print(server.server_address[1], flush=True)
    server.serve_forever()


if __name__ == "__main__":
    main()
