"""The real runtime, as a process: frames to it over a stream, verdicts from it as datagrams."""

from __future__ import annotations

import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.sources.stream import encode_frame

MAX_S = 60.0
"""Wall time in seconds for a start or a verdict: a process that takes longer is taken for dead."""
_LOOK_S = 0.2
_DATAGRAM = 65_536


class LateVerdictError(ToktError):
    """The machine was too busy for a verdict in time; an idle one would have said another."""


class RuntimeProcess:
    """One ``tokt run``, which judges the frames it is given, one after the other.

    `options` are all but its source and receiver. A process that ends or hangs is a `ToktError`
    with its own last words.
    """

    def __init__(self, options: Sequence[str]) -> None:
        self._options = list(options)

    def __enter__(self) -> RuntimeProcess:
        with ExitStack() as stack, socket.create_server(("127.0.0.1", 0)) as server:
            self._words = stack.enter_context(tempfile.TemporaryFile())
            self._receiver = stack.enter_context(socket.socket(type=socket.SOCK_DGRAM))
            self._receiver.bind(("127.0.0.1", 0))
            command = [
                *(sys.executable, "-P", "-m", "tokt", "run"),
                *("--source", f"stream:127.0.0.1:{server.getsockname()[1]}"),
                *("--udp", f"v2@127.0.0.1:{self._receiver.getsockname()[1]}"),
                *self._options,
            ]
            self._process = subprocess.Popen(command, stderr=self._words, cwd=Path.cwd())
            stack.callback(self._end)
            self._wait_for(server, "connect")
            self._frames = stack.enter_context(server.accept()[0])
            self._frames.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._opened = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._opened.close()

    def judge(self, number: int, t: float, left: U8 | None, right: U8 | None) -> dict[str, Any]:
        """Send one frame of a time `t` (s since 1970) and wait for its datagram: fields of v2."""
        try:
            self._frames.sendall(encode_frame(number, t, left, right))
        except OSError:
            raise self._failed("take a frame") from None
        self._wait_for(self._receiver, "say a verdict")
        said = decode(self._receiver.recv(_DATAGRAM))
        if said["t"] != t:
            raise ToktError(f"the runtime spoke of the frame of {said['t']} s, not of {t} s")
        if said["reason"] == Reason.LATE:
            raise LateVerdictError(f"the verdict on the frame of {t} s came late")
        return said

    def _wait_for(self, readable: socket.socket, what: str) -> None:
        end = time.monotonic() + MAX_S
        while not select.select([readable], [], [], _LOOK_S)[0]:
            if self._process.poll() is not None or time.monotonic() > end:
                raise self._failed(what)

    def _failed(self, what: str) -> ToktError:
        self._words.seek(0)
        words = self._words.read().decode("utf-8", "replace").strip().splitlines()
        return ToktError(f"the runtime did not {what}: {words[-1] if words else 'no word'}")

    def _end(self) -> None:
        """The end of the stream ends the process; one that hangs is killed."""
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
