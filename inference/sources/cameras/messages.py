"""The messages between a camera's process and the runtime.

The runtime writes one line, its order. The process answers in messages: one line of JSON each,
those with ``"bytes"`` followed by so many bytes. When the runtime closes its end it shall stop.
"""

import json
import os
import signal
import sys
import threading
from dataclasses import dataclass
from typing import IO, Any


def program(kind: str) -> list[str]:
    """The command of such a process. -P: no package of the current folder is one of tokt's.

    `kind` is the folder of its ``process``, such as ``cameras.genicam``.
    """
    return [sys.executable, "-P", "-m", f"tokt.inference.sources.{kind}.process"]


@dataclass(frozen=True)
class Message:
    """One message of a camera's process: its header, and a picture's bytes where it has some."""

    header: dict[str, Any]
    data: bytearray | None = None


def write_message(
    out: IO[bytes], header: dict[str, Any], data: bytes | memoryview | None = None
) -> None:
    """Send a message; waits while the other side does not read."""
    if data is not None:
        header = {**header, "bytes": len(data)}
    out.write(json.dumps(header).encode() + b"\n")
    if data is not None:
        out.write(data)
    out.flush()


def read_message(source: IO[bytes]) -> Message | None:
    """The next message, its data in memory of their own; None when there will be none.

    A process that dies in the middle of a message has said nothing with it.
    """
    line = source.readline()
    if not line.endswith(b"\n"):
        return None
    header = json.loads(line)
    if "bytes" not in header:
        return Message(header)
    data = bytearray(header.pop("bytes"))
    view, filled = memoryview(data), 0
    while filled < len(data):
        count = source.readinto(view[filled:])  # type: ignore[attr-defined]
        if not count:
            return None
        filled += count
    return Message(header, data)


def answers_out() -> IO[bytes]:
    """The standard output, which from now on is out of reach: libraries print, too."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def end_unless_called_again(limit_s: float) -> None:
    """Have the system end this process should it hang for longer than that.

    The runtime ends one that hangs, as long as there is a runtime. Without it nobody would: native
    code that hangs may hold Python's lock, and the camera would stay taken for the next runtime.
    """
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, limit_s)


def watch_input(stop: threading.Event) -> None:
    """Stop when the runtime closes its end, or is gone."""
    # Not through sys.stdin: a thread that waits in it makes Python abort when it ends.
    while os.read(0, 1):
        pass
    stop.set()
