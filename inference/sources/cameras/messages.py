"""The messages between a camera's process and the runtime.

The runtime writes one line, its order. The process answers in messages: one line of JSON each,
those with ``"bytes"`` followed by so many bytes. When the runtime closes its end it shall stop.
"""

import json
import os
import signal
import sys
import threading
from typing import IO, Any

from tokt.inference.reason import Fault


def program(kind: str) -> list[str]:
    """The command of such a process. -P: no package of the current folder is one of tokt's.

    `kind` is the folder of its ``process``, such as ``cameras.genicam``.
    """
    return [sys.executable, "-P", "-m", f"tokt.inference.sources.{kind}.process"]


def write_message(out: IO[bytes], header: dict[str, Any], data: memoryview | None = None) -> None:
    """Send a message; waits while the other side does not read."""
    header = header if data is None else {**header, "bytes": len(data)}
    out.write(json.dumps(header).encode() + b"\n")
    out.write(b"" if data is None else data)
    out.flush()


def write_frame(
    out: IO[bytes],
    number: int,
    fetched_s: float,
    fault: Fault,
    picture: tuple[int, int, str, Any] | None = None,
    taken_s: float | None = None,
    captured_t: float | None = None,
) -> None:
    """Send an exposure, or why there is none: times as in `capture.Capture`.

    A picture is its height, its width, one of `PIXEL_FORMATS` and its pixels in one piece.
    """
    header = {"kind": "frame", "frame_id": number, "fetched_s": fetched_s, "taken_s": taken_s}
    header |= {"captured_t": captured_t, "reason": fault.reason, "words": str(fault)}
    if picture is None:
        write_message(out, header)
        return
    header["height"], header["width"], header["pixel_format"], pixels = picture
    write_message(out, header, memoryview(pixels).cast("B"))


def read_message(source: IO[bytes]) -> tuple[dict[str, Any], bytearray | None] | None:
    """The next message's header, and a picture's bytes in memory of their own where it has some.

    None when there will be none. A process that dies in the middle of a message has said nothing.
    """
    line = source.readline()
    if not line.endswith(b"\n"):
        return None
    header = json.loads(line)
    if "bytes" not in header:
        return header, None
    data = bytearray(header.pop("bytes"))
    complete = source.readinto(data) == len(data)  # type: ignore[attr-defined]
    return (header, data) if complete else None


def begun() -> tuple[IO[bytes], dict[str, Any], threading.Event]:
    """Begin a camera's process: its answers, its order, and an event that tells it to stop.

    That is set when the runtime closes its end, or is gone.
    """
    # The runtime has its own way to end on Ctrl-C, which a terminal sends to all of its processes.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The standard output is out of reach from now on: libraries print, too.
    answers, stopped = os.fdopen(os.dup(1), "wb"), threading.Event()
    os.dup2(2, 1)
    order = json.loads(sys.stdin.buffer.readline())

    def watch() -> None:
        # Not through sys.stdin: a thread that waits in it makes Python abort when it ends.
        while os.read(0, 1):
            pass
        stopped.set()

    threading.Thread(target=watch, daemon=True).start()
    return answers, order, stopped


def end_unless_called_again(limit_s: float) -> None:
    """Have the system end this process should it hang for longer than that.

    The runtime ends one that hangs, as long as there is a runtime. Without it nobody would: native
    code that hangs may hold Python's lock, and the camera would stay taken for the next runtime.
    """
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, limit_s)
