"""Ports that another program takes."""

import socket
import threading
import time


class TakenPort:
    """A port of 127.0.0.1 that another program takes as soon as it is free."""

    def __init__(self, kind: int, port: int) -> None:
        self._address, self._kind = ("127.0.0.1", port), kind
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._hold, daemon=True)

    def take(self) -> None:
        self._thread.start()

    def _hold(self) -> None:
        with socket.socket(socket.AF_INET, self._kind) as taken:
            if self._kind == socket.SOCK_STREAM:
                taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            while not self._ended.is_set():
                try:
                    taken.bind(self._address)
                    break
                except OSError:
                    time.sleep(0.0005)
            if self._kind == socket.SOCK_STREAM:
                taken.listen()
            self._ended.wait()

    def free(self) -> None:
        self._ended.set()
        self._thread.join()
