"""A camera that a process of its own drives: the process, and the thread that takes its frames.

::

    camera ── library ──> pipe ──> reader thread ──> deliver
    └──── process ────┘            └──── this process ─────┘

Newest wins: when `deliver` is slow the pipe is full, the camera's process waits or leaves frames
out. What waited in the pipe is as old as it is: `Capture.arrived` is when the camera's process had
it.
"""

import contextlib
import math
import queue
import subprocess
import threading
from dataclasses import dataclass, field
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import frame_from_camera
from tokt.inference.clock import SYSTEM_CLOCK, Clock
from tokt.inference.reason import Fault, Reason

from .capture import Capture, Deliver
from .messages import program, read_message, write_message

_OPEN_S, _CLOSE_S = 30.0, 3.0


@dataclass(eq=False)
class ProcessDriver:
    """A `CameraDriver` of the camera `capture.LEFT` or `capture.RIGHT`, whose work a process does.

    `kind` is the process's folder, for `messages.program`, `name` as the user called the camera,
    and `order` what the process is told, passwords too.
    """

    kind: str
    camera: int
    name: str
    order: dict[str, Any] = field(repr=False)
    clock: Clock

    def __post_init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._reader = threading.Thread()
        self._answers = queue.SimpleQueue[dict[str, Any]]()  # what is said besides frames
        self._lost = ""
        self.period_s: float | None = None
        self.shared_clock = False
        self.failures = 0

    def start(self, deliver: Deliver) -> None:
        """Start the camera's process, wait until it sends; ToktError if it does not, as asked."""
        self.stop()
        self._lost = ""
        try:
            process = subprocess.Popen(
                program(self.kind),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        # A machine short of memory or handles now may have some when it is tried again.
        except OSError as error:
            raise ToktError(f"camera {self.name}: no process for it: {error}") from error
        self._process = process
        self._answers = queue.SimpleQueue()
        name, told = f"tokt camera {self.name}", (process, deliver)
        self._reader = threading.Thread(target=self._read, args=told, name=name, daemon=True)
        self._reader.start()
        assert process.stdin is not None
        # One that has ended already is noticed by the reader.
        with contextlib.suppress(BrokenPipeError):
            write_message(process.stdin, self.order)
        try:
            answer = self._answers.get(timeout=_OPEN_S)
        except queue.Empty:
            answer = {"words": f"camera {self.name} does not answer in {_OPEN_S:g} s"}
        if "words" in answer:
            self.stop()
            raise ToktError(answer["words"])
        if "place" in answer:  # where it is looked for from now on
            self.order["place"] = answer["place"]

    def stop(self) -> None:
        """Deliver nothing more and end the camera's process, by force if it does not end."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._reader.join()
        process.stdout.close()

    def lost(self) -> str:
        """Why the camera is gone: what its process said, or how its process ended."""
        return self._lost

    def _read(self, process: subprocess.Popen[bytes], deliver: Deliver) -> None:
        """Take messages until the process ends; the thread's whole life."""
        assert process.stdout is not None
        try:
            while (message := read_message(process.stdout)) is not None:
                header, data = message
                if header["kind"] == "frame":
                    self._take(header, data, deliver)
                elif header["kind"] == "ready":
                    self.period_s = header["period_s"]
                    self.shared_clock = header["shared_clock"]
                    self._answers.put(header)
                else:
                    self._lose(header["words"])
        except (OSError, ValueError, LookupError, TypeError) as error:
            self._lose(f"camera {self.name}: its process does not make sense: {error!r}")
        self._lose(f"camera {self.name}: its process ended with {process.wait()}")

    def _lose(self, words: str) -> None:
        """The camera is gone, for the first reason that is known."""
        if self._process is not None and not self._lost:
            self._lost = words
        self._answers.put({"words": words})

    def _take(self, header: dict[str, Any], data: bytearray | None, deliver: Deliver) -> None:
        """Deliver a frame."""
        # One clock for all processes of a machine.
        age_s = max(0.0, SYSTEM_CLOCK.monotonic() - header["fetched_s"])
        arrived, t = self.clock.monotonic() - age_s, self.clock.time() - age_s
        taken_s = math.nan if header["taken_s"] is None else header["taken_s"]
        picture, fault = None, Fault(Reason(header["reason"]), header["words"])
        if data is not None:
            try:
                size = header["height"], header["width"]
                picture = frame_from_camera(data, *size, header["pixel_format"], given=True)
            except ValueError as error:
                fault = Fault(Reason.UNREADABLE, str(error))
        captured_t, number = header.get("captured_t"), header["frame_id"]
        capture = Capture(self.camera, number, taken_s, arrived, t, picture, fault, captured_t)
        try:
            deliver(capture)
        except Exception:  # noqa: BLE001 - the thread is the camera's: it outlives all
            self.failures += 1
