"""An HTTP server of JPEGs one after the other, as Raspberry Pi and ESP32 cameras send them.

Arguments: width, height, rate, first number, file of the stamps, port.
"""

import sys
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2

from .feed import pace
from .pictures import bgr
from .stamps import Stamps


class Handler(BaseHTTPRequestHandler):
    """One client."""

    server: "Server"

    def do_GET(self) -> None:
        """Send pictures until the client goes."""
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        with suppress(OSError):
            for _ in pace(self.server.rate):
                number = self.server.next_number()
                self.server.stamps.note(number, time.monotonic())
                coded = cv2.imencode(".jpg", bgr(number, self.server.size))[1].tobytes()
                head = "--frame\r\nContent-Type: image/jpeg\r\n"
                head += f"Content-Length: {len(coded)}\r\n\r\n"
                self.wfile.write(head.encode() + coded + b"\r\n")
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
