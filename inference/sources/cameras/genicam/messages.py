"""The messages between a camera's process and the runtime.

The runtime writes one line, its order. The process answers in messages: one line of JSON each,
those with ``"bytes"`` followed by so many bytes. When the runtime closes its end it shall stop.
"""

import json
import sys
from dataclasses import dataclass
from typing import IO, Any


def program() -> list[str]:
    """The command of such a process. -P: no package of the current folder is one of tokt's."""
    return [sys.executable, "-P", "-m", "tokt.inference.sources.cameras.genicam.process"]


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
